"""How far the noise that blindaug finds lies from the truth over colours that a picture has, and over greys, some of which it has not.

    over_colours.py BLINDAUG PHOTOGRAPH..

Each photograph is taken by three cameras by chance (those of single.py, which see): once, six times from one place, and six times by a camera
that pans by 6 px across and 2 px down from shot to shot. The std of R, G and B, all levels of a Laplacian pyramid together, is known from ten shots of the
photograph, near five luminances, and from eight shots of a grey ramp. A table tells, for the straight lines and for the curves of the model that
was found, the number of stds, the median size of their error, and the mean and the rms of its logarithm: over the picture's own colours,
over greys of a luminance that the picture has, and over others. Needs numpy, scipy and pillow.
"""
import json, os, sys, tempfile
from concurrent.futures import ProcessPoolExecutor
import numpy as np
from PIL import Image
from cameras import light_of, shot
from compare import LUMA, run
from single import FEWEST, NEAR, by_chance, without_lowpass

KINDS, SHOTS, RAMPS, GIVEN = 3, 10, 8, 6
LUMINANCES = (0.1, 0.3, 0.5, 0.7, 0.9)
# The std of each level of a pyramid and those of others have these products in an image of white noise (BAND_COVARIANCE of the core).
COVARIANCE = np.array([[0.99978894, 0.15481946, 0.02422532, 0.0031789874], [0.15481946, 0.3967273, 0.1953662, 0.042550743],
                       [0.02422532, 0.1953662, 0.36394912, 0.2017897], [0.0031789874, 0.042550743, 0.2017897, 0.3631104]])
KNOTS = np.array([0, 0.08, 0.18, 0.32, 0.5, 0.7, 0.88, 1])


def total(levels):
    """The std of R, G and B of all levels together."""
    levels = np.array(levels)
    return np.sqrt(np.maximum(0, np.einsum("ic,jc,ij->c", levels, levels, COVARIANCE)))


def by_lines(noise, luminance):
    return total([np.maximum(0, np.array(l["slope"]) * luminance + l["intercept"]) for l in noise["levels"]])


def by_curves(noise, colours):
    """The std over pixels of these colours."""
    def variance(level, c):
        return sum(np.interp(colours[:, k], KNOTS, level["variance"][c][k]) for k in range(3)).mean()
    return total([[np.sqrt(variance(level, c)) for c in range(3)] for level in noise["curves"]["levels"]])


def noise_of(shots):
    """The mean of shots, and the variance of R, G and B at each pixel."""
    mean = np.mean(shots, axis=0) / 255
    noises = [without_lowpass(one / 255 - mean) ** 2 for one in shots]
    return mean, np.mean(noises, axis=0) * len(shots) / (len(shots) - 1)


def estimated(blindaug, shots):
    with tempfile.TemporaryDirectory() as work:
        os.mkdir(f"{work}/shots")
        for i, image in enumerate(shots):
            Image.fromarray(image).save(f"{work}/shots/{i + 1:04}.png")
        run(blindaug, "estimate", f"{work}/shots", "-o", f"{work}/camera.json")
        with open(f"{work}/camera.json") as file:
            return json.load(file)["noise"]


def cases(blindaug, path, seed):
    """(what was given, over which colours, lines or curves, the logs of the found stds over the true ones)."""
    rng, light, found = np.random.default_rng(seed), light_of(path), []
    height, width = light.shape[:2]
    ramp = np.repeat(np.linspace(0, 1.1, 512)[None, :, None] ** 2.2, 256, 0).repeat(3, 2)
    for kind in range(KINDS):
        camera = by_chance(rng, kind)
        still = [shot(light, camera, rng) for _ in range(SHOTS)]
        (mean, variance), (grey, of_grey) = noise_of(still), noise_of([shot(ramp, camera, rng) for _ in range(RAMPS)])
        places = [(2 * i, 6 * i) for i in range(GIVEN)]
        pan = [shot(light[y : height - 12 + y, x : width - 32 + x], camera, rng) for y, x in places]
        for given, shots in (("one shot", still[:1]), ("still camera", still[:GIVEN]), ("camera that pans", pan)):
            noise = estimated(blindaug, shots)
            if "curves" not in noise:
                continue
            for y in LUMINANCES:
                near, near_grey = abs(mean @ LUMA - y) < NEAR, abs(grey @ LUMA - y) < 0.03
                seen = near.sum() >= FEWEST
                truth = np.sqrt(of_grey[near_grey].mean(0))
                sides = [("greys it has" if seen else "other greys", truth, np.full((1, 3), y))]
                if seen:
                    sides.append(("the picture's colours", np.sqrt(variance[near].mean(0)), mean[near]))
                for colours, truth, pixels in sides:
                    for model, std in (("lines", by_lines(noise, y)), ("curves", by_curves(noise, pixels))):
                        found.append((given, colours, model, np.log(np.maximum(std, 1e-4) / np.maximum(truth, 1e-4))))
    return found


def main(blindaug, photographs):
    groups = {}
    with ProcessPoolExecutor() as pool:
        for found in pool.map(cases, [blindaug] * len(photographs), photographs, range(len(photographs))):
            for *group, errors in found:
                groups.setdefault(tuple(group), []).extend(errors)
    print("| given | over | by | stds | median size of the error | mean, rms of its log |\n|---|---|---|---|---|---|")
    for group, errors in sorted(groups.items()):
        errors = np.array(errors)
        size, mean, rms = np.median(abs(np.expm1(errors))), errors.mean(), np.sqrt((errors**2).mean())
        print(f"| {' | '.join(group)} | {len(errors)} | {size:.0%} | {mean:+.2f}, {rms:.2f} |".replace("%", " %"))


if __name__ == "__main__":
    if len(sys.argv) < 3:
        sys.exit(__doc__)
    main(sys.argv[1], sys.argv[2:])
