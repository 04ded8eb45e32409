"""Measures the networks on what they were not trained on: held-out pictures and rendered clips with known truth.

PSNR in dB against the clean frame, of the input, of the network's output and of a classical removal that is told the truth; and
re-synthesis: which exposure or which defocus makes the sharp frame blurred again like the input, with the network's output as the
sharp frame and, as a control, with the clean one."""
import argparse
import os
import pathlib
import time

os.environ.setdefault("OPENCV_IO_ENABLE_OPENEXR", "1")
import cv2
import numpy as np
import onnxruntime
from numba import njit
from skimage.restoration import denoise_nl_means

import degrade
import sharp

p = argparse.ArgumentParser(description=__doc__)
p.add_argument("--models", default=pathlib.Path(__file__).parent.parent / "crates/blindaug-nets/models", type=pathlib.Path)
p.add_argument("--shared", default=os.environ.get("BLINDAUG_SHARED"), help="folder that holds data/clips")
p.add_argument("--photos", nargs="*", default=[], help="the folders of the training, of which the held-out pictures are used")
p.add_argument("--cache", help="file that keeps the held-out pictures between runs")
p.add_argument("--count", type=int, default=40, help="held-out pictures per task")
p.add_argument("--only", nargs="*", default=["defocus", "motion", "noise"])
p.add_argument("--threads", type=int, default=2)
a = p.parse_args()


class Network:
    def __init__(self, task):
        o = onnxruntime.SessionOptions()
        o.intra_op_num_threads = a.threads
        self.run = onnxruntime.InferenceSession(a.models / f"blindaug-{task}.onnx", o, providers=["CPUExecutionProvider"])
        self.name = self.run.get_inputs()[0].name

    def __call__(self, *frames):
        x = np.concatenate(frames, 2)
        h, w, _ = x.shape
        x = np.pad(x, ((0, -h % 8), (0, -w % 8), (0, 0)), "reflect").transpose(2, 0, 1)[None]
        y = self.run.run(None, {self.name: np.ascontiguousarray(x, np.float32)})[0][0]
        return np.clip(y.transpose(1, 2, 0)[:h, :w], 0, 1)


def psnr(x, y):
    return -10 * np.log10(max(np.mean((x - y) ** 2), 1e-10))


def linear(x):
    return np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4).astype(np.float32)


# -- classical removal


def wiener(x, psf, noise):
    """Wiener filter of an encoded image, in linear light, with mirrored borders."""
    m = 32
    y = np.pad(linear(x), ((m, m), (m, m), (0, 0)), "reflect")
    k = np.zeros(y.shape[:2], np.float32)
    k[: psf.shape[0], : psf.shape[1]] = psf / psf.sum()
    k = np.fft.rfft2(np.roll(k, (-(psf.shape[0] // 2), -(psf.shape[1] // 2)), (0, 1)))[..., None]
    z = np.fft.irfft2(np.fft.rfft2(y, axes=(0, 1)) * k.conj() / (abs(k) ** 2 + noise), y.shape[:2], axes=(0, 1))
    return degrade.encode(np.ascontiguousarray(z[m:-m, m:-m], np.float32))


def disk(std):
    n = int(2 * std + 1)
    y, x = np.mgrid[-n : n + 1, -n : n + 1]
    return np.clip(2 * std + 0.5 - np.hypot(x, y), 0, 1)


def streak(u, v):
    n = int(max(abs(u), abs(v)) / 2 + 2)
    k = np.zeros((2 * n + 1, 2 * n + 1))
    for t in np.linspace(-0.5, 0.5, 101):
        x, y = n + t * u, n + t * v
        i, j = int(y), int(x)
        for di in (0, 1):
            for dj in (0, 1):
                k[i + di, j + dj] += abs(1 - di - (y - i)) * abs(1 - dj - (x - j))
    return k


def best_wiener(x, clean, kernels, noises=(0.01, 0.03, 0.1)):
    return max(psnr(wiener(x, k, n), clean) for k in kernels for n in noises)


def best_nlm(x, clean, std):
    return max(psnr(denoise_nl_means(x, 5, 6, h * std, sigma=std, fast_mode=True, channel_axis=2), clean) for h in (0.6, 1.0))


# -- synthesis


@njit(cache=True, nogil=True, fastmath=True)
def shutter(x, u, v, exposure):
    """Mean over the path x + exposure t (u, v), t in -1/2..1/2; second result: 1 where the path stays inside."""
    h, w, _ = x.shape
    out = np.zeros_like(x)
    inside = np.ones((h, w), np.uint8)
    for i in range(h):
        for j in range(w):
            du, dv = exposure * u[i, j], exposure * v[i, j]
            taps = int(max(abs(du), abs(dv))) + 2
            for k in range(taps):
                t = (k + 0.5) / taps - 0.5
                sx, sy = j + t * du, i + t * dv
                if sx < 0 or sy < 0 or sx > w - 1.001 or sy > h - 1.001:
                    inside[i, j] = 0
                    sx = min(max(sx, 0.0), w - 1.001)
                    sy = min(max(sy, 0.0), h - 1.001)
                jj, ii = int(sx), int(sy)
                fx, fy = np.float32(sx - jj), np.float32(sy - ii)
                for c in range(3):
                    out[i, j, c] += (1 - fy) * ((1 - fx) * x[ii, jj, c] + fx * x[ii, jj + 1, c]) + fy * ((1 - fx) * x[ii + 1, jj, c] + fx * x[ii + 1, jj + 1, c])
            for c in range(3):
                out[i, j, c] /= taps
    return out, inside


@njit(cache=True, nogil=True, fastmath=True)
def lens(x, std):
    """Blurs by a disk of diameter 4 std, which differs between pixels."""
    h, w, _ = x.shape
    out = np.empty_like(x)
    for i in range(h):
        for j in range(w):
            r = np.float32(2 * std[i, j] + 0.5)
            n = int(r)
            s0 = s1 = s2 = total = np.float32(0)
            for ii in range(max(0, i - n), min(h, i + n + 1)):
                for jj in range(max(0, j - n), min(w, j + n + 1)):
                    d = np.sqrt(np.float32((ii - i) ** 2 + (jj - j) ** 2))
                    e = min(max(r - d, np.float32(0)), np.float32(1))
                    s0 += e * x[ii, jj, 0]
                    s1 += e * x[ii, jj, 1]
                    s2 += e * x[ii, jj, 2]
                    total += e
            out[i, j, 0] = s0 / total
            out[i, j, 1] = s1 / total
            out[i, j, 2] = s2 / total
    return out


def minimum(values, cost):
    """The value of least cost, interpolated between the grid's points by a parabola."""
    c = np.array([cost(v) for v in values])
    i = int(c.argmin())
    if 0 < i < len(c) - 1:
        l, m, r = c[i - 1 : i + 2]
        return values[i] + (values[1] - values[0]) * 0.5 * (l - r) / (l - 2 * m + r)
    return values[i]


def find_exposure(seen, clear, u, v):
    inside = shutter(seen, u, v, 1.0)[1] > 0
    clear = linear(clear)
    return minimum(np.linspace(0, 1, 21), lambda e: np.mean((degrade.encode(shutter(clear, u, v, e)[0]) - seen)[inside] ** 2))


def find_defocus(seen, clear, scale):
    clear = linear(clear)
    return minimum(np.linspace(0, 6, 25), lambda s: np.mean((degrade.encode(lens(clear, s * scale)) - seen) ** 2))


# -- data


def read(path):
    return np.ascontiguousarray(cv2.imread(str(path))[..., ::-1]).astype(np.float32) / 255


def geometry(path, names):
    import OpenEXR

    c = OpenEXR.File(str(path)).channels()
    return [c[n].pixels.astype(np.float32) for n in names]


def row(name, *values):
    print(f"{name:34s}" + "".join(f"{v:>12}" if isinstance(v, str) else f"{v:12.2f}" for v in values), flush=True)


def held_out(task, net):
    camera = degrade.Camera(*sharp.pool(a.photos, 12, held=True, cache=a.cache), 12345)
    camera.pools = [camera.pools[0], camera.pools[-1]]
    table = []
    for _ in range(a.count):
        given, clean = camera.pair(task, 144)
        given = [np.ascontiguousarray(g.transpose(1, 2, 0)) for g in np.split(given, len(given) // 3)]
        clean = np.ascontiguousarray(clean.transpose(1, 2, 0))
        x = given[len(given) // 2]
        if task == "noise":
            classic = best_nlm(x, clean, (x - clean).std())
        elif task == "defocus":
            classic = best_wiener(x, clean, [disk(s) for s in (0.5, 1, 1.5, 2, 3, 4, 5, 6)])
        else:
            classic = best_wiener(x, clean, [streak(l * np.cos(t), l * np.sin(t)) for l in (2, 4, 8, 14, 20) for t in np.arange(6) * np.pi / 6])
        table.append((psnr(x, clean), psnr(net(*given), clean), classic))
    t = np.array(table)
    row("held-out pictures", *t.mean(0))
    for lo, hi in ((0, 20), (20, 25), (25, 30), (30, 40), (40, 99)):
        part = t[(t[:, 0] >= lo) & (t[:, 0] < hi)]
        if len(part):
            row(f"  of them, input {lo} to {hi} dB: {len(part)}", *part.mean(0))


def scenes():
    return sorted(d for d in (pathlib.Path(a.shared) / "data/clips").iterdir() if (d / "truth.json").exists()) if a.shared else []


def truth(scene):
    import json

    return json.loads((scene / "truth.json").read_text())


for task in a.only:
    file = a.models / f"blindaug-{task}.onnx"
    if not file.exists():
        continue
    net = Network(task)
    print(f"\n{task}, PSNR in dB")
    extra = {"motion": ("exposure", "by network", "by clean"), "defocus": ("std at inf.", "by network", "by clean"), "noise": ()}[task]
    row("", "input", "network", {"noise": "NLM"}.get(task, "Wiener"), *extra)
    held_out(task, net)
    for scene in scenes():
        t = truth(scene)
        clean = read(scene / "clean/0003.png")
        if task == "defocus":
            (z,) = geometry(scene / "clean/0003.exr", ["Z"])
            for name in ("dof_a", "dof_b", "dof_c"):
                l = t[name]["lens"]
                scale = np.abs(1 - l["focus_distance_m"] / z)
                x = read(scene / name / "0003.png")
                y = net(x)
                std = l["sigma_px_at_infinity"]
                classic = best_wiener(x, clean, [disk(max(0.3, np.median(std * scale)))])
                row(f"{scene.name} {name}", psnr(x, clean), psnr(y, clean), classic, std, find_defocus(x, y, scale), find_defocus(x, clean, scale))
        if task == "motion":
            u, v = geometry(scene / "clean/0003.exr", ["forward.u", "forward.v"])
            for name in ("mb_0.25", "mb_0.50", "mb_0.90"):
                frames = [read(scene / name / f"000{k}.png") for k in (2, 3, 4)]
                y, x, e = net(*frames), frames[1], t[name]["exposure"]
                classic = best_wiener(x, clean, [streak(e * u.mean(), e * v.mean())])
                row(f"{scene.name} {name}", psnr(x, clean), psnr(y, clean), classic, e, find_exposure(x, y, u, v), find_exposure(x, clean, u, v))
        if task == "noise":
            for name in ("full", "full2"):
                x, clean = read(scene / f"{name}_without/0003.png"), read(scene / f"{name}_plain/0003.png")
                row(f"{scene.name} {name}", psnr(x, clean), psnr(net(x), clean), best_nlm(x, clean, (x - clean).std()))
    frames = 3 if task == "motion" else 1
    x = [np.random.default_rng(0).random((512, 512, 3), np.float32)] * frames
    took = []
    for _ in range(5):
        begin = time.time()
        net(*x)
        took.append(time.time() - begin)
    print(f"{1e3 * min(took):.0f} ms for 512x512 in onnxruntime, {a.threads} threads")
