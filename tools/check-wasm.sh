#!/usr/bin/env bash
# Builds the crates that a web page needs for wasm32-unknown-unknown, without threads, files and networks: the core, the pipeline, the
# report and what draws an object in live footage.
set -euo pipefail
cd "$(dirname "$0")/.."
build=(cargo build --release --lib -p blindaug -p blindaug-pipeline -p blindaug-report -p blindaug-stage --no-default-features --target wasm32-unknown-unknown)
if rustup target add wasm32-unknown-unknown 2>/dev/null; then
    "${build[@]}"
else
    # Where the target's libraries cannot be downloaded, Debian's compiler for the web builds them from its own sources.
    dpkg -s rustc-web rust-web-src >/dev/null 2>&1 ||
        (apt-get update -qq && apt-get install -y -qq --no-install-recommends rustc-web rust-web-src)
    linker=$(find "${RUSTUP_HOME:-$HOME/.rustup}/toolchains" -name rust-lld | head -1)
    RUSTC=$(dpkg -L rustc-web | grep 'bin/rustc$') RUSTC_BOOTSTRAP=1 \
        CARGO_TARGET_WASM32_UNKNOWN_UNKNOWN_LINKER=$linker "${build[@]}" -Zbuild-std=std,panic_abort
fi
echo "blindaug, blindaug-pipeline, blindaug-report and blindaug-stage build for wasm32-unknown-unknown"
