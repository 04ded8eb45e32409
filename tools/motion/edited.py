"""The exposure that `blindaug estimate` tells of footage that was edited or stabilised.

    edited.py make OUT PHOTOGRAPH..        clips of each photograph, as filmed and edited in each way, and their true exposures
    edited.py measure BLINDAUG OUT         a table: how many exposures are known, how many intervals hold the truth, and the mean error

A camera moves sideways by 5 to 8 whole px a frame, with the shutter open for a quarter of the interval up to all of it; noise has a std of 2 of 255.
`bars`: black bars above and below. `titles`: a line of text, a logo and a time burnt in. `fade`: from black over 9 frames. `twice`: enlarged to twice the size.
`vignette`: darker by half at the corners. `graded`: an S-shaped curve of contrast. `weak` and `strong`: the camera also shook by up to 2 and by up to 6 px a frame,
which was taken away in the edit by shifting each frame. Needs numpy, scipy, pillow and ffmpeg.
"""
import os, sys, zlib
import numpy as np
from PIL import Image, ImageDraw, ImageFont
from scipy.ndimage import shift
from clips import measure, read_truth, write, write_truth

WIDTH, HEIGHT, FRAMES, MARGIN, VIEWS = 480, 320, 12, 24, 32
# Amplitude, px, and the periods along both axes, frames.
SHAKES = {"filmed": (0, (9.0, 7.0)), "weak": (3, (9.0, 7.0)), "strong": (5, (5.3, 4.1))}
LOSSLESS = ["-c:v", "ffv1", "-pix_fmt", "bgr0"]


def light(path):
    """A photograph, in light, large enough for the way and the shake."""
    image = Image.open(path).convert("RGB")
    scale = max((WIDTH + 8 * FRAMES + 120) / image.width, (HEIGHT + 120) / image.height, 1)
    if scale > 1.7:
        return None
    image = image.resize((int(image.width * scale) + 1, int(image.height * scale) + 1), Image.LANCZOS)
    values = np.asarray(image) / 255
    return np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)


def encoded(light):
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * np.maximum(light, 1e-9) ** (1 / 2.4) - 0.055)


def rounded(values):
    return (np.clip(values, 0, 1) * 255 + 0.5).astype(np.uint8)


def film(scene, speed, exposure, shake, rng):
    """The frames, encoded values, from which the shake was taken away."""
    amplitude, periods = shake
    phases = rng.random(2) * 2 * np.pi
    swing = lambda t: [amplitude * size * np.sin(2 * np.pi * t / period + phase) for size, period, phase in zip((1, 0.6), periods, phases)]
    left, top = (scene.shape[1] - WIDTH - speed * FRAMES) // 2 - MARGIN, (scene.shape[0] - HEIGHT) // 2 - MARGIN
    views = round(exposure * VIEWS)
    frames = []
    for frame in range(FRAMES):
        mean = 0
        for view in range(views):
            t = frame + (view - (views - 1) / 2) / VIEWS
            x, y = round(left + speed * t + swing(t)[0]), round(top + swing(t)[1])
            mean = mean + scene[y:y + HEIGHT + 2 * MARGIN, x:x + WIDTH + 2 * MARGIN] / views
        values = encoded(mean) + rng.normal(size=mean.shape) * 2 / 255
        if amplitude:
            across, down = swing(frame)
            values = shift(values, (down, across, 0), order=3, mode="nearest")
        frames.append(values[MARGIN:-MARGIN, MARGIN:-MARGIN])
    return frames


def with_bars(frame, _):
    return np.pad(frame[40:-40], ((40, 40), (0, 0), (0, 0)))


def with_titles(frame, n):
    image = Image.fromarray(rounded(frame))
    draw = ImageDraw.Draw(image, "RGBA")
    draw.rectangle((150, 280, 330, 305), fill="black")
    draw.text((165, 285), f"01:00:00:{n:02}", fill="white", font=ImageFont.load_default(18))
    draw.text((380, 15), "NEWS 24", fill=(255, 255, 255, 150), font=ImageFont.load_default(20))
    draw.text((90, 240), "and then she said to him", fill="white", font=ImageFont.load_default(26))
    return np.asarray(image) / 255


def twice(frame, _):
    return np.asarray(Image.fromarray(rounded(frame)).resize((2 * WIDTH, 2 * HEIGHT), Image.BICUBIC)) / 255


def with_vignette(frame, _):
    y, x = np.mgrid[-1:1:HEIGHT * 1j, -1:1:WIDTH * 1j]
    return frame * (1 - 0.25 * (x**2 + y**2))[..., None]


def graded(frame, _):
    values = np.clip(frame, 0, 1)
    return values * values * (3 - 2 * values)


EDITS = {"filmed": lambda frame, _: frame, "bars": with_bars, "titles": with_titles, "fade": lambda frame, n: frame * min(1, (n + 1) / 9), "twice": twice,
         "vignette": with_vignette, "graded": graded}


def make(out, photographs):
    truth = {}
    for path in photographs:
        name = os.path.splitext(os.path.basename(path))[0]
        scene = light(path)
        if scene is None:
            print(f"{path}: too small, left out")
            continue
        rng = np.random.default_rng(zlib.crc32(name.encode()))
        speed, truth[name] = int(rng.integers(5, 9)), int(rng.integers(8, VIEWS + 1)) / VIEWS
        for kind, shake in SHAKES.items():
            frames = film(scene, speed, truth[name], shake, rng)
            for edit, of in EDITS.items() if kind == "filmed" else [(kind, EDITS["filmed"])]:
                write(os.path.join(out, name, edit + ".mkv"), [rounded(of(frame, n)) for n, frame in enumerate(frames)], "rgb24", 24, LOSSLESS)
    write_truth(out, truth)


def measure_all(blindaug, out):
    truth = read_truth(out)
    for kind in [*EDITS, *list(SHAKES)[1:]]:
        measure(blindaug, kind, [(name, os.path.join(out, name, kind + ".mkv"), exposure) for name, exposure in truth.items()])


if __name__ == "__main__":
    if len(sys.argv) < 4 or sys.argv[1] not in ("make", "measure"):
        sys.exit(__doc__)
    make(sys.argv[2], sys.argv[3:]) if sys.argv[1] == "make" else measure_all(sys.argv[2], sys.argv[3])
