"""The exposure that `blindaug estimate` tells of a thing with two legs that passes before a still picture.

    passing.py make OUT PHOTOGRAPH..        clips of each photograph, lossless and as H.264 at crf 20, and their true exposures
    passing.py measure BLINDAUG OUT         a table: how many exposures are known, how many intervals hold the truth, and the mean error

The thing is cut out of the next photograph, and passes by 6, 14 and 26 px a frame. What stands still behind it comes into view between its
legs. A frame is the mean, in light, of up to 32 places per frame interval; noise has a std of 1.5 of 255. Needs numpy, pillow and ffmpeg.
"""
import os, sys
import numpy as np
from PIL import Image
from clips import measure, read_truth, write, write_truth

WIDTH, HEIGHT, SIDE, FRAMES, PLACES = 480, 320, 200, 16, 32
SPEEDS, EXPOSURES = (6, 14, 26), (0.25, 0.5, 0.75, 0.9)
CODERS = {"mkv": ["-c:v", "ffv1", "-pix_fmt", "bgr0"], "mp4": ["-c:v", "libx264", "-crf", "20", "-pix_fmt", "yuv420p"]}
GAMMA = 2.2


def light(path, width, height):
    """A photograph of this size, in light."""
    image = Image.open(path).convert("RGB")
    scale = max(width / image.width, height / image.height)
    image = image.resize((int(image.width * scale) + 1, int(image.height * scale) + 1), Image.LANCZOS).crop((0, 0, width, height))
    return (np.asarray(image) / 255) ** GAMMA


def shape():
    """The alpha of a thing with two legs."""
    y, x = np.mgrid[:SIDE, :SIDE]
    body = ((x - 100) / 70) ** 2 + ((y - 70) / 60) ** 2 < 1
    legs = (np.minimum(abs(x - 65), abs(x - 135)) < 18) & (y > 70)
    return (body | legs).astype(float)[..., None]


def with_thing(still, thing, alpha, left):
    """The still picture with the thing before it, whose left edge is at a fraction of a px."""
    wide = np.pad(still, ((0, 0), (SIDE + 1, SIDE + 1), (0, 0)))
    first = int(np.floor(left))
    share = left - first
    rows, columns = slice(60, 60 + SIDE), slice(first + SIDE + 1, first + 2 * SIDE + 2)
    between = lambda a: (1 - share) * np.pad(a, ((0, 0), (0, 1), (0, 0))) + share * np.pad(a, ((0, 0), (1, 0), (0, 0)))
    if 0 <= columns.start and columns.stop <= wide.shape[1]:
        wide[rows, columns] = wide[rows, columns] * (1 - between(alpha)) + between(thing * alpha)
    return wide[:, SIDE + 1:SIDE + 1 + WIDTH]


def film(still, thing, speed, places, noise):
    start = (WIDTH - SIDE - speed * FRAMES) / 2
    for t in range(FRAMES):
        times = t + (np.arange(places) - (places - 1) / 2) / PLACES
        mean = sum(with_thing(still, thing, shape(), start + speed * time) for time in times) / places
        values = 255 * mean ** (1 / GAMMA) + noise.normal(size=mean.shape) * 1.5
        yield np.clip(values + 0.5, 0, 255).astype(np.uint8)


def make(out, photographs):
    truth, noise = {}, np.random.default_rng(1)
    for n, path in enumerate(photographs):
        still, thing = light(path, WIDTH, HEIGHT), light(photographs[(n + 1) % len(photographs)], SIDE, SIDE)
        for s, speed in enumerate(SPEEDS):
            places = round(EXPOSURES[(n + s) % len(EXPOSURES)] * PLACES)
            name = f"{os.path.splitext(os.path.basename(path))[0]}-{speed}"
            frames = list(film(still, thing, speed, places, noise))
            for kind, coder in CODERS.items():
                write(os.path.join(out, f"{name}.{kind}"), frames, "rgb24", 30, coder)
            truth[name] = places / PLACES
    write_truth(out, truth)


def measure_all(blindaug, out):
    truth = read_truth(out)
    for kind in CODERS:
        clips = [(name, os.path.join(out, f"{name}.{kind}"), exposure) for name, exposure in truth.items()]
        # The places stand for as many steps of the exposure.
        measure(blindaug, kind, clips, "--network", "none", step=1 / PLACES)


if __name__ == "__main__":
    if len(sys.argv) < 4 or sys.argv[1] not in ("make", "measure"):
        sys.exit(__doc__)
    make(sys.argv[2], sys.argv[3:]) if sys.argv[1] == "make" else measure_all(sys.argv[2], sys.argv[3])
