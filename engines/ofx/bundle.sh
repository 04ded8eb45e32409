#!/usr/bin/env bash
# Builds the plugin and puts it into its bundle: ./bundle.sh [FOLDER], which becomes FOLDER/blindaug.ofx.bundle [default: bundle].
set -euo pipefail
cd "$(dirname "$0")"
to="${1:-bundle}/blindaug.ofx.bundle/Contents"
cargo build --locked --release -p blindaug_ofx
folder=$(cargo metadata --locked --no-deps --format-version 1 | sed 's/.*"target_directory":"\([^"]*\)".*/\1/')
case "$(uname -s)-$(uname -m)" in
    Linux-x86_64) place=Linux-x86-64 library=libblindaug_ofx.so ;;
    Darwin-*) place=MacOS library=libblindaug_ofx.dylib ;;
    MINGW*-* | MSYS*-* | CYGWIN*-*) place=Win64 library=blindaug_ofx.dll ;;
    *) echo "there is no name for the plugin's folder on $(uname -s) $(uname -m)" >&2; exit 1 ;;
esac
mkdir -p "$to/$place"
# A host may have the old file open: it is replaced, not written into.
cp "$folder/release/$library" "$to/$place/blindaug.ofx.new"
mv "$to/$place/blindaug.ofx.new" "$to/$place/blindaug.ofx"
cp Info.plist "$to/"
echo "$to/$place/blindaug.ofx"
