"""Shots of photographs by simulated cameras, with the mean of many shots: for compare.py.

    cameras.py OUT PHOTOGRAPH..

Each camera counts photons (Poisson) and reads them out (Gaussian); A, B and C have a Bayer filter array, demosaicing by colour differences, a
colour matrix and JPEG; A and C also remove noise (brightness where it is flat, colour everywhere), have a tone curve and sharpen, C with chroma
at half the resolution; D has three sensors and nothing else, so that its noise is white. Needs numpy, scipy and pillow.
"""
import io, os, sys
import numpy as np
from PIL import Image
from scipy.ndimage import convolve, gaussian_filter

CAMERAS = {
    "A": dict(electrons=1500, readout=3, matrix=[[1.7, -0.6, -0.1], [-0.3, 1.6, -0.3], [0, -0.6, 1.6]], white=[2.0, 1, 1.6],
              denoise=0.6, colour=2.0, tone=1.6, sharpen=0.5, quality=92, subsampling=0),
    "B": dict(electrons=4000, readout=4, matrix=[[1.5, -0.4, -0.1], [-0.2, 1.4, -0.2], [0, -0.5, 1.5]], white=[1.8, 1, 1.5],
              denoise=0, colour=0, tone=1.3, sharpen=0, quality=95, subsampling=0),
    "C": dict(electrons=900, readout=2, matrix=[[1.8, -0.7, -0.1], [-0.3, 1.7, -0.4], [0, -0.7, 1.7]], white=[2.2, 1, 1.9],
              denoise=1.0, colour=3.0, tone=1.5, sharpen=0.8, quality=85, subsampling=2),
    "D": dict(electrons=2500, readout=6, matrix=np.eye(3), white=[1, 1, 1], denoise=0, colour=0, tone=1, sharpen=0, quality=0, subsampling=0),
}
SHOTS, KEPT = 64, 8


def linear(v):
    return np.where(v <= 0.04045, v / 12.92, ((v + 0.055) / 1.055) ** 2.4)


def encoded(v):
    v = np.clip(v, 0, 1)
    return np.where(v <= 0.0031308, v * 12.92, 1.055 * v ** (1 / 2.4) - 0.055)


def mosaic(shape):
    """Which pixels see R, G and B."""
    mask = np.zeros(shape + (3,))
    mask[0::2, 0::2, 0] = mask[0::2, 1::2, 1] = mask[1::2, 0::2, 1] = mask[1::2, 1::2, 2] = 1
    return mask


def demosaiced(raw, mask):
    green = convolve(raw * mask[..., 1], np.array([[0, 1, 0], [1, 4, 1], [0, 1, 0]]) / 4, mode="mirror")
    other = np.array([[1, 2, 1], [2, 4, 2], [1, 2, 1]]) / 4
    difference = [convolve((raw - green) * mask[..., c], other, mode="mirror") for c in (0, 2)]
    return np.stack([green + difference[0], green, green + difference[1]], -1)


def shot(light, camera, rng):
    matrix = np.array(camera["matrix"], float)
    matrix /= matrix.sum(1, keepdims=True)
    white = np.array(camera["white"], float)
    seen = np.clip(light @ np.linalg.inv(matrix).T, 0, None) / white

    def counted(v):
        return (rng.poisson(v * camera["electrons"]) + camera["readout"] * rng.standard_normal(v.shape)) / camera["electrons"]

    if camera["quality"]:
        mask = mosaic(light.shape[:2])
        raw = np.minimum(counted((seen * mask).sum(-1)), 1) * (mask * white).sum(-1)
        image = demosaiced(np.minimum(raw, 1), mask)
    else:
        image = counted(seen) * white
    v = np.clip(encoded(image @ matrix.T), 0, 1)
    if camera["tone"] != 1:
        t = camera["tone"]
        v = 0.6 * v**t / (v**t + (1 - v) ** t + 1e-9) + 0.4 * v
    if camera["denoise"] or camera["colour"]:
        luma = v @ [0.299, 0.587, 0.114]
        colour = v - luma[..., None]
        edges = np.abs(gaussian_filter(luma, 1.5) - gaussian_filter(luma, 3))
        share = 0.8 * camera["denoise"] * np.exp(-((edges / 0.02) ** 2))
        luma = luma * (1 - share) + gaussian_filter(luma, 1.0) * share
        v = luma[..., None] + gaussian_filter(colour, (camera["colour"], camera["colour"], 0))
    if camera["sharpen"]:
        v = v + camera["sharpen"] * (v - gaussian_filter(v, (1, 1, 0)))
    picture = (np.clip(v, 0, 1) * 255 + 0.5).astype(np.uint8)
    if camera["quality"]:
        file = io.BytesIO()
        Image.fromarray(picture).save(file, "JPEG", quality=camera["quality"], subsampling=camera["subsampling"])
        picture = np.asarray(Image.open(file))
    return picture


def light_of(path):
    """The light of a photograph, at most 512 x 384 px."""
    picture = Image.open(path).convert("RGB")
    if picture.width > 600:
        picture = picture.resize((384, picture.height * 384 // picture.width // 2 * 2), Image.LANCZOS)
    picture = np.asarray(picture)[: picture.height // 2 * 2, : picture.width // 2 * 2][:384, :512]
    return 0.9 * linear(gaussian_filter(picture / 255.0, (0.6, 0.6, 0)))


def main(out, photographs):
    rng = np.random.default_rng(1)
    for path in photographs:
        light = light_of(path)
        for name, camera in CAMERAS.items():
            folder = f"{out}/{name}_{os.path.splitext(os.path.basename(path))[0]}"
            os.makedirs(f"{folder}/shots", exist_ok=True)
            os.makedirs(f"{folder}/clean", exist_ok=True)
            mean = 0
            for i in range(SHOTS):
                one = shot(light, camera, rng)
                mean = mean + one / 255 / SHOTS
                if i < KEPT:
                    Image.fromarray(one).save(f"{folder}/shots/{i + 1:04}.png")
            np.save(f"{folder}/mean.npy", mean)
            for i in range(KEPT):
                Image.fromarray((mean * 255 + 0.5).astype(np.uint8)).save(f"{folder}/clean/{i + 1:04}.png")
            print(folder, flush=True)


if __name__ == "__main__":
    if len(sys.argv) < 3:
        sys.exit(__doc__)
    main(sys.argv[1], sys.argv[2:])
