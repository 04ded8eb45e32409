#!/usr/bin/env bash
# The closed loop, and the shape of out-of-focus points. A camera is exported to Blender, a scene is rendered with the script that was written, and the camera is
# estimated blindly from that render (depth given). The numbers that went in must lie within the intervals that come out.
#
#     tools/check-blender.sh [DIR]      # DIR: where the render is kept [default: a temporary folder]; about five minutes
#
# Needs Python 3.11; Blender comes as a module (PYTHON: the interpreter; with bpy in it nothing is installed).
set -euo pipefail
cd "$(dirname "$0")/.."
out=${1:-$(mktemp -d)}
mkdir -p "$out"
python=${PYTHON:-python3}

if ! "$python" -c 'import bpy' 2>/dev/null; then
    "$python" -c 'import sys; sys.exit(sys.version_info[:2] != (3, 11))' ||
        { echo "check-blender: Blender 4.5 as a module needs Python 3.11; give one by PYTHON=..." >&2; exit 1; }
    "$python" -m venv "$out/venv"
    python=$out/venv/bin/python
    "$python" -m pip install --quiet bpy==4.5.15
fi

source tools/common.sh
"$BLINDAUG" export tools/blender/camera.json --to blender -o "$out/blindaug_camera.py"
# Blender prints much, so its output goes to a log.
"$python" tools/blender/render.py "$out/blindaug_camera.py" "$out" >"$out/blender.log" 2>&1 ||
    { tail -5 "$out/blender.log" >&2; exit 1; }
"$BLINDAUG" estimate "$out/frames" --depth "$out/depth" -o "$out/estimate.json" >/dev/null
"$BLINDAUG" inspect tools/blender/camera.json --json >"$out/truth.txt"
"$BLINDAUG" inspect "$out/estimate.json" --json >"$out/found.txt"
"$python" tools/blender/compare.py tools/blender/camera.json "$out/estimate.json" "$out/truth.txt" "$out/found.txt"

# A point behind the focus, through blades that are turned and squeezed, and through a disk: its image must be the model's.
for shape in "0 0 1" "6 0 1" "5 15 1.5"; do
    read -r blades rotation squeeze <<<"$shape"
    "$python" - "$blades" "$rotation" "$squeeze" >"$out/shape.json" <<'PYTHON'
import json, sys
blades, rotation, squeeze = int(sys.argv[1]), float(sys.argv[2]), float(sys.argv[3])
camera = json.load(open("tools/blender/camera.json"))
shape = {"shape": "polygon", "blades": blades, "rotation_degrees": rotation} if blades else {"shape": "disk"}
camera["defocus"]["bokeh"] = {**shape, "squeeze": squeeze}
json.dump(camera, sys.stdout)
PYTHON
    "$BLINDAUG" export "$out/shape.json" --to blender -o "$out/shape.py"
    echo "blades $blades, rotation $rotation, squeeze $squeeze:"
    "$python" tools/blender/shape.py "$out/shape.py" "$blades" "$rotation" "$squeeze" >"$out/shape.log" 2>&1 ||
        { tail -5 "$out/shape.log" >&2; exit 1; }
    grep -E "^(stds|corners)" "$out/shape.log"
done
