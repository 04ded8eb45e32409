#!/usr/bin/env bash
# A layer for a compositing program, put over its plate by Blender's compositor, must be what `composite` writes, to the precision of a half
# float; and OpenEXR's own reader must read every file.
#
#     tools/check-compositing.sh [DIR]      # DIR: where the files are kept [default: a temporary folder]; a minute
#
# Needs Python 3.11; Blender comes as a module (PYTHON: the interpreter; with bpy and OpenEXR in it nothing is installed).
set -euo pipefail
cd "$(dirname "$0")/.."
out=$(realpath -m "${1:-$(mktemp -d)}")
mkdir -p "$out"
python=${PYTHON:-python3}
if ! "$python" -c 'import bpy, OpenEXR' 2>/dev/null; then
    "$python" -m venv "$out/venv"
    python=$out/venv/bin/python
    "$python" -m pip install --quiet bpy==4.5.15 openexr
fi

source tools/common.sh
clip=apps/cli/assets/demo
# The plate, as Blender writes it.
"$python" - "$clip/frames/0003.png" "$out/plate.exr" <<'PY'
import os
import sys

import bpy

bpy.context.scene.view_settings.view_transform = "Raw"
image = bpy.data.images.load(os.path.abspath(sys.argv[1]))
settings = bpy.context.scene.render.image_settings
settings.file_format, settings.color_depth = "OPEN_EXR", "32"
image.save_render(sys.argv[2])
PY
"$BLINDAUG" estimate "$clip/frames" --depth "$clip/scene" -o "$out/camera.json" >/dev/null
common=("$out/plate.exr" --virtual "$clip/virtual/0003.exr" --camera "$out/camera.json" --overwrite --depth "$clip/scene/0003.exr")
"$BLINDAUG" composite "${common[@]}" -o "$out/composite.exr"
"$BLINDAUG" composite "${common[@]}" -o "$out/layer.exr" --layer --bits 16
"$python" tools/blender/over.py "$out"/{plate,layer,composite,over}.exr >"$out/blender.log" 2>&1 ||
    { tail -5 "$out/blender.log" >&2; exit 1; }
grep 'largest difference' "$out/blender.log"
"$python" - "$out"/{layer,composite}.exr <<'PY'
import sys

import OpenEXR

for path in sys.argv[1:]:
    with OpenEXR.File(path, separate_channels=True) as file:
        print(path.rsplit("/", 1)[-1], "read by OpenEXR:", " ".join(file.channels()))
PY
