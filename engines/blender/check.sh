#!/usr/bin/env bash
# Builds the extension, installs it from its archive into Blender as a module, and runs the tests, with renders: some minutes after the build.
#
# Needs Python 3.11, PyPI and Rust. PYTHON: the interpreter; with bpy, OpenEXR and pytest in it, and without blindaug, nothing is installed.
# BLINDAUG=PROGRAM is the command line to compare with, WHEELS=FOLDER has the wheel; without them they are built. BLINDAUG_BLENDER_PICTURES=FOLDER
# keeps the pictures. With `blender` (4.2 to 4.5), Xvfb, xdotool and ImageMagick's `import` on the path, the add-on is used in Blender's window, too.
set -euo pipefail
cd "$(dirname "$0")"
root=$(realpath ../..)
out="$root/target/blender"
mkdir -p "$out"
python=${PYTHON:-python3}
if ! "$python" -c 'import bpy, OpenEXR, pytest' 2>/dev/null; then
    "$python" -c 'import sys; sys.exit(sys.version_info[:2] != (3, 11))' ||
        { echo "check: Blender 4.5 as a module needs Python 3.11; give one by PYTHON=..." >&2; exit 1; }
    "$python" -m venv "$out/bpy"
    python=$out/bpy/bin/python
    "$python" -m pip install --quiet bpy==4.5.15 "numpy<2" OpenEXR "pytest>=8"
fi
if "$python" -c 'import blindaug' 2>/dev/null; then
    echo "check: $python has the package blindaug, which the extension is to bring; uninstall it there" >&2
    exit 1
fi
(cd "$root" && source tools/common.sh && realpath "$BLINDAUG") >"$out/program"
BLINDAUG=$(<"$out/program")
EXTENSION=$(./build.sh "$out" | tail -1)
BLENDER_USER_RESOURCES=$(mktemp -d)
export BLINDAUG EXTENSION BLENDER_USER_RESOURCES
# Blender's own check of archives.
cli=$("$python" -c 'import bpy; print("\n" + bpy.utils.system_resource("SCRIPTS"))' | tail -1)/addons_core/bl_pkg/cli/blender_ext.py
"$python" "$cli" validate "$EXTENSION"
(cd tests && "$python" -m pytest -q -p no:cacheprovider .)

for program in blender Xvfb xdotool import; do
    command -v "$program" >/dev/null || { echo "NOT TESTED in Blender's window: there is no $program"; exit 0; }
done
tests/window.sh "$EXTENSION" "$out/window"
