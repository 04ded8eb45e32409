# Sourced by the checks that need a browser: `source tools/browser.sh NAME "${1:-}"`. Sets `browser`, a folder
# `work` that is removed at the end, and the folder `shots` for screenshots: the second argument, otherwise a temporary one.
for tool in node npm; do
    command -v $tool >/dev/null || { echo "$1: $tool is missing: install Node.js, such as by apt-get install nodejs npm" >&2; exit 1; }
done
browser=$(command -v chromium) || { echo "$1: chromium is missing: install it, such as by apt-get install chromium" >&2; exit 1; }
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
shots=${2:-$(mktemp -d)}
mkdir -p "$shots"
shots=$(cd "$shots" && pwd)
