#!/usr/bin/env bash
# Builds the Python package's wheel, installs it into an environment of its own, and runs its tests and type checks. Needs Python 3.10 or later with
# venv, and PyPI. BLINDAUG=PROGRAM is the command line that results are compared with; without it, it is built. PROFILE=release builds the wheel as
# it is published.
set -euo pipefail
cd "$(dirname "$0")"
profile=${PROFILE:-dev}
target=$(cargo metadata --no-deps --format-version 1 | sed 's/.*"target_directory":"\([^"]*\)".*/\1/')
environment="$target/venv"
wheels="$target/wheels-$profile"

cargo fmt --all --check
cargo clippy --locked --all-targets --quiet -- -D warnings
RUSTDOCFLAGS="-D warnings" cargo doc --locked --no-deps --document-private-items --quiet

python3 -m venv "$environment"
"$environment/bin/pip" install --quiet --upgrade "maturin>=1.16,<2" numpy "pytest>=8" mypy pillow OpenEXR
rm -rf "$wheels"
"$environment/bin/maturin" build --quiet --locked --profile "$profile" --out "$wheels"
"$environment/bin/pip" install --quiet --force-reinstall --no-deps "$wheels"/blindaug-*.whl

if [ -z "${BLINDAUG:-}" ]; then
    cargo build --quiet --manifest-path ../Cargo.toml -p blindaug-cli --target-dir "$target"
    export BLINDAUG="$target/debug/blindaug"
fi
# The installed package is tested, not the folder beside this script.
(cd tests && "$environment/bin/python" -m pytest -q -c ../pyproject.toml --rootdir . .)
"$environment/bin/python" -m mypy --config-file pyproject.toml
"$environment/bin/python" -m mypy.stubtest --mypy-config-file pyproject.toml --ignore-disjoint-bases blindaug
