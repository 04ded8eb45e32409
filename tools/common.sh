# Sourced by the checks, from the root of the repository.

# need PACKAGE COMMAND: installs Debian's PACKAGE where there is no COMMAND.
need() {
    command -v "$2" >/dev/null && return
    echo "installing $1"
    (apt-get update -qq && apt-get install -y -qq --no-install-recommends "$1") >/dev/null
}

# The program to check: BLINDAUG, otherwise built.
if [[ -z ${BLINDAUG:-} ]]; then
    cargo build --release --quiet -p blindaug-cli
    BLINDAUG=${CARGO_TARGET_DIR:-$PWD/target}/release/blindaug
fi
