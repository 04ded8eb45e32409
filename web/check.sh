#!/usr/bin/env bash
# Builds the npm package and checks it in Node and Chromium: WebAssembly against native numbers, types, the packed package in an empty project, the
# page with a fake webcam, and what goes wrong.
#
#   web/check.sh [SCREENSHOTS]     # a folder for the screenshots, otherwise a temporary one
#
# CLIPS: how many clips of known truth are looked at, by default 10. THREADS=1 builds and checks the second build with threads, too. WebKit is tried
# where its WebDriver is installed.
set -euo pipefail
root=$(cd "$(dirname "$0")/.." && pwd)
source "$root/tools/browser.sh" web/check "${1:-}"
export CHROMIUM=$browser
cd "$root/web"
./build.sh ${THREADS:+threads}
npm install --silent --no-audit --no-fund --no-save playwright-core typescript three@0.187.0 @types/three@0.187.0 >/dev/null

echo "== WebAssembly and native programs estimate the same"
example=(cargo run --quiet --release --manifest-path "$root/Cargo.toml")
"${example[@]}" -p blindaug-scenes --example webcam_clips -- "$work/clips" "${CLIPS:-10}"
for clip in 0 1; do
    ffmpeg -v error -y -i "$work/clips/$clip.y4m" -frames:v 12 -f rawvideo -pix_fmt rgba "$work/clip.rgba"
    RAYON_NUM_THREADS=1 "${example[@]}" -p blindaug-pipeline --no-default-features --features threads --example track_raw -- "$work/clip.rgba" 480 360 >"$work/native.jsonl"
    node test/track.mjs "$work/clip.rgba" 480 360 >"$work/wasm.jsonl"
    node test/same.mjs "$work/native.jsonl" "$work/wasm.jsonl"
done

if [[ -n ${THREADS:-} ]]; then
    echo "== threads give the same in an isolated page"
    node test/threads.mjs "$work/clip.rgba" 480 360 >/dev/null
fi

echo "== types"
npx --no-install tsc -p test/tsconfig.json

echo "== the package in an empty project"
npm pack --silent --pack-destination "$work" >/dev/null
mkdir "$work/project" && (cd "$work/project" && npm init -y >/dev/null && npm install --silent --no-audit --no-fund "$work"/blindaug-*.tgz)
node test/package.mjs "$work/project" "$work/clips/0.y4m"

echo "== the page on clips of known truth"
node test/truth.mjs "$work/clips" 40 "$shots"

echo "== the page itself"
node test/page.mjs "$work/clips/3.y4m" "$shots"

if command -v WebKitWebDriver >/dev/null; then
    echo "== the page in WebKit"
    ffmpeg -v error -y -i "$work/clips/0.y4m" -c:v libvpx -b:v 3M "$work/clip.webm"
    xvfb-run -a node test/webkit.mjs "$work/clip.webm" "$shots"
else
    echo "== WebKit was not tried: that takes Debian's packages webkit2gtk-driver and xvfb"
fi
echo "screenshots: $shots"
