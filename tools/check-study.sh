#!/usr/bin/env bash
# Answers a small questionnaire in Chromium, from file://, and reads the exported answers again.
#
#   tools/check-study.sh [FOLDER]      # FOLDER for the screenshots, otherwise a temporary one
set -euo pipefail
root=$(cd "$(dirname "$0")/.." && pwd)
for tool in node npm; do
    command -v $tool >/dev/null || { echo "check-study: $tool is missing: install Node.js, such as by apt-get install nodejs npm" >&2; exit 1; }
done
browser=$(command -v chromium) ||
    { echo "check-study: chromium is missing: install it, such as by apt-get install chromium" >&2; exit 1; }
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
shots=${1:-$(mktemp -d)}
mkdir -p "$shots"
shots=$(cd "$shots" && pwd)
cd "$root"
cargo build --quiet -p blindaug-research --example questionnaire
example=${CARGO_TARGET_DIR:-$PWD/target}/debug/examples/questionnaire
"$example" "$work/kit"
npm install --silent --no-audit --no-fund --prefix "$work" playwright-core >/dev/null ||
    { echo "check-study: npm could not install playwright-core" >&2; exit 1; }
node "$root/tools/study/check.mjs" "$work" "$browser" "$shots" "$example"
