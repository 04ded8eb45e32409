#!/bin/sh
# Renders the demo clip again, from nothing.
#
#   pip install bpy==4.5.15 numpy opencv-python-headless OpenEXR zopfli      # Python 3.11
#   ./render_demo.sh BLENDER OUT
#
# BLENDER: the folder with render_clip.py and pack_clip.py. OUT is made: OUT/textures, OUT/raw/demo, OUT/packed/demo, OUT/ship.
# PYTHON (default python3) runs everything. About 15 minutes on two cores.
set -eu
[ $# -eq 2 ] || { echo "usage: $0 BLENDER OUT" >&2; exit 2; }
here=$(CDPATH= cd -- "$(dirname -- "$0")" && pwd)
blender=$1
out=$2
py=${PYTHON:-python3}
mkdir -p "$out/textures" "$out/raw/demo"

[ -e "$out/textures/wood_teal.png" ] || nice -n 19 "$py" "$here/make_textures.py" "$out/textures"

render() {                                                      # render CONDITION SAMPLES OPTIONS...; what is there already is kept
    cond=$1 samples=$2
    shift 2
    [ -e "$out/raw/demo/$cond/meta.json" ] && return
    nice -n 19 "$py" "$blender/render_clip.py" --scene table --seed 7 --frames 5 --size 272 --textures "$out/textures" \
        --samples "$samples" --out "$out/raw/demo/$cond" "$@" > "$out/raw/$cond.log" 2>&1
}
lens="--shutter 0.6 --fstop 0.45 --focus 4.0"
render clean 64 --passes
render virtual 64 --virtual-only
render full_without 96 $lens
render full_with 96 $lens --object
render clean_with 64 --object --exr

"$py" "$blender/pack_clip.py" "$out/raw/demo" "$out/packed/demo"
"$py" "$here/ship_demo.py" "$out/packed/demo" "$out/ship"
