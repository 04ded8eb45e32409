#!/usr/bin/env bash
# Builds, lints and tests the OpenFX plugin, also in a host made of the OpenFX project's own HostSupport library. Needs g++ and libexpat's
# headers (Debian: g++ libexpat1-dev). HOSTSUPPORT=FOLDER is that library, if it is at hand; else it comes with the package openfx-sys.
set -euo pipefail
cd "$(dirname "$0")"

target=$(cargo metadata --no-deps --format-version 1 | sed 's/.*"target_directory":"\([^"]*\)".*/\1/')
build="$target/ofx_host"
mkdir -p "$build/objects"

if [ -z "${HOSTSUPPORT:-}" ]; then
    # The package is only fetched, with nothing of it compiled as Rust.
    mkdir -p "$build/fetch/src"
    cp demo_host/fetch.toml "$build/fetch/Cargo.toml"
    touch "$build/fetch/src/lib.rs"
    grep -q '^\[workspace\]' "$build/fetch/Cargo.toml" || printf '\n[workspace]\n' >> "$build/fetch/Cargo.toml"
    manifest=$(cargo metadata --format-version 1 --manifest-path "$build/fetch/Cargo.toml" |
        grep -o '"manifest_path":"[^"]*/openfx-sys-[^"]*"' | head -1 | sed 's/.*:"\(.*\)"/\1/')
    HOSTSUPPORT="$(dirname "$manifest")/openfx/HostSupport"
fi
objects=()
for source in "$HOSTSUPPORT"/src/*.cpp demo_host/main.cpp; do
    object="$build/objects/$(basename "$source" .cpp).o"
    objects+=("$object")
    if [ ! "$object" -nt "$source" ]; then
        # The library leaves out an include, and declares exceptions as C++17 no longer allows.
        g++ -std=c++14 -O1 -w -include cstring -I"$HOSTSUPPORT/../include" -I"$HOSTSUPPORT/include" -c "$source" -o "$object"
    fi
done
g++ "${objects[@]}" -lexpat -ldl -o "$build/host"

cargo fmt --all --check
cargo clippy --locked --workspace --all-targets --quiet -- -D warnings
RUSTDOCFLAGS="-D warnings" cargo doc --locked --workspace --no-deps --quiet
./bundle.sh "$build/bundle"
export BLINDAUG_OFX_HOST="$build/host" BLINDAUG_OFX_BUNDLE="$build/bundle"
cargo test --locked --workspace -- --include-ignored
