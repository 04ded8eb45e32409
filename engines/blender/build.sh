#!/usr/bin/env bash
# Builds the extension: ./build.sh [FOLDER], which becomes FOLDER/blindaug-VERSION.zip [default: the repository's target/blender].
#
# The wheel of the Python package is built for this system, with Rust and a C++ compiler. WHEELS=FOLDER takes wheels that are there instead, one
# for each system. With Blender on the path, Blender packs and validates the extension.
set -euo pipefail
cd "$(dirname "$0")"
root=$(realpath ../..)
out=$(realpath -m "${1:-$root/target/blender}")
tree="$out/blindaug"
rm -rf "$tree"
mkdir -p "$tree/wheels"
if [[ -n ${WHEELS:-} ]]; then
    cp "$WHEELS"/blindaug-*.whl "$tree/wheels/"
else
    maturin=maturin
    if ! command -v maturin >/dev/null; then
        python3 -m venv "$out/venv"
        "$out/venv/bin/pip" install --quiet "maturin>=1.16,<2"
        maturin=$out/venv/bin/maturin
    fi
    (cd "$root/python" && "$maturin" build --quiet --locked --release --out "$tree/wheels")
fi
cp addon/*.py "$tree/"
# What sets the scene is the exporter's text.
cp "$root/crates/blindaug/src/export/effects/blender_scene.py" "$tree/scene.py"
cp "$root/LICENSE-MIT" "$root/LICENSE-APACHE" README.md "$tree/"

zip=$(python3 - addon/blender_manifest.toml "$tree" "$out" <<'PY'
import pathlib
import re
import sys
import zipfile

manifest, tree, out = map(pathlib.Path, sys.argv[1:])
# Blender's names of systems, by what the names of wheels end with.
SYSTEMS = {
    r"linux\w*_x86_64": "linux-x64",
    r"linux\w*_aarch64": "linux-arm64",
    r"macosx\w*_x86_64": "macos-x64",
    r"macosx\w*_arm64": "macos-arm64",
    r"win_amd64": "windows-x64",
    r"win_arm64": "windows-arm64",
}
wheels = sorted((tree / "wheels").glob("*.whl"))
platforms = []
text = manifest.read_text(encoding="utf-8")
version = re.search(r'^version = "(.*)"$', text, re.MULTILINE)[1]
for wheel in wheels:
    _, of, _, _, tag = wheel.stem.split("-")
    if of != version:
        sys.exit(f"{wheel.name}: blender_manifest.toml has version {version}; make them the same")
    found = [name for pattern, name in SYSTEMS.items() if re.search(pattern + "$", tag)]
    if not found:
        sys.exit(f"{wheel.name}: Blender has no name for the system {tag}")
    platforms += found
if not wheels:
    sys.exit("there is no wheel in wheels/")


def listed(names):
    return "[" + ", ".join(f'"{name}"' for name in names) + "]"


text, platforms_found = re.subn(r"^platforms = \[\]$", f"platforms = {listed(platforms)}", text, flags=re.MULTILINE)
text, wheels_found = re.subn(
    r"^wheels = \[\]$", f"wheels = {listed(f'./wheels/{wheel.name}' for wheel in wheels)}", text, flags=re.MULTILINE
)
assert platforms_found == wheels_found == 1
(tree / manifest.name).write_text(text, encoding="utf-8")
packed = out / f"blindaug-{version}.zip"
with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
    for path in sorted(tree.rglob("*")):
        if path.is_file():
            archive.write(path, path.relative_to(tree))
print(packed)
PY
)
if command -v blender >/dev/null; then
    blender --command extension build --source-dir "$tree" --output-filepath "$zip" >/dev/null
    blender --command extension validate "$zip"
fi
echo "$zip"
