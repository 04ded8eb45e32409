#!/usr/bin/env python3
"""How well the lens is told by one photograph with depth, for foci from its farthest to its nearest thing.

    pip install numpy scipy opencv-python-headless
    python tools/lens/stack.py BLINDAUG PHOTO DEPTH [BLUR ..] [--points disk|gaussian]

DEPTH: disparity as .npz (one array, px) or depth as 16-bit PNG in mm; what is not known is taken from what is behind it. BLUR: the std of the
blur, px, that things as near as the nearest have when the focus is at infinity (10 and 20). The photograph is cut into 40 layers of depth, which
are blurred in light by disks (or Gaussians of the same std), each seen between what is nearer, and noise of std 0.008 is added. Prints what the
estimate says of each focus: the blur at infinity and the focus (inverse depth; the nearest thing has 1), each with its 95 % interval beside the
truth, the shape of out-of-focus points where it is told, and how near the sharp photograph comes to the blurred one (PSNR, dB) as it is, through
the lens that was found, and through the true one.
"""

import argparse
import json
import subprocess
import tempfile
from pathlib import Path

import cv2
import numpy as np
from scipy import ndimage

LAYERS, FOCI, NOISE = 40, 8, 0.008
LARGEST = 60000


def to_light(v):
    return np.where(v <= 0.04045, v / 12.92, ((v + 0.055) / 1.055) ** 2.4)


def encoded(v):
    v = np.clip(v, 0, 1)
    return np.where(v <= 0.0031308, 12.92 * v, 1.055 * v ** (1 / 2.4) - 0.055)


def inverse_depth(path, size):
    """Inverse depth whose largest value is 1."""
    if path.endswith(".npz"):
        known = next(iter(np.load(path).values())).astype(float)
    else:
        depth = cv2.imread(path, cv2.IMREAD_UNCHANGED).astype(float)
        known = np.divide(1000, depth, where=depth > 0, out=np.full(depth.shape, np.nan))
    known[~np.isfinite(known) | (known <= 0)] = np.nan
    # The farther one of the nearest known values to the left and to the right.
    sides = []
    for turned in (known, known[:, ::-1]):
        index = np.where(np.isnan(turned), 0, np.arange(turned.shape[1]))
        filled = np.take_along_axis(turned, np.maximum.accumulate(index, axis=1), 1)
        sides.append(filled if turned is known else filled[:, ::-1])
    filled = np.fmin(*sides)
    nearest = ndimage.distance_transform_edt(np.isnan(filled), return_distances=False, return_indices=True)
    filled = cv2.resize(filled[tuple(nearest)], size, interpolation=cv2.INTER_NEAREST)
    return filled / filled.max()


def disk(radius):
    n = int(np.ceil(radius + 1))
    y, x = np.mgrid[-n : n + 1, -n : n + 1]
    steps = (np.arange(8) + 0.5) / 8 - 0.5
    kernel = sum(((x + a) ** 2 + (y + b) ** 2 <= radius * radius).astype(float) for a in steps for b in steps)
    return kernel / kernel.sum()


def gaussian(radius):
    std = radius / 2
    n = int(np.ceil(4 * std + 1))
    y, x = np.mgrid[-n : n + 1, -n : n + 1]
    kernel = np.exp(-(x * x + y * y) / (2 * std * std))
    return kernel / kernel.sum()


def through_a_lens(light, depth, blur, focus, points):
    low, high = depth.min(), depth.max()
    layer_of = np.clip(((depth - low) / (high - low) * LAYERS).astype(int), 0, LAYERS - 1)
    seen = np.zeros_like(light)
    for layer in range(LAYERS):
        mask = (layer_of == layer).astype(float)
        radius = 2 * blur * abs(low + (layer + 0.5) / LAYERS * (high - low) - focus)
        kernel = points(radius) if radius > 0.3 else np.ones((1, 1))

        def blurred(v):
            return cv2.filter2D(v, -1, kernel, borderType=cv2.BORDER_REFLECT)

        share = blurred(mask)
        colour = np.stack([blurred(light[..., c] * mask) for c in range(3)], -1) / np.maximum(share, 1e-4)[..., None]
        alpha = np.clip(share / np.maximum(blurred((layer_of <= layer).astype(float)), 1e-3), 0, 1)[..., None]
        seen = seen * (1 - alpha) + colour * alpha
    return seen


def to_bytes(v):
    return (np.clip(v, 0, 1) * 255 + 0.5).astype(np.uint8)


def psnr(a, b):
    return 10 * np.log10(255**2 / np.mean((a.astype(float) - b) ** 2))


def main():
    parser = argparse.ArgumentParser()
    for name in ("program", "photo", "depth"):
        parser.add_argument(name)
    parser.add_argument("blurs", nargs="*", type=float, default=[10.0, 20.0])
    parser.add_argument("--points", choices=["disk", "gaussian"], default="disk")
    given = parser.parse_args()
    points = {"disk": disk, "gaussian": gaussian}[given.points]
    program = given.program
    image = cv2.imread(given.photo)[..., ::-1] / 255
    depth = inverse_depth(given.depth, image.shape[1::-1])
    rng = np.random.default_rng(1)
    print(f"{'blur':>5} {'focus':>6} {'mean blur, px':>14}  {'blur at infinity, px':32} {'focus':30}")
    covered, nearness = [0, 0, 0], []
    for blur in given.blurs:
        for focus in np.linspace(*np.percentile(depth, [2, 98]), FOCI):
            blurred = encoded(through_a_lens(to_light(image), depth, blur, focus, points))
            picture = blurred + NOISE * rng.normal(size=blurred.shape)
            with tempfile.TemporaryDirectory() as folder:
                for name, pixels in [
                    ("frame", to_bytes(picture)[..., ::-1]),
                    ("sharp", to_bytes(image)[..., ::-1]),
                    ("depth", np.clip(depth * LARGEST, 1, 65535).astype(np.uint16)),
                ]:
                    Path(folder, name).mkdir()
                    cv2.imwrite(f"{folder}/{name}/0001.png", pixels)
                options = ["--depth", f"{folder}/depth", "--depth-kind", "inverse", "--depth-scale", str(LARGEST)]
                subprocess.run([program, "estimate", f"{folder}/frame", *options, "-o", f"{folder}/camera.json"], check=True, capture_output=True)
                lens = json.loads(Path(folder, "camera.json").read_text())["defocus"]
                near = [psnr(to_bytes(blurred), to_bytes(image))]
                true = ["--blur", str(blur * focus), "--focus", str(1 / focus), "--bokeh", given.points]
                for by_hand in [[], true] if "interval" in lens else []:
                    camera = ["--camera", f"{folder}/camera.json", "--no-noise", *by_hand, "--overwrite", "-o", f"{folder}/out"]
                    subprocess.run([program, "apply", f"{folder}/sharp", *options, *camera], check=True, capture_output=True)
                    near.append(psnr(to_bytes(blurred), cv2.imread(f"{folder}/out/0001.png")[..., ::-1]))
            line = f"{blur:5.0f} {focus:6.2f} {np.mean(blur * abs(depth - focus)):14.1f}  "
            if "interval" not in lens:
                print(line + str(lens.get("unknown")))
                continue
            truths = {"sigma_px_at_infinity": blur * focus, "focus_inverse_depth": focus}
            within = []
            for name, truth in truths.items():
                lo, hi = lens["interval"][name]
                within.append(lo <= truth <= hi)
                line += f"{lens[name]:.2f} ({lo:.2f} to {hi:.2f}) for {truth:.2f}".ljust(33)
            line += " ".join(f"{k} {v}" for k, v in lens.get("bokeh", {}).items()).ljust(16)
            print(line + " ".join(f"{v:5.1f}" for v in near), flush=True)
            nearness.append(near)
            covered = [covered[0] + 1, covered[1] + within[0], covered[2] + within[1]]
    print(f"of {covered[0]} that are known, {covered[1]} intervals hold the blur at infinity and {covered[2]} the focus")
    for name, dB in zip(["as it is", "through the lens found", "through the true lens"], np.mean(nearness, 0) if nearness else []):
        print(f"PSNR of the sharp photograph {name}: {dB:.2f} dB in the mean")


if __name__ == "__main__":
    main()
