#!/usr/bin/env bash
# Builds what is released, for every platform whose toolchain is at hand: the command line as an archive, and the Python wheel, into dist/ with their
# SHA-256 sums. What was built is run where this machine can run it. A table at the end says what was built, and what was not and why.
#
# On Linux: programs and wheels for glibc 2.28 and later, compiled by zig, which pip installs; the other architecture where rustup has its target.
# On macOS: both architectures, with Xcode's command line tools. On Windows (Git Bash): x86_64, with Visual Studio's build tools.
# Needs Rust, Python 3.10 or later with venv, and PyPI. An argument names the targets: tools/release.sh x86_64-unknown-linux-gnu
set -euo pipefail
cd "$(dirname "$0")/.."
glibc=2.28
targets=("$@")
if [ ${#targets[@]} = 0 ]; then
    targets=(x86_64-unknown-linux-gnu aarch64-unknown-linux-gnu x86_64-apple-darwin aarch64-apple-darwin x86_64-pc-windows-msvc)
fi
version=$(cargo metadata --no-deps --format-version 1 | sed 's/.*"name":"blindaug-cli","version":"\([^"]*\)".*/\1/')
host=$(rustc -vV | sed -n 's/^host: //p')
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
dist=$PWD/dist
rm -rf "$dist"
mkdir -p "$dist"

python3 -m venv "$work/tools" 2>/dev/null || python -m venv "$work/tools"
bin="$work/tools/bin"
[ -d "$bin" ] || bin="$work/tools/Scripts"
packages=("maturin>=1.16,<2")
case $host in *-linux-gnu) packages+=("ziglang>=0.13" "cargo-zigbuild>=0.23") ;; esac
"$bin/python" -m pip install --quiet "${packages[@]}"
PATH="$bin:$PATH"

# Why this machine cannot build for a target; nothing if it can.
why_not() {
    case $1 in
    *-linux-gnu) [[ $host = *-linux-gnu ]] || { echo "needs Linux"; return; } ;;
    *-apple-darwin) [[ $host = *-apple-darwin ]] || { echo "needs macOS: Apple's SDK is for its own machines"; return; } ;;
    *-windows-msvc) [[ $host = *-windows-msvc ]] || { echo "needs Windows with Visual Studio's build tools"; return; } ;;
    esac
    [ -d "$(rustc --print sysroot)/lib/rustlib/$1/lib" ] || echo "Rust's library is not here: rustup target add $1"
}

# Whether this machine can run what is built for a target.
runs() { [ "$1" = "$host" ]; }

build_program() {
    local target=$1 suffix="" name="blindaug-$version-$1"
    case $target in
    *-linux-gnu) cargo zigbuild --release --locked -p blindaug-cli --target "$target.$glibc" ;;
    *) cargo build --release --locked -p blindaug-cli --target "$target" ;;
    esac
    [[ $target = *-windows-* ]] && suffix=.exe
    local program="${CARGO_TARGET_DIR:-target}/$target/release/blindaug$suffix"
    if runs "$target"; then "$program" --version >/dev/null; fi
    mkdir -p "$work/$name"
    cp "$program" README.md CHANGELOG.md LICENSE-MIT LICENSE-APACHE "$work/$name/"
    if [[ $target = *-windows-* ]]; then
        (cd "$work" && python -m zipfile -c "$dist/$name.zip" "$name")
        built="$name.zip"
    else
        tar -C "$work" -czf "$dist/$name.tar.gz" "$name"
        built="$name.tar.gz"
    fi
}

build_wheel() {
    local target=$1 options=()
    [[ $target = *-linux-gnu ]] && options=(--zig --compatibility "manylinux_${glibc/./_}")
    rm -rf "$work/wheel"
    (cd python && maturin build --release --locked --target "$target" --out "$work/wheel" "${options[@]}")
    built=$(basename "$work"/wheel/*.whl)
    cp "$work/wheel/$built" "$dist/"
    if runs "$target"; then
        "$bin/python" -m pip install --quiet --force-reinstall "$dist/$built"
        (cd "$work" && "$bin/python" - "$OLDPWD/apps/cli/assets/demo/frames" <<'PYTHON'
import sys

import blindaug

exposure = blindaug.estimate(sys.argv[1], fps=30).exposure
assert exposure.interval[0] < 0.6 < exposure.interval[1], exposure
PYTHON
        )
    fi
}

rows=()
for target in "${targets[@]}"; do
    why=$(why_not "$target")
    if [ -n "$why" ]; then
        rows+=("$target|not built|$why")
        continue
    fi
    for what in wheel program; do
        # Not in a condition, which would turn off that a command's failure ends the function.
        set +e
        (set -e; "build_$what" "$target"; echo "$built" >"$work/built") >"$work/log" 2>&1
        status=$?
        set -e
        if [ $status = 0 ]; then
            if runs "$target"; then note="run here"; else note="not run: another machine's"; fi
            rows+=("$target|$(cat "$work/built")|$note")
        else
            cp "$work/log" "$dist/$what-$target.log"
            rows+=("$target|not built|the $what failed: dist/$what-$target.log")
        fi
    done
done
(cd "$dist" && for file in *.whl *.tar.gz *.zip; do [ -e "$file" ] && { sha256sum "$file" 2>/dev/null || shasum -a 256 "$file"; }; done) >"$work/sums" || true
mv "$work/sums" "$dist/SHA256SUMS"

echo
printf '%-28s  %-62s  %s\n' target file note
for row in "${rows[@]}"; do
    IFS='|' read -r target file note <<<"$row"
    printf '%-28s  %-62s  %s\n' "$target" "$file" "$note"
done
# A toolchain that is not here is no failure, a build that failed is one.
! ls "$dist"/*.log >/dev/null 2>&1
