"""The exposure that `blindaug estimate` tells where streaks are short.

    short_streaks.py make OUT PHOTOGRAPH..        images of each photograph, moved, and their true exposures
    short_streaks.py measure BLINDAUG OUT         for each length of streak: how many exposures are known, how many intervals hold the truth, the mean error

A photograph moves sideways or upwards by 6 whole px a frame; a frame is the mean, in light, over the first 1 to 5 of these places, with noise of a std of 2 of 255.
`native` are the photographs' own pixels, halved down to at most 1600 of them in a row; `enlarged` are 1.4 times as large. Needs numpy, pillow and ffmpeg.
"""
import os, sys
import numpy as np
from PIL import Image
from clips import measure, read_truth, write, write_truth

WIDTH, HEIGHT, FRAMES, SPEED, STREAKS = 360, 260, 6, 6, range(1, 6)
DIRECTIONS = {"sideways": (1, 0), "upwards": (0, 1)}
SCALES = {"native": 1, "enlarged": 1.4}


def light(path, scale):
    image = Image.open(path).convert("RGB")
    while image.width > 1600:
        image = image.resize((image.width // 2, image.height // 2), Image.BOX)
    if scale != 1:
        image = image.resize((int(scale * image.width), int(scale * image.height)), Image.BICUBIC)
    values = np.asarray(image) / 255
    return np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)


def encoded(light):
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * np.maximum(light, 1e-9) ** (1 / 2.4) - 0.055)


def film(scene, streak, direction, noise):
    """The frames; `None` if the photograph is too small."""
    right, down = direction
    way = SPEED * FRAMES
    left, top = (scene.shape[1] - WIDTH - right * way) // 2, (scene.shape[0] - HEIGHT - down * way) // 2
    if left < 0 or top < 0:
        return None
    view = lambda at: scene[top + down * at:, left + right * at:][:HEIGHT, :WIDTH]
    means = [sum(view(SPEED * frame + place) for place in range(streak)) / streak for frame in range(FRAMES)]
    noisy = [encoded(mean) + noise.normal(size=mean.shape) * 2 / 255 for mean in means]
    return [(np.clip(values, 0, 1) * 255 + 0.5).astype(np.uint8) for values in noisy]


def make(out, photographs):
    truth = {}
    for path in photographs:
        for kind, scale in SCALES.items():
            scene = light(path, scale)
            for towards, direction in DIRECTIONS.items():
                for streak in STREAKS:
                    name = f"{os.path.splitext(os.path.basename(path))[0]}-{towards}-{kind}-{streak}"
                    if frames := film(scene, streak, direction, np.random.default_rng(5)):
                        write(os.path.join(out, name, "%04d.png"), frames, "rgb24", 24, [])
                        truth[name] = streak / SPEED
    write_truth(out, truth)


def measure_all(blindaug, out):
    truth = read_truth(out)
    for kind in SCALES:
        for streak in STREAKS:
            of = f"-{kind}-{streak}"
            measure(blindaug, f"{kind}, {streak} px", [(name, os.path.join(out, name), truth[name]) for name in truth if name.endswith(of)])


if __name__ == "__main__":
    if len(sys.argv) < 4 or sys.argv[1] not in ("make", "measure"):
        sys.exit(__doc__)
    make(sys.argv[2], sys.argv[3:]) if sys.argv[1] == "make" else measure_all(sys.argv[2], sys.argv[3])
