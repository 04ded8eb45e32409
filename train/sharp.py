"""Sharp, noise-free images: photographs made smaller, and procedural pictures."""
import pathlib
import pickle
import zlib

import cv2
import numpy as np

EXT = {".jpg", ".jpeg", ".png", ".webp"}
# Samples of scikit-image and scikit-learn are used only for measuring, since the rendered clips of the measurement use some as textures.
SKIMAGE = ("astronaut.png", "coffee.png", "chelsea.png", "rocket.jpg")
SKLEARN = ("china.jpg", "flower.jpg")
HELD_OUT = 8  # one in this many pictures of the folders is used only for measuring


def sample_files():
    import skimage
    import sklearn

    a = pathlib.Path(skimage.__file__).parent / "data"
    b = pathlib.Path(sklearn.__file__).parent / "datasets/images"
    return [a / n for n in SKIMAGE] + [b / n for n in SKLEARN]


def held_out(path):
    return zlib.crc32(path.as_posix().split("/share/")[-1].encode()) % HELD_OUT == 0


def detail(im):
    """Mean absolute Laplacian, in 8-bit steps: near 0 for gradients and blurred pictures."""
    return np.abs(cv2.Laplacian(cv2.cvtColor(im, cv2.COLOR_RGB2GRAY), cv2.CV_32F)).mean()


def photographs(folders, held=False):
    """sRGB uint8 images at one or two scales, each at least 2 times smaller than its file."""
    files = [f for d in folders for f in sorted(pathlib.Path(d).rglob("*")) if f.suffix.lower() in EXT and "screenshot" not in f.name]
    files = [f for f in files if f.is_file() and held_out(f) == held]
    seen, out = set(), []
    for f in files + (sample_files() if held else []):
        im = cv2.imread(str(f), cv2.IMREAD_COLOR)
        if im is None or min(im.shape[:2]) < 300:
            continue
        key = zlib.crc32(cv2.resize(im, (16, 16), interpolation=cv2.INTER_AREA).tobytes())
        if key in seen:  # the same picture in another size
            continue
        seen.add(key)
        first = max(2.0, min(im.shape[:2]) / 720)
        for k in (first, 2 * first):
            small = cv2.resize(im, None, fx=1 / k, fy=1 / k, interpolation=cv2.INTER_AREA)
            if min(small.shape[:2]) >= 200 and detail(small) > 2:
                out.append(np.ascontiguousarray(small[..., ::-1]))
    return out


def one_over_f(rng, n, alpha):
    f = np.hypot(np.fft.fftfreq(n)[:, None], np.fft.rfftfreq(n)[None])
    f[0, 0] = 1
    g = np.fft.irfft2(np.fft.rfft2(rng.standard_normal((3, n, n))) / f**alpha, (n, n))
    g = np.tensordot(0.75 * np.ones((3, 3)) / 3 + 0.25 * np.eye(3), g, 1)
    g = (g - g.mean()) / g.std()
    return g.transpose(1, 2, 0).astype(np.float32)


def colour(rng):
    return rng.uniform(0, 1, 3).astype(np.float32) ** rng.uniform(0.5, 1.5)


def texture(rng, n):
    """n x n x 3 in 0..1"""
    kind = rng.integers(5)
    a, b = colour(rng), colour(rng)
    if kind <= 1:
        t = one_over_f(rng, n, rng.uniform(0.7, 1.7)) * rng.uniform(0.05, 0.25)
        return np.clip(a + t, 0, 1)
    y, x = np.mgrid[:n, :n].astype(np.float32)
    ang = rng.uniform(0, np.pi)
    u, v = x * np.cos(ang) + y * np.sin(ang), y * np.cos(ang) - x * np.sin(ang)
    p = 2 ** rng.uniform(2.5, 6)
    if kind == 2:
        m = 0.5 + 0.5 * np.sin(2 * np.pi * u / p)
    elif kind == 3:
        m = ((u % p) < p * rng.uniform(0.2, 0.8)).astype(np.float32)
    else:
        m = ((np.floor(u / p) + np.floor(v / p)) % 2).astype(np.float32)
    return np.clip(a + (b - a) * m[..., None] + 0.02 * one_over_f(rng, n, 1), 0, 1)


def shape(rng, n):
    """n x n mask in {0, 255}"""
    m = np.zeros((n, n), np.uint8)
    kind = rng.integers(5)
    if kind == 0:
        cv2.circle(m, (n // 2, n // 2), n // 2 - 1, 255, -1)
    elif kind == 1:
        cv2.ellipse(m, (n // 2, n // 2), (n // 2 - 1, max(1, int(n * rng.uniform(0.1, 0.45)))), rng.uniform(0, 180), 0, 360, 255, -1)
    elif kind == 2:
        box = ((n / 2, n / 2), (n * 0.7, n * rng.uniform(0.05, 0.7)), rng.uniform(0, 180))
        cv2.fillPoly(m, [cv2.boxPoints(box).astype(np.int32)], 255)
    elif kind == 3:
        k = rng.integers(3, 9)
        t = np.sort(rng.uniform(0, 2 * np.pi, k))
        r = n / 2 * rng.uniform(0.3, 1, k)
        cv2.fillPoly(m, [np.stack([n / 2 + r * np.cos(t), n / 2 + r * np.sin(t)], 1).astype(np.int32)], 255)
    else:
        cv2.circle(m, (n // 2, n // 2), n // 2 - 1, 255, max(1, n // 10))
    return m


def text_mask(rng, n):
    m = np.zeros((n, n), np.uint8)
    word = "".join(chr(rng.integers(33, 126)) for _ in range(rng.integers(3, 14)))
    at = (int(rng.integers(-20, n // 2)), int(rng.integers(10, n)))
    size = rng.uniform(0.6, 4)
    cv2.putText(m, word, at, cv2.FONT_HERSHEY_SIMPLEX, size, 255, max(1, int(size * rng.uniform(0.8, 3))), cv2.LINE_AA)
    return m


def write_text(rng, im, count):
    for _ in range(count):
        m = (text_mask(rng, im.shape[0]) / np.float32(255))[..., None]
        im += m * (colour(rng) - im)


def bank(rng, n):
    """Textures and grains that all procedural pictures draw from, rolled and flipped."""
    grain = [one_over_f(rng, n, a) for a in (1.5, 1.5, 0.4, 0.2)]
    return [texture(rng, n) for _ in range(48)], grain


def pick(rng, fields):
    f = fields[rng.integers(len(fields))]
    f = np.roll(f, tuple(rng.integers(0, f.shape[0], 2)), (0, 1))
    return f.swapaxes(0, 1) if rng.random() < 0.5 else f


def procedural(rng, tex, grain):
    """Dead leaves with textures and text, drawn at twice the size."""
    big = tex[0].shape[0]
    own = [pick(rng, tex) for _ in range(6)]
    im = own[0].copy()
    for _ in range(int(2 ** rng.uniform(5, 9))):
        s = int(min(big * 0.6, 8 / rng.uniform(0.02, 1) + 4))
        y, x = rng.integers(-s // 2, big - s // 2, 2)
        y0, x0, y1, x1 = max(y, 0), max(x, 0), min(y + s, big), min(x + s, big)
        m = (shape(rng, s)[y0 - y : y1 - y, x0 - x : x1 - x, None] > 0).astype(np.float32)
        fill = own[rng.integers(6)][y0:y1, x0:x1] * np.float32(rng.uniform(0.4, 1.2)) if rng.random() < 0.5 else colour(rng)
        part = im[y0:y1, x0:x1]
        part += m * (fill - part)
    if rng.random() < 0.3:
        write_text(rng, im, int(rng.integers(2, 10)))
    im = np.clip(im, 0, 1)
    if rng.random() < 0.6:  # shading and fine grain of the surfaces, which belongs to the sharp image
        im = im * (1 + 0.2 * pick(rng, grain[:2])) * (1 + np.float32(rng.uniform(0, 0.08)) * pick(rng, grain[2:]))
    im = cv2.resize(np.clip(im, 0, 1), (big // 2, big // 2), interpolation=cv2.INTER_AREA)
    return (im * 255 + 0.5).astype(np.uint8)


def pool(folders, count, held=False, cache=None):
    """Photographs, and `count` procedural pictures; kept in the file `cache`."""
    if cache and pathlib.Path(cache).exists():
        with open(cache, "rb") as f:
            return pickle.load(f)
    rng = np.random.default_rng(1_000_003 if held else 1)
    tex, grain = bank(rng, 768)
    out = photographs(folders, held), [procedural(rng, tex, grain) for _ in range(count)]
    if cache:
        with open(cache, "wb") as f:
            pickle.dump(out, f)
    return out
