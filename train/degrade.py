"""What a camera does to a sharp scene, as training pairs: blur in linear light, noise in encoded values."""
import cv2
import numpy as np
from numba import njit

import sharp

MAX_STD = 6.0  # largest std of the defocus, px
MAX_MOTION = 24.0  # fastest motion, px per frame interval
PAD = 28  # px of scene around a crop, which blur brings into it

_v = np.arange(256, dtype=np.float32) / 255
TO_LINEAR = np.where(_v <= 0.04045, _v / 12.92, ((_v + 0.055) / 1.055) ** 2.4).astype(np.float32)


_v = np.arange(65536, dtype=np.float64) / 65535
TO_ENCODED = np.where(_v <= 0.0031308, 12.92 * _v, 1.055 * np.maximum(_v, 0.0031308) ** (1 / 2.4) - 0.055).astype(np.float32)


@njit(cache=True, nogil=True)
def encode(x):
    out = np.empty_like(x)
    for i in range(x.size):
        v = min(max(x.flat[i], 0), 1)
        out.flat[i] = TO_ENCODED[int(v * 65535 + 0.5)]
    return out


@njit(cache=True, nogil=True, fastmath=True)
def lens(layer, a, b, c, gauss, out):
    """Blurs `layer` (4, H, W, premultiplied) with std |a + b x + c y| px into its inner part `out` (h, w, 4), by a disk (diameter 4 std) or a Gaussian."""
    h, w, _ = out.shape
    pad = (layer.shape[1] - h) // 2
    size = 2 * pad + 1
    dist = np.empty((size, size), np.float32)
    for i in range(size):
        for j in range(size):
            dist[i, j] = np.sqrt(np.float32((i - pad) ** 2 + (j - pad) ** 2))
    zero, one = np.float32(0), np.float32(1)
    for y in range(h):
        for x in range(w):
            std = min(abs(a + b * x + c * y), 6.0)
            n = min(int(3 * std if gauss else 2 * std + 0.5), pad)
            if n == 0:
                for k in range(4):
                    out[y, x, k] = layer[k, y + pad, x + pad]
                continue
            rim = np.float32(2 * std + 0.5)
            inv = np.float32(1 / (20 * std * std))
            s0 = s1 = s2 = s3 = total = zero
            for dy in range(pad - n, pad + n + 1):
                d = dist[dy, pad - n : pad + n + 1]
                p0 = layer[0, y + dy, x + pad - n : x + pad + n + 1]
                p1 = layer[1, y + dy, x + pad - n : x + pad + n + 1]
                p2 = layer[2, y + dy, x + pad - n : x + pad + n + 1]
                p3 = layer[3, y + dy, x + pad - n : x + pad + n + 1]
                if gauss:  # (1 - d^2 / 20 std^2)^8 is nearly one, and cheap
                    for i in range(2 * n + 1):
                        e = max(one - d[i] * d[i] * inv, zero)
                        e = e * e
                        e = e * e
                        e = e * e
                        s0 += e * p0[i]
                        s1 += e * p1[i]
                        s2 += e * p2[i]
                        s3 += e * p3[i]
                        total += e
                else:  # a disk with a soft rim
                    for i in range(2 * n + 1):
                        e = min(max(rim - d[i], zero), one)
                        s0 += e * p0[i]
                        s1 += e * p1[i]
                        s2 += e * p2[i]
                        s3 += e * p3[i]
                        total += e
            out[y, x, 0] = s0 / total
            out[y, x, 1] = s1 / total
            out[y, x, 2] = s2 / total
            out[y, x, 3] = s3 / total


@njit(cache=True, nogil=True, fastmath=True)
def shutter(layers, motion, t0, t1, taps, out):
    """Mean over the times t0..t1 of the layers (N, H, W, 4, premultiplied, back to front) moved by
    source(x, t) = x + t (v + G x) + t^2 acc, with motion = [v, G row by row, acc] per layer and x from the centre."""
    h, w, _ = out.shape
    hh, ww = layers.shape[1], layers.shape[2]
    inv = np.float32(1) / np.float32(taps)
    cx, cy = np.float32(ww * 0.5), np.float32(hh * 0.5)
    top, zero, one = np.float32(min(ww, hh) - 1.01), np.float32(0), np.float32(1)
    for y in range(h):
        py = np.float32(y - h * 0.5)
        for x in range(w):
            px = np.float32(x - w * 0.5)
            s0 = s1 = s2 = zero
            for k in range(taps):
                t = np.float32(t0) + np.float32(t1 - t0) * (np.float32(k) + np.float32(0.5)) * inv
                c0 = c1 = c2 = zero
                for n in range(layers.shape[0]):
                    m = motion[n]
                    sx = px + t * (m[0] + m[2] * px + m[3] * py + t * m[6]) + cx
                    sy = py + t * (m[1] + m[4] * px + m[5] * py + t * m[7]) + cy
                    sx = min(max(sx, zero), top)
                    sy = min(max(sy, zero), top)
                    ix = int(sx)
                    iy = int(sy)
                    if n > 0 and layers[n, iy, ix, 3] + layers[n, iy + 1, ix + 1, 3] + layers[n, iy, ix + 1, 3] + layers[n, iy + 1, ix, 3] == 0:
                        continue
                    fx = sx - np.float32(ix)
                    fy = sy - np.float32(iy)
                    w00 = (one - fx) * (one - fy)
                    w01 = fx * (one - fy)
                    w10 = (one - fx) * fy
                    w11 = fx * fy
                    keep = zero
                    if n > 0:
                        keep = one - (w00 * layers[n, iy, ix, 3] + w01 * layers[n, iy, ix + 1, 3] + w10 * layers[n, iy + 1, ix, 3] + w11 * layers[n, iy + 1, ix + 1, 3])
                    c0 = c0 * keep + w00 * layers[n, iy, ix, 0] + w01 * layers[n, iy, ix + 1, 0] + w10 * layers[n, iy + 1, ix, 0] + w11 * layers[n, iy + 1, ix + 1, 0]
                    c1 = c1 * keep + w00 * layers[n, iy, ix, 1] + w01 * layers[n, iy, ix + 1, 1] + w10 * layers[n, iy + 1, ix, 1] + w11 * layers[n, iy + 1, ix + 1, 1]
                    c2 = c2 * keep + w00 * layers[n, iy, ix, 2] + w01 * layers[n, iy, ix + 1, 2] + w10 * layers[n, iy + 1, ix, 2] + w11 * layers[n, iy + 1, ix + 1, 2]
                s0 += c0
                s1 += c1
                s2 += c2
            out[y, x, 0] = s0 * inv
            out[y, x, 1] = s1 * inv
            out[y, x, 2] = s2 * inv


class Camera:
    """Makes (input, target) pairs from a pool of sharp images; both float32, channels first, encoded."""

    def __init__(self, photos, drawn, seed):
        self.rng = np.random.default_rng(seed)
        self.pools = [p for p in (photos, drawn) if p]
        r = np.random.default_rng(7)
        self.masks = [self._mask(r, 320) for _ in range(96)]
        self.bands = [self._band(r, k) for k in range(4)]

    # -- sharp material

    @staticmethod
    def _mask(r, n):
        kind = r.integers(4)
        if kind == 0:  # a blob
            m = cv2.GaussianBlur(r.standard_normal((n, n)).astype(np.float32), (0, 0), r.uniform(8, 30))
            return (m > r.uniform(-0.3, 1) * m.std()).astype(np.float32)
        big = np.zeros((2 * n, 2 * n), np.uint8)
        for _ in range(r.integers(1, 8)):
            s = int(r.uniform(40, 420))
            y, x = r.integers(0, 2 * n - s, 2)
            part = big[y : y + s, x : x + s]
            np.maximum(part, sharp.shape(r, s), out=part)
        if kind == 3:
            for _ in range(6):
                big = np.maximum(big, sharp.text_mask(r, 2 * n))
        return cv2.resize(big, (n, n), interpolation=cv2.INTER_AREA).astype(np.float32) / 255

    @staticmethod
    def _band(r, k, n=768):
        """Octave k of white noise, scaled to std 1."""
        w = r.standard_normal((n >> k, n >> k, 3)).astype(np.float32)
        w = w - cv2.pyrUp(cv2.pyrDown(w), dstsize=(n >> k, n >> k))
        for _ in range(k):
            w = cv2.pyrUp(w)
        return w / w.std()

    def crop(self, n):
        """A linear crop of n x n x 3: of up to three places the one with most detail, since blurred targets would teach to keep blur."""
        r = self.rng
        best, most = None, -1.0
        for _ in range(3 if r.random() < 0.85 else 1):
            pool = self.pools[int(r.random() < 0.5) % len(self.pools)]
            im = pool[r.integers(len(pool))]
            if min(im.shape[:2]) < n:
                im = cv2.copyMakeBorder(im, *([max(0, n - im.shape[0])] * 2), *([max(0, n - im.shape[1])] * 2), cv2.BORDER_REFLECT_101)
            y, x = r.integers(0, im.shape[0] - n + 1), r.integers(0, im.shape[1] - n + 1)
            c = im[y : y + n, x : x + n]
            d = min(sharp.detail(c[::2]), 25) * r.uniform(0.5, 1)
            if d > most:
                best, most = c, d
        c = best[:, ::-1] if r.random() < 0.5 else best
        c = c[::-1] if r.random() < 0.5 else c
        c = c.swapaxes(0, 1) if r.random() < 0.5 else c
        to_linear = TO_LINEAR
        if r.random() < 0.5:  # another exposure and contrast
            to_linear = to_linear ** np.float32(r.uniform(0.6, 1.5)) * np.float32(r.uniform(0.4, 1))
        if r.random() < 0.1:  # saturated lights
            to_linear = to_linear * np.float32(r.uniform(1, 2))
        c = to_linear[np.ascontiguousarray(c[..., r.permutation(3)])]
        if r.random() < 0.3:  # grey or nearly
            c += np.float32(r.uniform(0.5, 1)) * (c.mean(2, keepdims=True) - c)
        return c

    def layers(self, n, most=3):
        """Layers of shape (N, n, n, 4), premultiplied and linear, back to front."""
        r = self.rng
        out = np.ones((r.integers(1, most + 1), n, n, 4), np.float32)
        for i, l in enumerate(out):
            l[..., :3] = self.crop(n)
            if i:
                m = self.masks[r.integers(len(self.masks))]
                y, x = r.integers(0, m.shape[0] - n + 1, 2) if n < m.shape[0] else (0, 0)
                m = m[y : y + n, x : x + n]
                if m.shape[0] < n:
                    m = np.pad(m, ((0, n - m.shape[0]), (0, n - m.shape[1])))
                l[..., :3] *= m[..., None]
                l[..., 3] = m
        return out

    # -- the camera's last steps

    def noise(self, x, readout, shot):
        """Encoded h x w x 3 plus noise of std readout + shot sqrt(x), correlated over octaves and channels to a random degree."""
        r = self.rng
        h, w, _ = x.shape
        gain = np.array([1, 0.5, 0.25, 0.125]) if r.random() < 0.3 else np.exp(r.normal(0, 0.6, 4)) * 2.0 ** -(np.arange(4) * r.uniform(0, 1.5))
        field = np.zeros((h, w, 3), np.float32)
        for g, b in zip(gain / np.sqrt((gain**2).sum()), self.bands):
            y, k = r.integers(0, b.shape[0] - h + 1), r.integers(0, b.shape[1] - w + 1)
            field += np.float32(g) * b[y : y + h, k : k + w][:: r.choice((-1, 1)), :: r.choice((-1, 1))]
        mix = np.eye(3) + r.uniform(0, 1) * r.uniform(0, 1, (3, 3))
        mix *= (r.uniform(0.6, 1.4, 3) / np.sqrt((mix**2).sum(1)))[:, None]
        return x + field @ mix.T.astype(np.float32) * (readout + shot * np.sqrt(np.maximum(x, 0)))

    def capture(self, images):
        """Encoded images as a camera with little noise delivers them: 8 bits, sometimes compressed."""
        r = self.rng
        readout, shot = r.uniform(0, 0.006), r.uniform(0, 0.008)
        quality = int(r.integers(75, 99)) if r.random() < 0.25 else None
        out = []
        for x in images:
            x = np.clip(self.noise(x, readout, shot) if readout > 0.001 else x, 0, 1)
            x = (x * 255 + 0.5).astype(np.uint8)
            if quality:
                x = cv2.imdecode(cv2.imencode(".jpg", x, [cv2.IMWRITE_JPEG_QUALITY, quality])[1], 1)
            out.append(x.astype(np.float32) / 255)
        return out

    # -- one training pair of each task, n x n

    def defocus(self, n):
        r = self.rng
        layers = self.layers(n + 2 * PAD)
        gauss = r.random() < 0.2
        blurred, clean = np.zeros((n, n, 3), np.float32), np.zeros((n, n, 3), np.float32)
        part = np.empty((n, n, 4), np.float32)
        top = MAX_STD * r.random()
        everywhere = r.random() < 0.08  # some pairs have no blur to remove
        for l in layers:
            # along a plane, the std is |a + b x + c y|, since a thin lens is linear in inverse depth
            slope = r.normal(0, 1.5 * top / n, 2) * (r.random() < 0.7)
            centre = 0.0 if r.random() < 0.2 else top * r.uniform(-1, 1)
            a = centre - slope.sum() * n / 2
            if everywhere:
                part[:] = l[PAD:-PAD, PAD:-PAD]
            else:
                lens(np.ascontiguousarray(l.transpose(2, 0, 1)), a, slope[0], slope[1], gauss, part)
            blurred = blurred * (1 - part[..., 3:]) + part[..., :3]
            inner = l[PAD:-PAD, PAD:-PAD]
            clean = clean * (1 - inner[..., 3:]) + inner[..., :3]
        return self.capture([encode(blurred)]), encode(clean)

    def motion(self, n):
        r = self.rng
        layers = self.layers(n + 2 * PAD)
        m = np.zeros((len(layers), 8), np.float32)
        fastest = MAX_MOTION * r.random() ** 1.2 * (r.random() > 0.08)
        shared = r.normal(0, 0.4, 2)
        for row in m:
            v = shared + r.normal(0, 0.6, 2)
            row[:2] = v / max(1.0, np.hypot(*v)) * fastest
            row[2:6] = r.normal(0, 0.25 * fastest / n, 4) * (r.random() < 0.6)
            row[6:] = r.normal(0, 0.06 * fastest, 2)
        exposure = r.random() if r.random() > 0.05 else 0.0
        longest = exposure * (np.hypot(m[:, 0], m[:, 1]) + np.abs(m[:, 2:6]).sum(1) * n / 2 + 2 * np.hypot(m[:, 6], m[:, 7])).max()
        taps = 1 if exposure == 0 else int(np.ceil(longest)) + 2
        frames = []
        out = np.empty((n, n, 3), np.float32)
        for t in (-1, 0, 1):
            shutter(layers, m, t - exposure / 2, t + exposure / 2, taps, out)
            frames.append(encode(out))
        shutter(layers, m, 0.0, 0.0, 1, out)
        return self.capture(frames), encode(out)

    def noisy(self, n):
        r = self.rng
        clean = encode(self.crop(n))
        if r.random() < 0.4:  # real footage is not sharp everywhere
            clean = cv2.GaussianBlur(clean, (0, 0), r.uniform(0.3, 2.5))
        std = 0.002 * 30 ** r.random()
        part = r.random()
        x = self.noise(clean, std * part, 1.4 * std * (1 - part))
        return [np.floor(np.clip(x, 0, 1) * 255 + 0.5).astype(np.float32) / 255], clean

    def pair(self, task, n):
        given, clean = {"defocus": self.defocus, "motion": self.motion, "noise": self.noisy}[task](n)
        return np.concatenate(given, 2).transpose(2, 0, 1), clean.transpose(2, 0, 1)

    def batch(self, task, count, n):
        pairs = [self.pair(task, n) for _ in range(count)]
        return np.stack([p[0] for p in pairs]), np.stack([p[1] for p in pairs])
