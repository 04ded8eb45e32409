#!/usr/bin/env bash
# Exports known networks with random weights, runs them in ONNX Runtime against PyTorch, and then in blindaug by their manifests.
#
#   tools/check-nets.sh [FOLDER [NAME...]]      # FOLDER for the networks, otherwise a temporary one
#
# PYTHON: a Python that has tools/nets/requirements.txt, otherwise one is made in FOLDER, which downloads 6 GB.
# BLINDAUG: the program, otherwise built. Without NAMEs: all but those that take more than 4 GB of memory or more to install:
# depth-pro, sea-raft-m and flownet2 (ptlflow), maxim-denoising (npm, 83 MB). Takes some minutes on two cores.
# Run with torch 2.15, torchvision 0.29, transformers 5.23, spandrel 0.4.2, onnxruntime 1.31, Python 3.11.
set -euo pipefail
root=$(cd "$(dirname "$0")/.." && pwd)
if (($#)); then
    mkdir -p "$1"
    folder=$(cd "$1" && pwd)
    shift
else
    folder=$(mktemp -d)
    trap 'rm -rf "$folder"' EXIT
fi
cd "$root"
names=("$@")
((${#names[@]})) || names=(ffdnet-color nafnet-sidd-width32 nafnet-gopro-width32 scunet-color-real restormer-real-denoising
    raft-small raft-large depth-anything-v2-small dpt-large depth-pro-tiny)
if [[ -z ${PYTHON:-} ]]; then
    python3 -m venv "$folder/python"
    PYTHON=$folder/python/bin/python
    "$PYTHON" -m pip install -q -r tools/nets/requirements.txt
fi
source tools/common.sh

status=0
"$PYTHON" -W ignore tools/nets/check.py "$folder" "${names[@]}" || status=1
manifests=()
for name in "${names[@]}"; do
    [[ -e $folder/$name/$name.toml ]] && manifests+=("$folder/$name/$name.toml")
done
((${#manifests[@]})) && { "$BLINDAUG" models check "${manifests[@]}" || status=1; }
((status == 0)) && echo "networks: ONNX Runtime agrees with PyTorch, and blindaug runs them"
exit "$status"
