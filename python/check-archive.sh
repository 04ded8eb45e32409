#!/usr/bin/env bash
# Makes archives on Ray while its workers, its machines and its driver are killed, and compares them with those of one machine; prints what one and
# two workers take. Needs what check.sh needs, and some minutes; the environment has ray, 600 MB. PYTHON=PROGRAM names a Python that has blindaug,
# ray, duckdb, pandas, psutil, pillow and pytest.
set -euo pipefail
cd "$(dirname "$0")"
if [ -z "${PYTHON:-}" ]; then
    target=$(cargo metadata --no-deps --format-version 1 | sed 's/.*"target_directory":"\([^"]*\)".*/\1/')
    environment="$target/venv-ray"
    python3 -m venv "$environment"
    PYTHON="$environment/bin/python"
    "$PYTHON" -m pip install --quiet --upgrade "maturin>=1.16,<2" "ray[data]>=2.51" duckdb psutil pillow "pytest>=8"
    rm -rf "$target/wheels-release"
    "$environment/bin/maturin" build --quiet --locked --release --out "$target/wheels-release"
    "$PYTHON" -m pip install --quiet --force-reinstall --no-deps "$target"/wheels-release/blindaug-*.whl
fi
# Ray's workers give way to all other processes unless they are told not to; here they are timed.
export RAY_worker_niceness=0
# The machines of the tests' cluster are this one, at 127.0.0.1.
export RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER=0
cd heavy
exec "$PYTHON" -m pytest -q -s -p no:cacheprovider "$@" .
