#!/usr/bin/env bash
# Uses the add-on in the window of the `blender` on the path, on a display of its own: window.sh ARCHIVE FOLDER. The pictures lie in FOLDER.
set -euo pipefail
archive=$(realpath "$1")
mkdir -p "$2"
folder=$(realpath "$2")
tests=$(realpath "$(dirname "$0")")
Xvfb :77 -screen 0 1280x800x24 +extension GLX >/dev/null 2>&1 &
display=$!
trap 'kill $display' EXIT
sleep 3
rm -f "$folder/passed"
BLENDER_USER_RESOURCES=$(mktemp -d) DISPLAY=:77 LIBGL_ALWAYS_SOFTWARE=1 timeout 300 blender --factory-startup \
    --window-geometry 0 0 1280 800 -P "$tests/window.py" -- "$archive" "$folder" >"$folder/log" 2>&1 || true
if [[ ! -f $folder/passed ]]; then
    tail -20 "$folder/log" >&2
    exit 1
fi
echo "the add-on works in the window of $(blender --version | head -1)"
