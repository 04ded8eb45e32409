#!/usr/bin/env bash
# Builds the Python package's wheel, installs it into an environment of its own, runs its tests and type checks, and builds its site. Needs Python
# 3.10 or later with venv, and PyPI. BLINDAUG=PROGRAM is the program that results are compared with; without it, it is built. PROFILE=release
# builds the wheel as it is published. `check.sh environment` only makes the environment, and fails where there is no such Python or no PyPI.
set -euo pipefail
cd "$(dirname "$0")"
root=$(dirname "$PWD")
profile=${PROFILE:-dev}
# The target folder and the profiles of the main workspace, so that what both need from others is compiled once.
export CARGO_TARGET_DIR=${CARGO_TARGET_DIR:-$root/target}
settings=(--config "$root/Cargo.toml")
environment="$CARGO_TARGET_DIR/venv"
wheels="$CARGO_TARGET_DIR/wheels-$profile"

python3 -c 'import sys, venv, ensurepip; assert sys.version_info >= (3, 10)'
python3 -m venv "$environment"
"$environment/bin/pip" install --quiet --upgrade "maturin>=1.16,<2" numpy "pytest>=8" hypothesis mypy pillow OpenEXR pyarrow nbclient ipykernel \
    mkdocs mkdocs-jupyter av opencv-python-headless
[ "${1:-}" != environment ] || exit 0

cargo fmt --all --check
cargo clippy "${settings[@]}" --locked --all-targets --quiet -- -D warnings
RUSTDOCFLAGS="-D warnings" cargo doc "${settings[@]}" --locked --no-deps --document-private-items --quiet
rm -rf "$wheels"
"$environment/bin/maturin" build "${settings[@]}" --quiet --locked --profile "$profile" --out "$wheels"
"$environment/bin/pip" install --quiet --force-reinstall --no-deps "$wheels"/blindaug-*.whl

if [ -z "${BLINDAUG:-}" ]; then
    cargo build --quiet --manifest-path "$root/Cargo.toml" -p blindaug-cli
    export BLINDAUG="$CARGO_TARGET_DIR/debug/blindaug"
fi
# The installed package is tested, not the folder beside this script.
(cd tests && "$environment/bin/python" -m pytest -q -c ../pyproject.toml --rootdir . .)
"$environment/bin/python" -m mypy --config-file pyproject.toml
(cd tests && "$environment/bin/python" -m mypy.stubtest --mypy-config-file ../pyproject.toml --allowlist stubtest.txt --ignore-disjoint-bases blindaug)
"$environment/bin/mkdocs" build --strict --quiet --config-file mkdocs.yml --site-dir "$CARGO_TARGET_DIR/site"
