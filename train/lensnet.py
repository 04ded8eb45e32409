"""Trains the LensNet-like baseline of `blindaug reproduce`: for each camera a network that blurs a rendered object as its lens does.

[1, 5, H, W] premultiplied scene-linear R, G, B, alpha, and alpha times inverse depth (1/m) -> [1, 4, H, W] the blurred layer. The network
says for each pixel how much of each of several copies of the layer, blurred by disks, makes the blurred layer; it sees how far alpha and
depth reach at each of these sizes. The captures come from `cargo run --release -p blindaug-research --example lensnet_captures -- DIR`."""
import argparse
import pathlib
import time

import numpy as np
import onnx
import onnxruntime
import torch
import torch.nn as nn
import torch.nn.functional as F

SIDE = 256
RADII = (0.0, 0.7, 1.1, 1.6, 2.3, 3.2, 4.5, 6.3, 9.0, 12.5, 17.5, 24.0, 32.0)  # px
WIDTH = 32


def disk(radius, reach):
    """The coverage of each pixel by a disk in its middle, from 9 x 9 points in each."""
    part = (torch.arange(9) - 4) / 9
    at = (torch.arange(-reach, reach + 1)[:, None] + part).flatten()
    inside = (at[:, None] ** 2 + at[None] ** 2 <= max(radius, 1e-6) ** 2).float()
    n = 2 * reach + 1
    k = inside.reshape(n, 9, n, 9).mean((1, 3))
    return k / k.sum()


class Copies(nn.Module):
    """The layer blurred by each of K disks: [1, 5, H, W] -> [5, K, H, W]; H and W are multiples of 8. Large disks blur a smaller layer."""

    def __init__(self):
        super().__init__()
        # How often the layer is halved before a disk blurs it, so that its radius is at most about 4.5 px.
        self.halvings = [max(0, int(np.ceil(np.log2(max(r, 1) / 4.5)))) for r in RADII]
        for i, (r, n) in enumerate(zip(RADII, self.halvings)):
            self.register_buffer(f"k{i}", disk(r / 2**n, int(np.ceil(r / 2**n)))[None, None])

    def forward(self, x):
        sizes = [x.transpose(0, 1)]
        while len(sizes) <= max(self.halvings):
            sizes.append(F.avg_pool2d(sizes[-1], 2))
        copies = []
        for i, n in enumerate(self.halvings):
            k = getattr(self, f"k{i}")
            copy = F.conv2d(sizes[n], k, padding=k.shape[-1] // 2)
            copies.append(copy if n == 0 else F.interpolate(copy, scale_factor=2**n, mode="bilinear", align_corners=False))
        return torch.cat(copies, 1)


class Mix(nn.Module):
    """The shares of the copies at each pixel, from alpha and mean inverse depth of each copy, and their sum: [5, K, H, W] -> [1, 4, H, W]."""

    def __init__(self):
        super().__init__()
        n = len(RADII)
        self.net = nn.Sequential(nn.Conv2d(2 * n, WIDTH, 1), nn.ReLU(), nn.Conv2d(WIDTH, WIDTH, 1), nn.ReLU(), nn.Conv2d(WIDTH, n, 1))

    def forward(self, copies):
        alpha, depth = copies[3:4], copies[4:5]
        shares = torch.softmax(self.net(torch.cat([alpha, depth / (alpha + 1e-4)], 1)), 1)
        return (shares * copies[:4]).sum(1)[None]


class LensNet(nn.Module):
    def __init__(self):
        super().__init__()
        self.copies, self.mix = Copies(), Mix()

    def forward(self, x):
        return self.mix(self.copies(x))


def encoded(v):
    v = v.clamp(min=0)
    return torch.where(v <= 0.0031308, 12.92 * v, 1.055 * (v + 1e-8) ** (1 / 2.4) - 0.055)


def over(layer, background):
    return encoded(layer[:, :3] + (1 - layer[:, 3:]) * background)


def train(path, minutes):
    data = torch.from_numpy(np.fromfile(path, "<f4").reshape(-1, 9, SIDE, SIDE))
    sharp, captured = data[:, :5].clone(), data[:, 5:]
    sharp[:, 4] *= sharp[:, 3]
    torch.manual_seed(0)
    net = LensNet()
    copies, truth = [], []  # of the pixels that the layer or its blur reaches: [5, K, P] and [4, P]
    with torch.no_grad():
        for s, t in zip(sharp, captured):
            c = net.copies(s[None])
            near = (c[3, -5] > 1e-3) | (t[3] > 1e-3)
            copies.append(c[:, :, near])
            truth.append(t[:, near])
    held = len(copies) // 6  # the last captures are not learnt from
    x, y, x_held, y_held = (torch.cat(v, -1) for v in (copies[:-held], truth[:-held], copies[-held:], truth[-held:]))

    def error(x, y, background):
        return ((over(net.mix(x[..., None]), background) - over(y[None, :, :, None], background)) ** 2).mean()

    optimiser = torch.optim.Adam(net.mix.parameters(), 3e-3)
    start, steps, share = time.time(), 0, 0.0
    while share < 1:
        share = (time.time() - start) / (60 * minutes)
        for group in optimiser.param_groups:
            group["lr"] = 3e-3 * 0.5 * (1 + np.cos(np.pi * min(share, 1)))
        pick = torch.randint(x.shape[-1], (16384,))
        loss = error(x[..., pick], y[:, pick], torch.rand(1, 3, 1, 1))
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        steps += 1
    with torch.no_grad():
        sharp = ((over(x_held[None, :4, 0, :, None], 0.3) - over(y_held[None, :, :, None], 0.3)) ** 2).mean()
        decibels = [-10 * np.log10(float(e)) for e in (sharp, error(x_held, y_held, 0.3))]
        print(f"{path.stem}: {steps} steps, held-out captures {decibels[0]:.1f} dB sharp, {decibels[1]:.1f} dB blurred", flush=True)
    return net.eval()


def export(net, out):
    torch.onnx.export(
        net, torch.rand(1, 5, 64, 64), out, dynamo=False, opset_version=13, input_names=["layer"], output_names=["blurred"],
        dynamic_axes={"layer": {2: "h", 3: "w"}, "blurred": {2: "h", 3: "w"}},
    )
    onnx.checker.check_model(onnx.load(out))
    run = onnxruntime.InferenceSession(out, providers=["CPUExecutionProvider"])
    x = torch.rand(1, 5, 72, 136)
    with torch.no_grad():
        worst = np.abs(run.run(None, {"layer": x.numpy()})[0] - net(x).numpy()).max()
    assert worst < 1e-4, worst


if __name__ == "__main__":
    p = argparse.ArgumentParser(description=__doc__)
    p.add_argument("captures", type=pathlib.Path, help="folder with a file NAME.f32 for each camera")
    p.add_argument("out", type=pathlib.Path, help="folder for lensnet-NAME.onnx")
    p.add_argument("--minutes", type=float, default=2, help="for each camera")
    a = p.parse_args()
    for path in sorted(a.captures.glob("*.f32")):
        export(train(path, a.minutes), str(a.out / f"lensnet-{path.stem}.onnx"))
