#!/usr/bin/env bash
# Compares the results of the program before and after a change that must not alter them: cameras of the demo and of the rendered clips
# (nothing given; depth and flow given; for each frame), and the pixels of composites and of distorted frames.
#
#     tools/check-unchanged.sh record FOLDER       # with the program before the change
#     tools/check-unchanged.sh compare FOLDER      # with the program after it
#
# BLINDAUG names the program (otherwise it is built), BLINDAUG_SHARED the folder with the rendered clips; without it the demo alone is
# compared, and the script says so. Reasons of what is unknown, and sharpening that is unknown, are left out, since older versions did
# not write them. Needs python3.
set -euo pipefail
cd "$(dirname "$0")/.."
what=${1:?record or compare}
folder=$(realpath -m "${2:?a folder}")
source tools/common.sh
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

run() { "$BLINDAUG" "$@" >/dev/null 2>>"$work/log" || { tail -3 "$work/log"; exit 1; }; }
run demo -o "$work/demo"
mkdir -p "$work/out"
cp "$work/demo/camera.json" "$work/out/demo.json"
(cd "$work/demo" && find . -name '*.png' -not -path './clip/*' | LC_ALL=C sort | xargs sha256sum) >"$work/out/demo.sums"

clips=${BLINDAUG_SHARED:+$BLINDAUG_SHARED/data/clips}
if [[ -n $clips && -d $clips ]]; then
    for clip in "$clips"/*; do
        name=$(basename "$clip")
        for frames in full2_plain mb_0.50 dof_b; do
            at=$work/out/$name-$frames
            run estimate "$clip/$frames" -o "$at-nothing.json"
            run estimate "$clip/$frames" --depth "$clip/clean" --flow "$clip/clean" -o "$at-given.json"
            run estimate "$clip/$frames" --track -o "$at-track.json"
        done
        camera=$work/out/$name-full2_plain-given.json
        run composite "$clip/full2_plain" --virtual "$clip/virtual" --camera "$camera" --depth "$clip/clean" \
            --with "$clip/full2_with" --without "$clip/full2_without" -o "$work/$name-composite"
        run apply "$clip/clean" --camera "$camera" --depth "$clip/clean" --flow "$clip/clean" -o "$work/$name-applied"
        for folder_of in composite applied; do
            (cd "$work/$name-$folder_of" && LC_ALL=C sha256sum ./*) >"$work/out/$name-$folder_of.sums"
        done
    done
else
    echo "NOT COMPARED: rendered clips, since BLINDAUG_SHARED names no folder that has them"
fi

# Writes the models with sorted keys, without the parts that older versions did not write.
python3 - "$work/out" <<'PYTHON'
import json, pathlib, sys

def plain(value):
    if isinstance(value, list):
        return [plain(v) for v in value]
    if not isinstance(value, dict):
        return value
    keep = {k: plain(v) for k, v in value.items() if not (k == "reason" and "unknown" in value)}
    if "unknown" in (keep.get("sharpening") or {}):
        del keep["sharpening"]
    return keep

for file in pathlib.Path(sys.argv[1]).glob("*.json"):
    text = file.read_text()
    models = [json.loads(line) for line in text.splitlines()] if '"frame"' in text.split("\n")[0] else [json.loads(text)]
    file.write_text("".join(json.dumps(plain(m), sort_keys=True) + "\n" for m in models))
PYTHON

if [[ $what == record ]]; then
    mkdir -p "$folder"
    cp "$work/out/"* "$folder/"
    echo "recorded: $(ls "$folder" | wc -l) files"
else
    diff -r "$folder" "$work/out" && echo "the same: $(ls "$folder" | wc -l) files"
fi
