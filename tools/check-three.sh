#!/usr/bin/env bash
# Runs the exported three.js module in Chromium and measures its noise there, and the scales that the export takes from three's own effects.
#
#   tools/check-three.sh [FOLDER]      # FOLDER for the screenshots, otherwise a temporary one
#
# BLINDAUG: the program, otherwise built. THREE: the version of three, otherwise the one that was measured.
set -euo pipefail
root=$(cd "$(dirname "$0")/.." && pwd)
source "$root/tools/browser.sh" check-three "${1:-}"
cd "$root"
source tools/common.sh
npm install --silent --no-audit --no-fund --prefix "$work" "three@${THREE:-0.187.0}" playwright-core >/dev/null ||
    { echo "check-three: npm could not install three and playwright-core" >&2; exit 1; }

# camera NAME CLIP FACTOR: writes a camera's module and table to $work/NAME, with the noise FACTOR times as strong.
camera() {
    mkdir -p "$work/$1"
    node - "$2" "$3" >"$work/$1/camera.json" <<'JS'
const [clip, factor] = process.argv.slice(2).map(Number);
const levels = [[0.012, 0.010, 0.018, 0.010, 0.008, 0.014], [0.008, 0.007, 0.013, 0.007, 0.006, 0.010],
    [0.004, 0.003, 0.006, 0.003, 0.003, 0.005], [0.002, 0.0015, 0.003, 0.0015, 0.0015, 0.002]]
    .map((v) => v.map((x) => factor * x)).map((v) => ({ slope: v.slice(0, 3), intercept: v.slice(3) }));
const noise = factor ? { levels, clip, method: 'given', samples: 0 } : { unknown: 'why' };
console.log(JSON.stringify({
    format: 'blindaug-camera', version: 1,
    capture: { width: 512, height: 320, fps: 30, frames_used: 5 }, transfer: 'srgb', noise,
    motion_blur: { exposure: 0.5, interval: [0.5, 0.5], method: 'given', samples: 0 },
    defocus: { model: 'thin_lens', sigma_px_at_infinity: 4, focus_inverse_depth: 0.5, depth_kind: 'metric', method: 'given', samples: 0 },
}));
JS
    "$BLINDAUG" export "$work/$1/camera.json" --to three -o "$work/$1/blindaug_camera.js" >/dev/null 2>&1
    [ "$3" = 0 ] || "$BLINDAUG" export "$work/$1/camera.json" --to texture -o "$work/$1/" >/dev/null 2>&1
}
camera plain 1 1
camera clip204 0.8 1
camera clip230 0.9019608 1
camera double 1 2
camera silent 1 0

node "$root/tools/three/check.mjs" "$work" "$browser" "$shots"
