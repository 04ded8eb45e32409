"""How far the noise that blindaug finds in single images lies from the truth, and how often its intervals hold the truth.

    single.py BLINDAUG PHOTOGRAPH..

Each photograph is taken by six cameras as those of cameras.py (which see), but with properties by chance: strong and weak noise, with and without a
filter array, removal of noise, sharpening and JPEG. The std of the noise in G over greys near the luminances of `inspect`, all levels of a Laplacian pyramid
together, is known from twelve shots; the first one alone is given to blindaug. A table tells, by luminance and by how the image was made, the
number of cases, how many of the 95 % intervals hold the truth, the median size of the std's error, the mean and the rms of its logarithm, and the
median width of the intervals, as the logarithm of the ratio of their ends. Needs numpy, scipy and pillow.
"""
import os, sys, tempfile
from concurrent.futures import ProcessPoolExecutor
import numpy as np
from PIL import Image
from cameras import CAMERAS, light_of, shot
from compare import LUMA, doubled, inspected, levels

SHOTS, KINDS = 12, 6
NEAR, FEWEST = 0.1, 1500
QUALITIES = (98, 95, 92, 90, 85, 80, 75)


def by_chance(rng, kind):
    """A camera with a filter array and JPEG, or, if it is the first kind, without."""
    strength = rng.uniform()
    matrix = (1 - strength) * np.eye(3) + strength * np.array(CAMERAS["C"]["matrix"])
    return dict(electrons=np.exp(rng.uniform(np.log(300), np.log(12000))), readout=rng.uniform(2, 8), matrix=matrix,
                white=[1 + rng.uniform(0, 1.2), 1, 1 + rng.uniform()], denoise=max(0, rng.uniform(-0.5, 1.1)),
                colour=max(0, rng.uniform(-1, 3)), tone=rng.uniform(1, 1.6), sharpen=max(0, rng.uniform(-0.5, 0.8)),
                quality=rng.choice(QUALITIES).item() if kind else 0, subsampling=2 * rng.integers(2).item())


def without_lowpass(noise):
    """The part of a noise that lies in the levels."""
    *finer, whole = levels(noise)
    for level in reversed(finer):
        whole = level + doubled(whole, *level.shape[:2])
    return whole


def estimated(blindaug, image):
    """The noise of an image as `inspect --json` has it."""
    with tempfile.TemporaryDirectory() as work:
        Image.fromarray(image).save(f"{work}/image.png")
        return inspected(blindaug, f"{work}/image.png", "-o", f"{work}/camera.json")["noise"]


def cases(blindaug, path, seed):
    """The cases of a photograph: (groups, the log of the told std over the true one, those of the ends of its interval)."""
    rng = np.random.default_rng(seed)
    light, found = light_of(path), []
    for kind in range(KINDS):
        camera = by_chance(rng, kind)
        shots = [shot(light, camera, rng) for _ in range(SHOTS)]
        mean = np.mean(shots, axis=0) / 255
        variance = np.mean([without_lowpass(s / 255 - mean)[..., 1] ** 2 for s in shots], axis=0) * SHOTS / (SHOTS - 1)
        noise = estimated(blindaug, shots[0])
        for told in noise.get("std_of_encoded_rgb", []):
            near = abs(mean @ LUMA - told["luminance"]) < NEAR
            if near.sum() < FEWEST:
                continue
            truth = np.sqrt(variance[near].mean())
            made = "no JPEG" if not kind else "JPEG from 90" if camera["quality"] >= 90 else "JPEG to 85"
            groups = ["all", f"luminance {told['luminance']}", made, "noise removed" if camera["denoise"] else "no noise removed"]
            std, (low, high) = told["std"][1], told["interval"][1]
            found.append((groups, *np.log(np.maximum([std, low, high], 1e-4) / truth)))
    return found


def main(blindaug, photographs):
    groups = {}
    with ProcessPoolExecutor() as pool:
        for found in pool.map(cases, [blindaug] * len(photographs), photographs, range(len(photographs))):
            for names, *case in found:
                for name in names:
                    groups.setdefault(name, []).append(case)
    print("| | cases | covered | median size of the error | mean, rms of its log | width |\n|---|---|---|---|---|---|")
    for name in sorted(groups):
        error, low, high = np.array(groups[name]).T
        covered, size = ((low <= 0) & (high >= 0)).sum(), np.median(abs(np.expm1(error)))
        print(f"| {name} | {len(error)} | {covered} | {100 * size:.0f} % | {error.mean():+.2f}, {np.sqrt((error**2).mean()):.2f} | {np.median(high - low):.2f} |")


if __name__ == "__main__":
    if len(sys.argv) < 3:
        sys.exit(__doc__)
    main(os.path.abspath(sys.argv[1]), sys.argv[2:])
