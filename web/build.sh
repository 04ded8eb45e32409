#!/usr/bin/env bash
# Builds the npm package's WebAssembly into web/wasm, and with `threads` a second one for isolated pages into web/wasm-threads.
#
#   web/build.sh            # with SIMD, one thread
#   web/build.sh threads    # the second one as well
#   web/build.sh plain      # without SIMD into web/wasm-plain: only to measure what SIMD brings
set -euo pipefail
cd "$(dirname "$0")"
target=wasm32-unknown-unknown
version=$(grep -A1 '^name = "wasm-bindgen"$' Cargo.lock | sed -n 's/^version = "\(.*\)"/\1/p')
tools=$PWD/target/tools
bindgen=$(command -v wasm-bindgen || true)
if [[ -z $bindgen || $("$bindgen" --version) != *" $version" ]]; then
    bindgen=$tools/bin/wasm-bindgen
    [[ -x $bindgen && $("$bindgen" --version) == *" $version" ]] ||
        cargo install --quiet wasm-bindgen-cli --version "$version" --root "$tools"
fi

build=(cargo build --release --lib --target $target)
# Debian's compiler for the web comes with the sources of the standard library, for what needs that built anew.
debian() {
    dpkg -s rustc-web rust-web-src >/dev/null 2>&1 ||
        (apt-get update -qq && apt-get install -y -qq --no-install-recommends rustc-web rust-web-src)
    CARGO_TARGET_WASM32_UNKNOWN_UNKNOWN_LINKER=$(find "${RUSTUP_HOME:-$HOME/.rustup}/toolchains" -name rust-lld | head -1)
    RUSTC=$(dpkg -L rustc-web | grep 'bin/rustc$')
    export RUSTC RUSTC_BOOTSTRAP=1 CARGO_TARGET_WASM32_UNKNOWN_UNKNOWN_LINKER
}
# Where the target's libraries cannot be downloaded, they are built, too.
if rustup target add $target 2>/dev/null; then
    std=
else
    std=-Zbuild-std=std,panic_abort
    debian
fi

# bind FOLDER OUT: makes the module OUT of what was built in the folder.
bind() {
    rm -rf "$2"
    "$bindgen" --target web --remove-name-section --out-dir "$2" --out-name blindaug "$1/$target/release/blindaug_web.wasm"
}

case ${1:-} in
plain)
    CARGO_TARGET_DIR=target/plain "${build[@]}" $std
    bind target/plain wasm-plain
    ;;
*)
    RUSTFLAGS="-Ctarget-feature=+simd128" CARGO_TARGET_DIR=target/simd "${build[@]}" $std
    bind target/simd wasm
    ;;&
threads)
    # Threads need the standard library with atomics, thus its sources.
    [[ -e $(rustc --print sysroot)/lib/rustlib/src/rust/library/Cargo.lock ]] || debian
    RUSTC_BOOTSTRAP=1 CARGO_TARGET_DIR=target/threads \
        RUSTFLAGS="-Ctarget-feature=+simd128,+atomics,+bulk-memory -Clink-arg=--shared-memory -Clink-arg=--max-memory=2147483648 -Clink-arg=--import-memory -Clink-arg=--export=__wasm_init_tls -Clink-arg=--export=__tls_size -Clink-arg=--export=__tls_align -Clink-arg=--export=__tls_base" \
        "${build[@]}" --features threads -Zbuild-std=std,panic_abort
    bind target/threads wasm-threads
    # wasm-bindgen-rayon hands the module over in a way of which wasm-bindgen warns in the console of every page.
    sed -i 's/pkg\.default(data\.module, data\.memory)/pkg.default({ module_or_path: data.module, memory: data.memory })/' \
        wasm-threads/snippets/wasm-bindgen-rayon-*/src/workerHelpers.no-bundler.js
    ;;
esac
