#!/usr/bin/env bash
# Answers the questionnaire of `blindaug study make` in Chromium, on a phone's and on a desktop's screen: order, saving, export.
#
#   tools/check-study.sh [FOLDER]      # FOLDER for the screenshots, otherwise a temporary one
set -euo pipefail
root=$(cd "$(dirname "$0")/.." && pwd)
for tool in node npm ffmpeg; do
    command -v $tool >/dev/null || { echo "check-study: $tool is missing: install it, such as by apt-get install nodejs npm ffmpeg" >&2; exit 1; }
done
browser=$(command -v chromium) ||
    { echo "check-study: chromium is missing: install it, such as by apt-get install chromium" >&2; exit 1; }
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
shots=${1:-$(mktemp -d)}
mkdir -p "$shots"
shots=$(cd "$shots" && pwd)
cd "$root"
npm install --silent --no-audit --no-fund --prefix "$work" playwright-core >/dev/null ||
    { echo "check-study: npm could not install playwright-core" >&2; exit 1; }
example() { cargo run --quiet -p blindaug-research --example questionnaire -- "$@"; }
example "$work/kit"
node tools/study/check.mjs "$work" "$browser" "$shots"
for answers in "$work"/answers-*.csv; do
    said=$(example "$work/kit" "$answers")
    echo "ok      read again: $said"
    [[ $said == "24 answers, 2 tasks, notes: []" ]] || { echo "FAILED  24 answers to 2 tasks were given"; exit 1; }
done
# A page with another seed has another order, which the check must see.
sed -i 's/"seed":"5"/"seed":"6"/' "$work/kit/questionnaire.html"
if node tools/study/check.mjs "$work" "$browser" "$shots/control" >/dev/null 2>&1; then
    echo "FAILED  the check does not see a wrong order"
    exit 1
fi
echo "ok      a wrong order is seen"
echo "screenshots: $shots"
