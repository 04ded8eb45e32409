#!/usr/bin/env bash
# Answers a small questionnaire in Chromium, from file://, and reads the exported answers again.
#
#   tools/check-study.sh [FOLDER]      # FOLDER for the screenshots, otherwise a temporary one
set -euo pipefail
root=$(cd "$(dirname "$0")/.." && pwd)
source "$root/tools/browser.sh" check-study "${1:-}"
cd "$root"
cargo build --quiet -p blindaug-research --example questionnaire
example=${CARGO_TARGET_DIR:-$PWD/target}/debug/examples/questionnaire
"$example" "$work/kit"
npm install --silent --no-audit --no-fund --prefix "$work" playwright-core >/dev/null ||
    { echo "check-study: npm could not install playwright-core" >&2; exit 1; }
node "$root/tools/study/check.mjs" "$work" "$browser" "$shots" "$example"
