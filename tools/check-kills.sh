#!/usr/bin/env bash
# Kills runs at random moments and starts them again: each rerun must end in the same bytes as a run that was left alone, with nothing
# left over. Usage: tools/check-kills.sh [KILLS] [SEED]; 200 kills unless another number is given. Video needs the ffmpeg program.
set -euo pipefail
cd "$(dirname "$0")/.."
kills=${1:-200}
RANDOM=${2:-1}
source tools/common.sh
binary=$BLINDAUG
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
cd "$work"

"$binary" demo -o demo >/dev/null 2>&1
clip=demo/clip
# A longer clip, so that there is something to interrupt.
mkdir frames
for i in $(seq 1 30); do cp "$clip/frames/000$(((i - 1) % 5 + 1)).png" "frames/$(printf %04d "$i").png"; done

# The commands that are run; OUT stands for the output that must be the same afterwards. A video is one file, which a rerun makes anew.
declare -A commands=(
    [composite]="composite $clip/frames --virtual $clip/virtual --camera demo/camera.json --depth $clip/scene -o OUT"
    [apply]="apply frames --camera demo/camera.json -o OUT"
    [save-evidence]="estimate frames --frames 1..4 --method removal --network none --save-evidence OUT -o OUT.json"
    [validate]="validate --quick --network none -o OUT"
    [track]="estimate frames --track -o OUT.json"
)
jobs=(validate composite apply save-evidence track)
if command -v ffmpeg >/dev/null; then
    commands[video]="apply frames --camera demo/camera.json --fps 25 --overwrite -o OUT.mp4"
    jobs+=(video)
else
    echo "NOT TESTED: video, since there is no ffmpeg program"
fi

took=()
# The checksums of all files that a run has written, hidden ones too, without the seconds that it took, its command line and the pages that show them.
bytes() {
    (cd "$1" && find . -type f -printf '%P\n' | LC_ALL=C sort | grep -v '\.html$' | while read -r f; do
        echo "$(sed '/"seconds"/d; /"command"/d' "$f" | sha256sum) $f"
    done)
}

run() { # NAME FOLDER
    local command=${commands[$1]//OUT/$2\/out}
    mkdir -p "$2"
    # shellcheck disable=SC2086
    exec "$binary" $command
}

for job in "${jobs[@]}"; do
    start=$(date +%s%N)
    (run "$job" "whole-$job") >/dev/null 2>"$job.log" || { cat "$job.log"; exit 1; }
    took[$((${#took[@]}))]=$((($(date +%s%N) - start) / 1000000))
    bytes "whole-$job" >"$job.sums"
done

signals=(INT TERM KILL)
stopped=0
for k in $(seq 1 "$kills"); do
    # The long job, validate, runs less often.
    if [ $((k % 20)) = 0 ]; then j=0; else j=$((1 + k % (${#jobs[@]} - 1))); fi
    job=${jobs[$j]}
    signal=${signals[$((RANDOM % 3))]}
    folder=killed-$k
    # bash lets commands in the background ignore SIGINT; the binary catches it all the same.
    (run "$job" "$folder") >/dev/null 2>"$folder.log" &
    pid=$!
    # The signal comes at a random time of the run, or a little past its end.
    ms=$((RANDOM * (took[j] * 11 / 10) / 32768))
    sleep "$(printf '%d.%03d' $((ms / 1000)) $((ms % 1000)))"
    kill -"$signal" "$pid" 2>/dev/null || true
    # The messages of bash about killed jobs are hidden.
    { if wait "$pid"; then status=0; else status=$?; fi; } 2>/dev/null
    # The run ended before the signal (0), or by the signal (the shell's convention).
    case "$status" in
    0) ;;
    130 | 143 | 137) stopped=$((stopped + 1)) ;;
    *) echo "$job: exit status $status after $signal at $ms ms"; cat "$folder.log"; exit 1 ;;
    esac
    if [ "$status" != 137 ] && find "$folder" -name '.partial-*' 2>/dev/null | grep -q .; then
        echo "$job: left over after $signal at $ms ms: $(find "$folder" -name '.partial-*')"
        exit 1
    fi
    (run "$job" "$folder") >/dev/null 2>"$folder.log" || { echo "$job: the rerun failed"; cat "$folder.log"; exit 1; }
    if ! diff "$job.sums" <(bytes "$folder") >"$folder.diff"; then
        echo "$job: other bytes after $signal at $ms ms:"
        cat "$folder.diff"
        exit 1
    fi
    rm -rf "$folder" "$folder".*
    [ $((k % 20)) = 0 ] && echo "$k of $kills kills, $stopped of them before the end"
done
echo "$kills kills over ${jobs[*]}: $stopped came before the end, every rerun ended in the same bytes, nothing was left over"
