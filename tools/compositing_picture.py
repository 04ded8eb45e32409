#!/usr/bin/env python3
"""Draws docs/compositing.png from the demo's clip: the plate, the object as it was rendered, the layer, and the layer over the plate.

    tools/compositing_picture.py BLINDAUG      # the program; needs pip install openexr pillow
"""

import pathlib
import subprocess
import sys
import tempfile

import numpy as np
import OpenEXR
from PIL import Image

root = pathlib.Path(__file__).parent.parent
clip = root / "apps/cli/assets/demo"
blindaug = sys.argv[1]


def channels(path, *names):
    with OpenEXR.File(str(path), separate_channels=True) as file:
        found = file.channels()
        return np.stack([found[n].pixels.astype(np.float32) for n in names], axis=-1)


def decode(v):
    return np.where(v <= 0.04045, v / 12.92, ((v + 0.055) / 1.055) ** 2.4)


def encode(v):
    v = np.clip(v, 0, 1)
    return np.where(v <= 0.0031308, 12.92 * v, 1.055 * v ** (1 / 2.4) - 0.055)


def over(layer, under):
    return layer[..., :3] + (1 - layer[..., 3:4]) * under


with tempfile.TemporaryDirectory() as folder:
    run = lambda *words: subprocess.run([blindaug, *map(str, words)], check=True, stdout=subprocess.DEVNULL)
    camera = pathlib.Path(folder) / "camera.json"
    run("estimate", clip / "frames", "--depth", clip / "scene", "-o", camera)
    run("composite", clip / "frames", "--virtual", clip / "virtual", "--camera", camera, "--depth", clip / "scene",
        "--layer", "--bits", "32", "--frames", "3..3", "-o", folder)
    layer = channels(pathlib.Path(folder) / "0003.exr", "R", "G", "B", "A")
    noise = channels(pathlib.Path(folder) / "0003.exr", "noise.R", "noise.G", "noise.B")
plate = decode(np.asarray(Image.open(clip / "frames/0003.png").convert("RGB"), dtype=np.float32) / 255)
rendered = channels(clip / "virtual/0003.exr", "R", "G", "B", "A")
# Where the layer is transparent, squares show it.
y, x = np.indices(plate.shape[:2])
squares = np.where(((x // 16 + y // 16) % 2)[..., None], 0.25, 0.18) * np.ones(3)
pictures = [plate, over(rendered, plate), over(layer, squares) + noise, over(layer, plate) + noise]
gap = np.ones((plate.shape[0], 8, 3))
strip = np.concatenate([part for p in pictures for part in (encode(p), gap)][:-1], axis=1)
Image.fromarray((strip * 255 + 0.5).astype(np.uint8)).save(root / "docs/compositing.png", optimize=True)
