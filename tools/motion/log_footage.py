"""The exposure that `blindaug estimate` tells of log footage.

    log_footage.py make OUT PHOTOGRAPH..    clips of each photograph in LogC3, as images and as ProRes 422 HQ, and their true exposures
    log_footage.py measure BLINDAUG OUT     a table: how many exposures are known, how many intervals hold the truth, the mean error, and of how many
                                            it is said that they were, or may have been, compressed

A camera moves sideways by 6 to 15 whole px a frame, with the shutter open for a quarter of the interval up to all of it. The noise is that of a sensor
at a low gain: a std of 0.0034 at middle grey, in light, mostly of photons. Values have 10 bits. Needs numpy, pillow and ffmpeg.
"""
import os, sys, zlib
import numpy as np
from PIL import Image
from clips import light_of_srgb, measure, read_truth, write, write_truth

WIDTH, HEIGHT, FRAMES = 384, 288, 6
READOUT, PHOTONS, WHITE = 0.0008, 6e-5, 1.2
KINDS = {"images": ("%04d.png", ["-pix_fmt", "rgb48be"]), "prores": ("clip.mov", ["-c:v", "prores_ks", "-profile:v", "3", "-pix_fmt", "yuv422p10le"])}


def light(path):
    return WHITE * light_of_srgb(np.asarray(Image.open(path).convert("RGB")) / 255)


def log_c3(light):
    return np.where(light > 0.010591, 0.24719 * np.log10(np.maximum(5.555556 * light + 0.052272, 1e-6)) + 0.385537, 5.367655 * light + 0.092809)


def film(scene, speed, steps, rng):
    left, top = (scene.shape[1] - WIDTH - speed * (FRAMES + 1)) // 2, (scene.shape[0] - HEIGHT) // 2
    for frame in range(FRAMES):
        seen = [scene[top:top + HEIGHT, left + speed * frame + step:][:, :WIDTH] for step in range(steps)]
        mean = np.mean(seen, axis=0)
        noisy = mean + np.sqrt(READOUT**2 + PHOTONS * mean) * rng.normal(size=mean.shape)
        yield (np.clip(log_c3(noisy), 0, 1) * 1023 + 0.5).astype(np.uint16) * np.uint16(64)


def make(out, photographs):
    truth = {}
    for path in photographs:
        name = os.path.splitext(os.path.basename(path))[0]
        rng, scene = np.random.default_rng(zlib.crc32(name.encode())), light(path)
        speed = int(rng.integers(6, 16))
        steps = int(rng.integers(-(-speed // 4), speed + 1))
        if scene.shape[0] < HEIGHT or scene.shape[1] < WIDTH + speed * (FRAMES + 1):
            print(f"{path}: too small, left out")
            continue
        frames = list(film(scene, speed, steps, rng))
        for kind, (file, coder) in KINDS.items():
            write(os.path.join(out, name, kind, file), frames, "rgb48le", 24, coder)
        truth[name] = steps / speed
    write_truth(out, truth)


def measure_all(blindaug, out):
    truth = read_truth(out)
    for kind, (file, _) in KINDS.items():
        path = lambda name: os.path.join(out, name, kind, *([] if "%" in file else [file]))
        measure(blindaug, kind, [(name, path(name), exposure) for name, exposure in truth.items()], "--colour-space", "logc3")


if __name__ == "__main__":
    if len(sys.argv) < 4 or sys.argv[1] not in ("make", "measure"):
        sys.exit(__doc__)
    make(sys.argv[2], sys.argv[3:]) if sys.argv[1] == "make" else measure_all(sys.argv[2], sys.argv[3])
