"""Compares the noise that blindaug finds and synthesises with that of photographs whose noise-free picture is known.

    compare.py BLINDAUG FOLDER..

A FOLDER holds photographs NAME_real.png with NAME_mean.png, the mean of many shots of the same; or, as cameras.py makes it, `shots/` with
shots of one view and `clean/` with their mean as often. For each way of estimating (one image, the shots, the clean picture given) the camera
that was found is applied to the mean picture, and the result less the mean is compared with the real noise: the std in each level of a Laplacian pyramid (finest
first), channel and tenth of luminance; the correlation of the channels in each level. Needs numpy, scipy and pillow.
"""
import glob, json, os, shutil, subprocess, sys, tempfile
import numpy as np
from PIL import Image
from scipy.ndimage import convolve1d

LEVELS = 4
LUMA = np.array([0.299, 0.587, 0.114])
KERNEL = np.array([1, 4, 6, 4, 1]) / 16


def blurred(image, mode):
    return convolve1d(convolve1d(image, KERNEL, axis=0, mode=mode), KERNEL, axis=1, mode=mode)


def halved(image):
    return blurred(image, "nearest")[::2, ::2]


def doubled(image, height, width):
    full = np.zeros((height, width) + image.shape[2:])
    full[::2, ::2] = image[: (height + 1) // 2, : (width + 1) // 2]
    weight = np.zeros((height, width) + (1,) * (image.ndim - 2))
    weight[::2, ::2] = 1
    return blurred(full, "constant") / blurred(weight, "constant")


def levels(image):
    """The levels of the Laplacian pyramid, finest first."""
    found = []
    for _ in range(LEVELS):
        small = halved(image)
        found.append(image - doubled(small, *image.shape[:2]))
        image = small
    return found


def load(path):
    return np.asarray(Image.open(path).convert("RGB")).astype(float) / 255


def statistics(noise, mean):
    """The stds by level, tenth of luminance and channel, and the correlations RG, RB and GB by level."""
    stds, correlations = [], []
    for band in levels(noise):
        luma = mean @ LUMA
        edges = np.quantile(luma, np.linspace(0, 1, 11))
        tenth = np.clip(np.searchsorted(edges, luma, side="right") - 1, 0, 9)
        stds.append([band[tenth == k].std(0) if (tenth == k).any() else [np.nan] * 3 for k in range(10)])
        c = np.corrcoef(band.reshape(-1, 3).T)
        correlations.append([c[0, 1], c[0, 2], c[1, 2]])
        mean = halved(mean)
    return np.array(stds), np.array(correlations)


def run(blindaug, *arguments):
    subprocess.run([blindaug, *arguments], check=True, capture_output=True)


def inspected(blindaug, *arguments):
    """What `inspect --json` tells of what `estimate` finds with these arguments, the last of which is the file that it writes."""
    run(blindaug, "estimate", *arguments)
    return json.loads(subprocess.run([blindaug, "inspect", "--json", arguments[-1]], check=True, capture_output=True, text=True).stdout)


def synthesised(blindaug, mean, arguments, folder):
    """The noise of the camera that is estimated with these arguments, applied to the mean picture."""
    camera, out = f"{folder}/camera.json", f"{folder}/out"
    run(blindaug, "estimate", *arguments, "-o", camera)
    model = json.load(open(camera))
    model.pop("sharpening", None)
    for blur in ("motion_blur", "defocus"):
        model[blur] = {"unknown": "left out: only noise is compared"}
    json.dump(model, open(camera, "w"))
    Image.fromarray((mean * 255 + 0.5).astype(np.uint8)).save(f"{folder}/mean.png")
    shutil.rmtree(out, ignore_errors=True)
    run(blindaug, "apply", f"{folder}/mean.png", "--camera", camera, "-o", out)
    return load(glob.glob(f"{out}/*")[0]) - np.round(mean * 255) / 255


def cases(folder):
    """(name, real shot, mean picture, {way: arguments}) of a folder; the arguments name files of a temporary folder."""
    if os.path.isdir(f"{folder}/shots"):
        shots = sorted(glob.glob(f"{folder}/shots/*.png"))
        ways = {"one image": [shots[0]], "all shots": [f"{folder}/shots"],
                "clean": [f"{folder}/shots", "--clean", f"{folder}/clean", "--frames", "1..1"]}
        yield os.path.basename(folder.rstrip("/")), load(shots[0]), np.load(f"{folder}/mean.npy"), ways
    for real in sorted(glob.glob(f"{folder}/*_real.png")):
        with tempfile.TemporaryDirectory() as both:
            for name, source in (("frames", real), ("clean", real.replace("_real", "_mean"))):
                os.makedirs(f"{both}/{name}")
                shutil.copy(source, f"{both}/{name}/0001.png")
            ways = {"one image": [real], "clean": [f"{both}/frames", "--clean", f"{both}/clean"]}
            yield os.path.basename(real)[:-9], load(real), load(real.replace("_real", "_mean")), ways


def main(blindaug, folders):
    for folder in folders:
        for name, real, mean, ways in cases(folder):
            want, shared = statistics(real - mean, mean)
            for way, arguments in ways.items():
                with tempfile.TemporaryDirectory() as work:
                    got, made = statistics(synthesised(blindaug, mean, arguments, work), mean)
                error = got / want - 1
                percent = ", ".join(f"{100 * v:+.0f}" for v in np.nanmedian(error, (1, 2)))
                colours = ", ".join(f"{a:.2f} for {b:.2f}" for a, b in zip(made.mean(1), shared.mean(1)))
                print(f"{name}, {way}: {percent} % by level, median size {100 * np.nanmedian(abs(error)):.0f} %; correlation {colours}", flush=True)


if __name__ == "__main__":
    if len(sys.argv) < 3:
        sys.exit(__doc__)
    main(sys.argv[1], sys.argv[2:])
