#!/usr/bin/env bash
# Checks the job template, runs it with openjd-cli by ranges of frames, with one task killed in the middle and run again, and compares the frames with
# those of the command line, which makes all of them at once. Needs Python 3.9 or later with venv, and PyPI, or OPENJD=PROGRAM; BLINDAUG=PROGRAM is
# the command line, else it is built.
set -euo pipefail
cd "$(dirname "$0")"
assets=$(realpath ../../apps/cli/assets/demo)
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
if [ -z "${OPENJD:-}" ]; then
    python3 -m venv "$work/venv"
    "$work/venv/bin/pip" install --quiet "openjd-cli>=0.8,<0.10"
    OPENJD="$work/venv/bin/openjd"
fi
if [ -z "${BLINDAUG:-}" ]; then
    cargo build --quiet --manifest-path ../../Cargo.toml -p blindaug-cli
    BLINDAUG=$(realpath ../../target/debug/blindaug)
fi
export BLINDAUG WORK="$work"

# In place of the program: kills it once, in the task of frames 3 and 4, when the first of them is written.
cat >"$work/killed" <<'PROGRAM'
#!/usr/bin/env bash
if [[ "$*" == *composite*3..4* ]] && [ ! -e "$WORK/was_killed" ]; then
    "$BLINDAUG" "$@" &
    until [ -e "$WORK/job/frames/0003.png" ]; do sleep 0.01; done
    kill -9 $!
    touch "$WORK/was_killed"
    wait $!
else
    exec "$BLINDAUG" "$@"
fi
PROGRAM
chmod +x "$work/killed"

"$OPENJD" check blindaug.yaml
# Shadows and an object that moves with the plate need the plate's flow, and that of a range's last frame the frame after it.
options="--seed 5 --with $assets/with --without $assets/without --layer-motion plate --layer-depth 3 --match-at 40,60"
parameters=(-p "Footage=$assets/frames" -p "Layers=$assets/virtual" -p "Output=$work/job" -p Last=5 -p FramesPerTask=2
    -p "CompositeOptions=$options" -p "Program=$work/killed")
mkdir "$work/job"
"$OPENJD" run blindaug.yaml "${parameters[@]}" --step Estimate >"$work/estimate.log"
if "$OPENJD" run blindaug.yaml "${parameters[@]}" --step Composite >"$work/composite.log" 2>&1; then
    echo "the killed task was not noticed" >&2
    exit 1
fi
[ -e "$work/was_killed" ]
[ ! -e "$work/job/frames/0004.png" ]
# The killed task and what was not run after it, as a farm gives them out again; then all tasks once more, which find nothing to do.
for from in 3 5; do
    "$OPENJD" run blindaug.yaml "${parameters[@]}" --step Composite --task-param "From=$from" >>"$work/composite.log"
done
cp -r "$work/job/frames" "$work/before"
"$OPENJD" run blindaug.yaml "${parameters[@]}" --step Composite >>"$work/composite.log"
diff -r "$work/before" "$work/job/frames"

whole() { "$BLINDAUG" composite "$assets/frames" --virtual "$assets/virtual" --camera "$1" ${options/--seed 5/--seed $2} -o "$3" 2>>"$work/whole.log"; }
"$BLINDAUG" estimate "$assets/frames" -o "$work/camera.json" >>"$work/whole.log" 2>&1
cmp "$work/camera.json" "$work/job/camera.json"
whole "$work/camera.json" 5 "$work/whole"
diff -r "$work/whole" "$work/job/frames"
[ "$(ls "$work/whole" | wc -l)" = 5 ]
# Negative control: another seed makes other frames.
whole "$work/camera.json" 6 "$work/other"
if diff -rq "$work/other" "$work/job/frames" >/dev/null; then
    echo "the comparison finds no difference" >&2
    exit 1
fi
echo "by ranges, with a killed task, as at once: 5 frames with the same bits"
