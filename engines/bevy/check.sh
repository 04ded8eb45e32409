#!/usr/bin/env bash
# Builds, lints and tests the plugin for Bevy, and renders the example's picture. Needs ffmpeg for nothing but videos that are not H.264.
set -euo pipefail
cd "$(dirname "$0")"

# Mesa's software Vulkan is a graphics device wherever there is no other.
if ! ls /usr/share/vulkan/icd.d/*.json >/dev/null 2>&1 && command -v apt-get >/dev/null; then
    (apt-get update -qq && apt-get install -y -qq --no-install-recommends mesa-vulkan-drivers libvulkan1) >/dev/null 2>&1 ||
        echo "Mesa's software Vulkan could not be installed: the tests that need a graphics device will fail"
fi
# Tests that find no graphics device fail rather than say so and pass.
export BLINDAUG_NEED_GPU=1

cargo fmt --all --check
cargo clippy --locked --workspace --all-targets --quiet -- -D warnings
RUSTDOCFLAGS="-D warnings" cargo doc --locked --workspace --no-deps --quiet
cargo test --locked --workspace
