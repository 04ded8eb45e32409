"""The exposure that `blindaug estimate` tells where streaks are short.

    short_streaks.py make OUT PHOTOGRAPH..        images of each photograph, moved, and their true exposures
    short_streaks.py measure BLINDAUG OUT         for each length of streak: how many exposures are known, how many intervals hold the truth, the mean error

A photograph moves sideways or upwards by 6 whole px a frame; a frame is the mean, in light, over the first 1 to 5 of these places, with noise of a std of 2 of 255.
`native` are the photographs' own pixels, halved down to at most 1600 of them in a row; `enlarged` are 1.4 times as large. Needs numpy, pillow and ffmpeg.
"""
import os, sys
import numpy as np
from PIL import Image
from clips import light_of_srgb, measure, read_truth, srgb_of_light, write, write_truth

WIDTH, HEIGHT, FRAMES, SPEED, STREAKS = 360, 260, 6, 6, range(1, 6)
DIRECTIONS = {"sideways": (1, 0), "upwards": (0, 1)}
SCALES = {"native": 1, "enlarged": 1.4}


def light(path, scale):
    image = Image.open(path).convert("RGB")
    while image.width > 1600:
        image = image.resize((image.width // 2, image.height // 2), Image.BOX)
    if scale != 1:
        image = image.resize((int(scale * image.width), int(scale * image.height)), Image.BICUBIC)
    return light_of_srgb(np.asarray(image) / 255)


def margins(scene, direction):
    """What the photograph is larger than the frames and the way, px, to the right and down."""
    return [side - frame - towards * SPEED * FRAMES for side, frame, towards in zip(scene.shape[1::-1], (WIDTH, HEIGHT), direction)]


def film(scene, streak, direction):
    (left, top), (right, down), noise = [margin // 2 for margin in margins(scene, direction)], direction, np.random.default_rng(5)
    view = lambda at: scene[top + down * at:, left + right * at:][:HEIGHT, :WIDTH]
    for frame in range(FRAMES):
        mean = sum(view(SPEED * frame + place) for place in range(streak)) / streak
        noisy = srgb_of_light(mean) + noise.normal(size=mean.shape) * 2 / 255
        yield (np.clip(noisy, 0, 1) * 255 + 0.5).astype(np.uint8)


def make(out, photographs):
    truth = {}
    for path in photographs:
        for kind, scale in SCALES.items():
            scene = light(path, scale)
            for towards, direction in DIRECTIONS.items():
                if min(margins(scene, direction)) < 0:
                    print(f"{path}, {kind}, {towards}: too small, left out")
                    continue
                for streak in STREAKS:
                    name = f"{os.path.splitext(os.path.basename(path))[0]}-{towards}-{kind}-{streak}"
                    write(os.path.join(out, name, "%04d.png"), film(scene, streak, direction), "rgb24", 24, [])
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
