#!/bin/sh
# Feeds the readers of files with damaged files: `tools/fuzz.sh [TARGET] [SECONDS]`, all targets and 1200 seconds each by default.
#
# Needs cargo-fuzz (`cargo install cargo-fuzz`) and a C++ compiler. The seeds are in fuzz/seeds, what a run adds to them stays in
# fuzz/corpus, and an input that fails is left in fuzz/artifacts; give it a name in fuzz/regressions/TARGET once it is mended.
set -eu
cd "$(dirname "$0")/../fuzz"
seconds=${2:-1200}
# Videos are read by the built-in decoder.
export BLINDAUG_FFMPEG=none
# The sanitizer is an option of the compiler that only the nightly one takes without RUSTC_BOOTSTRAP.
if rustc +nightly --version >/dev/null 2>&1; then
    fuzz() { cargo +nightly fuzz "$@"; }
else
    export RUSTC_BOOTSTRAP=1
    fuzz() { cargo fuzz "$@"; }
fi
targets=${1:-$(fuzz list)}
failed=
for target in $targets; do
    mkdir -p "corpus/$target" "regressions/$target"
    # Short inputs suffice: the interesting part of a video or an image is its head, and networks and objects are graphs.
    fuzz run "$target" "corpus/$target" "seeds/$target" "regressions/$target" -- \
        -max_total_time="$seconds" -timeout=5 -rss_limit_mb=2048 -max_len=16384 -detect_leaks=0 -print_final_stats=1 ||
        failed="$failed $target"
done
test -z "$failed" || { echo "failed:$failed"; exit 1; }
