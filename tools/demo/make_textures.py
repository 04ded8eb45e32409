"""Synthesise a set of tileable 1024x1024 colour textures from nothing but random numbers.

    pip install numpy opencv-python-headless
    python make_textures.py OUT

Every picture is made here; nothing is read. They wrap at the edges, have detail at all scales and an
amplitude spectrum that falls about as 1/f, like a photograph's.
"""
import argparse
import os

import cv2
import numpy as np

N = 1024


def fractal(rng, slope=1.5, low=2.0, aspect=(1.0, 1.0), n=None):
    """Periodic Gaussian noise with amplitude spectrum f^-slope below which `low` cycles are flat; zero mean, unit deviation."""
    n = n or N
    fy = np.fft.fftfreq(n)[:, None] * n * aspect[1]
    fx = np.fft.rfftfreq(n)[None, :] * n * aspect[0]
    f = np.maximum(np.hypot(fx, fy), low)
    spec = np.fft.rfft2(rng.normal(size=(n, n))) / f ** slope
    spec[0, 0] = 0
    out = np.fft.irfft2(spec, s=(n, n))
    return out / out.std()


def blur(x, sigma):
    """Gaussian blur that wraps."""
    n = x.shape[0]
    fy, fx = np.fft.fftfreq(n)[:, None], np.fft.rfftfreq(n)[None, :]
    g = np.exp(-2 * (np.pi * sigma) ** 2 * (fx * fx + fy * fy))
    if x.ndim == 3:
        return np.stack([blur(x[..., i], sigma) for i in range(x.shape[2])], -1)
    return np.fft.irfft2(np.fft.rfft2(x) * g, s=x.shape)


def unit(x, lo=1.0, hi=99.0):
    """Stretch the percentiles lo..hi to 0..1."""
    a, b = np.percentile(x, [lo, hi])
    return np.clip((x - a) / (b - a), 0, 1)


def ramp(t, *colours):
    """Piecewise linear colour map; colours are '#rrggbb'."""
    c = np.array([[int(h[i:i + 2], 16) for i in (1, 3, 5)] for h in colours]) / 255.0
    at = np.linspace(0, 1, len(c))
    return np.stack([np.interp(t, at, c[:, k]) for k in range(3)], -1)


def warp(x, dx, dy):
    """Sample x at (column + dx, row + dy), wrapping."""
    n = x.shape[0]
    pad = int(np.ceil(max(np.abs(dx).max(), np.abs(dy).max()))) + 2
    big = np.pad(x, ((pad, pad), (pad, pad)) + ((0, 0),) * (x.ndim - 2), mode="wrap").astype(np.float32)
    rows, cols = np.mgrid[0:n, 0:n].astype(np.float32)
    return cv2.remap(big, (cols + dx + pad).astype(np.float32), (rows + dy + pad).astype(np.float32), cv2.INTER_LINEAR).astype(np.float64)


def cells(rng, count):
    """Periodic Voronoi cells: distance to the nearest and second nearest site, and the nearest one's index. Sites are jittered on a grid."""
    g = int(round(np.sqrt(count)))
    step = N / g
    jit = rng.uniform(0, 1, (g, g, 2))
    rows, cols = np.mgrid[0:N, 0:N] + 0.5
    gy, gx = (rows // step).astype(int), (cols // step).astype(int)
    d1, d2, idx = np.full((N, N), 1e9), np.full((N, N), 1e9), np.zeros((N, N), int)
    for oy in (-2, -1, 0, 1, 2):
        for ox in (-2, -1, 0, 1, 2):
            cy, cx = gy + oy, gx + ox
            p = jit[cy % g, cx % g]
            d = np.hypot((cx + p[..., 0]) * step - cols, (cy + p[..., 1]) * step - rows)
            near = d < d1
            d2 = np.where(near, d1, np.minimum(d2, d))
            idx = np.where(near, (cy % g) * g + cx % g, idx)
            d1 = np.where(near, d, d1)
    return d1, d2, idx


def modulate(rgb, t, amount):
    """Brighten and darken by a zero-mean field."""
    return rgb * np.exp(amount * t)[..., None]


def stamp(canvas, rng, mask_of, count, sizes, colours):
    """Paint `count` small shapes, back to front, wrapping at the edges. mask_of(size) gives (alpha, shade)."""
    n = canvas.shape[0]
    for _ in range(count):
        s = int(np.exp(rng.uniform(np.log(sizes[0]), np.log(sizes[1]))))
        alpha, shade = mask_of(s)
        c = np.array(colours[rng.integers(len(colours))]) * rng.uniform(0.6, 1.25)
        r, k = rng.integers(n, size=2)
        ri, ki = np.arange(r, r + alpha.shape[0]) % n, np.arange(k, k + alpha.shape[1]) % n
        at = np.ix_(ri, ki)
        # a soft shadow first, so that overlapping pieces keep an edge
        canvas[np.ix_((ri + max(1, s // 12)) % n, (ki + max(1, s // 12)) % n)] *= (1 - 0.45 * alpha)[..., None]
        canvas[at] = canvas[at] * (1 - alpha[..., None]) + alpha[..., None] * c * shade[..., None]
    return canvas


def hexes(*h):
    return [np.array([int(x[i:i + 2], 16) for i in (1, 3, 5)]) / 255.0 for x in h]


# --- the textures --------------------------------------------------------------------------------------------------------

def clouds(rng, *colours):
    t = fractal(rng, 1.7) + 0.25 * fractal(rng, 1.1)
    rgb = ramp(unit(t), *colours)
    return modulate(rgb, fractal(rng, 1.2), 0.18)


def marble(rng, *colours):
    rows, cols = np.mgrid[0:N, 0:N] / N
    turb = fractal(rng, 1.8, 2)
    v = np.sin(2 * np.pi * (2 * cols + 3 * rows) + 2.6 * turb)
    vein = np.abs(v) ** 0.45
    fine = np.abs(fractal(rng, 1.6, 6)) ** 0.5
    t = unit(0.7 * vein + 0.35 * fine + 0.12 * fractal(rng, 1.1))
    return modulate(ramp(t, *colours), fractal(rng, 1.3), 0.15)


def wood(rng, *colours):
    rows, cols = np.mgrid[0:N, 0:N] / N
    bend = 0.5 * fractal(rng, 2.2, 1, (1.0, 0.25))
    rings = 9 * cols + bend
    saw = rings - np.floor(rings)
    t = 0.55 * saw ** 1.6 + 0.22 * unit(fractal(rng, 1.2, 2, (1, 0.04 * 4))) + 0.25 * unit(fractal(rng, 1.0, 4, (0.15, 2.5)))
    pores = unit(fractal(rng, 0.6, 8, (0.4, 6.0)), 50, 99.7) ** 3
    rgb = ramp(unit(t), *colours) * (1 - 0.55 * pores)[..., None]
    planks = (np.arange(N) * 4 // N)
    tone = rng.uniform(0.75, 1.2, 4)[planks]
    edge = 1 - 0.7 * np.exp(-((np.arange(N) % (N // 4)) / 3.0) ** 2)
    out = np.concatenate([np.roll(rgb[:, p * N // 4:(p + 1) * N // 4], int(rng.integers(N)), 0) for p in range(4)], 1)
    return modulate(out * (tone * edge)[None, :, None], fractal(rng, 1.3), 0.1)


def pebbles(rng, *colours):
    d1, d2, idx = cells(rng, 260)
    dx, dy = 4 * fractal(rng, 2, 3), 4 * fractal(rng, 2, 3)
    gap = warp(d2 - d1, dx, dy)
    big = warp(np.take(rng.permutation(idx.max() + 1), idx).astype(float), np.round(dx), np.round(dy))
    which = np.round(big).astype(int)
    cols = np.array(hexes(*colours))
    base = cols[rng.integers(len(cols), size=which.max() + 1)] * rng.uniform(0.55, 1.2, (which.max() + 1, 1))
    dome = np.clip(gap / 26, 0, 1) ** 0.6
    light = blur(dome, 2.0)
    slope = np.roll(light, 3, 0) + np.roll(light, 3, 1) - 2 * light
    rgb = base[which] * (0.15 + 0.85 * dome)[..., None] * (1 - 0.8 * slope)[..., None]
    return modulate(rgb, fractal(rng, 1.0, 6), 0.22)


def bricks(rng, mortar, *colours):
    rows_n, cols_n = 12, 6
    dx, dy = 3 * fractal(rng, 1.7, 4), 3 * fractal(rng, 1.7, 4)
    y, x = np.mgrid[0:N, 0:N].astype(float)
    y, x = y + dy, x + dx
    r = np.floor(y * rows_n / N)
    fy = y * rows_n / N - r
    xx = x * cols_n / N + 0.5 * (r % 2)
    c = np.floor(xx)
    fx = xx - c
    ey, ex = np.minimum(fy, 1 - fy) * N / rows_n, np.minimum(fx, 1 - fx) * N / cols_n
    inside = np.clip((np.minimum(ey, ex) - 4) / 3, 0, 1)
    pal = np.array(hexes(*colours))
    table = pal[rng.integers(len(pal), size=(rows_n, cols_n))] * rng.uniform(0.6, 1.3, (rows_n, cols_n, 1))
    rgb = table[r.astype(int) % rows_n, c.astype(int) % cols_n]
    pits = unit(fractal(rng, 0.9, 10), 60, 99.5)
    rgb = modulate(rgb, fractal(rng, 1.1, 5), 0.25) * (1 - 0.5 * pits)[..., None]
    m = modulate(np.broadcast_to(hexes(mortar)[0], rgb.shape), fractal(rng, 0.9, 8), 0.2)
    shade = 1 - 0.35 * np.clip(1 - (np.minimum(fy * N / rows_n, 12)) / 12, 0, 1)
    return modulate((inside[..., None] * rgb + (1 - inside[..., None]) * m) * shade[..., None], fractal(rng, 1.8), 0.12)


def cloth(rng, warp_colours, weft_colours):
    threads = 128
    y, x = np.mgrid[0:N, 0:N].astype(float)
    x, y = x + 2 * fractal(rng, 1.9, 3), y + 2 * fractal(rng, 1.9, 3)
    u, v = x * threads / N, y * threads / N
    iu, iv = np.floor(u).astype(int) % threads, np.floor(v).astype(int) % threads
    fu, fv = u - np.floor(u), v - np.floor(v)
    over = ((iu + iv) % 4) < 2
    def stripes(cols):
        pal = np.array(hexes(*cols))
        run = np.repeat(rng.integers(len(pal), size=threads), rng.integers(1, 13, size=threads))[:threads]
        return pal[run] * rng.uniform(0.75, 1.2, (threads, 1))
    a, b = stripes(warp_colours)[iu], stripes(weft_colours)[iv]
    rgb = np.where(over[..., None], a, b)
    prof = np.where(over, np.sin(np.pi * fu), np.sin(np.pi * fv)) ** 0.7
    along = np.where(over, np.sin(np.pi * (v % 2) / 2), np.sin(np.pi * (u % 2) / 2))
    rgb = rgb * (0.45 + 0.45 * prof + 0.1 * along)[..., None]
    return modulate(modulate(rgb, fractal(rng, 1.7), 0.18), fractal(rng, 0.7, 10), 0.10)


def granite(rng, *colours):
    pal = hexes(*colours)
    rgb = np.broadcast_to(pal[0], (N, N, 3)).copy()
    for i, (count, sharp) in enumerate([(400, 1.2), (1600, 1.0), (6400, 0.8), (14400, 0.7)]):
        _, _, idx = cells(rng, count)
        grains = rng.integers(len(pal), size=idx.max() + 1)
        keep = rng.random(idx.max() + 1) < 0.5
        tone = rng.uniform(0.6, 1.3, idx.max() + 1)
        dx, dy = 6 * fractal(rng, 1.4, 8), 6 * fractal(rng, 1.4, 8)
        rr, cc = np.mgrid[0:N, 0:N]
        w = idx[(rr + np.round(dy).astype(int)) % N, (cc + np.round(dx).astype(int)) % N]
        layer = np.array(pal)[grains[w]] * tone[w][..., None]
        rgb = np.where(keep[w][..., None], layer, rgb)
    return modulate(modulate(rgb, fractal(rng, 1.6), 0.2), fractal(rng, 0.8, 8), 0.1)


def leaves(rng, ground, *colours):
    canvas = clouds(rng, *ground) * 0.7
    pal = hexes(*colours)

    def leaf(s):
        y, x = np.mgrid[-s:s + 1, -s:s + 1] / s
        a = rng.uniform(0, 2 * np.pi)
        u, v = np.cos(a) * x + np.sin(a) * y, -np.sin(a) * x + np.cos(a) * y
        width = rng.uniform(0.28, 0.5) * np.clip(1 - u * u, 0, 1) ** 0.8
        alpha = np.clip((width - np.abs(v)) * s / 1.2, 0, 1)
        vein = np.exp(-(v / 0.03) ** 2) + 0.6 * (np.abs(np.sin(9 * (u - 0.8 * np.abs(v)))) < 0.12)
        shade = (0.8 + 0.35 * v / 0.4) * (1 - 0.3 * np.clip(vein, 0, 1)) * (1 + 0.1 * rng.normal(size=u.shape))
        return alpha, shade

    stamp(canvas, rng, leaf, 1500, (10, 90), pal)
    return modulate(canvas, fractal(rng, 1.3), 0.12)


def spots(rng, ground, *colours):
    canvas = clouds(rng, *ground)
    pal = hexes(*colours)

    def disc(s):
        y, x = np.mgrid[-s:s + 1, -s:s + 1] / s
        a = np.arctan2(y, x)
        r = 0.72 + 0.12 * np.sin(2 * a + rng.uniform(0, 6)) + 0.08 * np.sin(5 * a + rng.uniform(0, 6))
        alpha = np.clip((r - np.hypot(x, y)) * s / 1.5, 0, 1)
        ring = 0.75 + 0.35 * np.sin(rng.uniform(3, 12) * np.hypot(x, y) + rng.uniform(0, 6))
        return alpha, ring

    stamp(canvas, rng, disc, 1800, (3, 80), pal)
    return modulate(canvas, fractal(rng, 1.2), 0.18)


def print_(rng, paper, *inks):
    """Pages of invented glyphs: blocks of made-up letters at several sizes, rules, and coloured panels."""
    rgb = np.broadcast_to(hexes(paper)[0], (N, N, 3)).copy()
    pal = hexes(*inks)
    glyphs = []
    for _ in range(40):                                                    # a letter: a few strokes on a 5 x 7 grid
        g = np.zeros((7, 5))
        for _ in range(rng.integers(2, 5)):
            if rng.random() < 0.5:
                g[rng.integers(7), rng.integers(0, 2):rng.integers(3, 6)] = 1
            else:
                g[rng.integers(0, 3):rng.integers(4, 8), rng.integers(5)] = 1
        glyphs.append(g)
    y = 0
    while y < N:
        h = int(rng.choice([128, 192, 256]))
        h = min(h, N - y)
        x = 0
        while x < N:
            w = min(int(rng.choice([128, 256, 384])), N - x)
            ink, ground = pal[rng.integers(len(pal))], None
            if rng.random() < 0.45:
                ground = pal[rng.integers(len(pal))] * rng.uniform(0.7, 1.3)
                rgb[y:y + h, x:x + w] = np.clip(ground, 0, 1)
                ink = hexes(paper)[0] if ground.mean() < 0.55 else pal[0]
            k = int(rng.choice([1, 2, 2, 3, 4, 8, 14]))                    # pixels per stroke
            ry = y + 8
            while ry + 7 * k <= y + h - 6:
                rx = x + 8
                end = x + w - 8 - (rng.integers(0, w // 3) if rng.random() < 0.3 else 0)
                while rx + 5 * k <= end:
                    if rng.random() > 0.16:
                        g = np.kron(glyphs[rng.integers(40)], np.ones((k, k)))[..., None]
                        part = rgb[ry:ry + 7 * k, rx:rx + 5 * k]
                        rgb[ry:ry + 7 * k, rx:rx + 5 * k] = part * (1 - g) + ink * g
                    rx += 6 * k + (k + 1) // 2
                ry += int(7 * k * 1.5)
            x += w
        y += h
    rgb = blur(rgb, 0.7)
    return modulate(modulate(rgb, fractal(rng, 1.6), 0.15), fractal(rng, 0.9, 6), 0.08)


def tiles(rng, *colours):
    """A patchwork: squares split again and again, each with its own colour and its own noise."""
    pal = np.array(hexes(*colours))
    rgb = np.zeros((N, N, 3))
    noise = [fractal(rng, s) for s in (1.0, 1.3, 1.7)]

    def split(y, x, s):
        if s > 32 and (s > 256 or rng.random() < 0.62):
            for oy in (0, s // 2):
                for ox in (0, s // 2):
                    split(y + oy, x + ox, s // 2)
            return
        c = pal[rng.integers(len(pal))] * rng.uniform(0.6, 1.2)
        t = noise[rng.integers(3)][y:y + s, x:x + s]
        rgb[y:y + s, x:x + s] = c * np.exp(rng.uniform(0.1, 0.35) * t)[..., None]
        m = max(1, s // 32)
        rgb[y:y + m, x:x + s] *= 0.35
        rgb[y:y + s, x:x + m] *= 0.35
        if s >= 64 and rng.random() < 0.6:                                 # a disc or a stripe inside
            yy, xx = np.mgrid[0:s, 0:s] - s / 2
            c2 = pal[rng.integers(len(pal))]
            r = np.hypot(yy, xx) if rng.random() < 0.6 else np.abs(yy + xx)
            a = np.clip(s * rng.uniform(0.12, 0.4) - r, 0, 1)[..., None]
            rgb[y:y + s, x:x + s] = rgb[y:y + s, x:x + s] * (1 - a) + a * c2 * np.exp(0.2 * t)[..., None]

    split(0, 0, N)
    return modulate(blur(rgb, 0.5), fractal(rng, 1.0, 8), 0.1)


def cracked(rng, *colours):
    """Dry mud: cells within cells, cracks thinner at each scale."""
    h = fractal(rng, 1.7)
    dark = np.ones((N, N))
    for count, width in ((64, 7), (400, 3.5), (2500, 1.8)):
        d1, d2, idx = cells(rng, count)
        gap = warp(d2 - d1, 8 * fractal(rng, 1.6, 4), 8 * fractal(rng, 1.6, 4))
        dark *= 1 - (0.75 if count < 1000 else 0.5) * np.exp(-(gap / width) ** 2)
        h = h + 0.35 * rng.normal(size=idx.max() + 1)[idx]
    return modulate(ramp(unit(h), *colours) * dark[..., None], fractal(rng, 1.0, 4), 0.18)


def grass(rng, *colours):
    pal = hexes(*colours)
    canvas = ramp(unit(fractal(rng, 1.5)), colours[0], colours[1]) * 0.5

    def blade(s):
        w = max(3, s // 6)
        h = 2 * s
        y, x = np.mgrid[0:h, 0:s * 1] / np.array([h, s]).reshape(2, 1, 1)
        bend, x0, lean = rng.uniform(-0.35, 0.35), rng.uniform(0.3, 0.7), rng.uniform(-0.2, 0.2)
        centre = x0 + bend * (1 - y) ** 2 + lean * (1 - y)
        half = 0.5 * w / s * y ** 0.6
        return np.clip((half - np.abs(x - centre)) * s / 1.2 + 0.5, 0, 1) * (y > 0.02), 0.55 + 0.6 * (1 - y) + 0.25 * (x - centre) * s / w

    stamp(canvas, rng, blade, 5000, (10, 70), pal)
    return modulate(canvas, fractal(rng, 1.4), 0.15)


TEXTURES = {
    "bricks_red": lambda r: bricks(r, "#b8ae9c", "#a5452f", "#8c3a2b", "#c06a45", "#7a4034", "#b88460"),
    "bricks_blue": lambda r: bricks(r, "#3c3a38", "#4f7f9e", "#7fb0c4", "#d8d2b8", "#2f5a80", "#c79a4a"),
    "cloth_plaid": lambda r: cloth(r, ("#b8202e", "#1e3f7a", "#f0e4c4", "#1d6a48"), ("#c83a3a", "#16305c", "#e8d8a8", "#d8a428")),
    "clouds_copper": lambda r: clouds(r, "#12324a", "#2f8f83", "#d8c38a", "#b5562a", "#4a1820"),
    "clouds_violet": lambda r: clouds(r, "#1c1440", "#6a3d9a", "#e06a8a", "#f6d29a", "#f8f4e0"),
    "cracked_clay": lambda r: cracked(r, "#6b3f24", "#b07a48", "#e0c090", "#c86a3a"),
    "grass": lambda r: grass(r, "#1e3a16", "#3f6a24", "#6f9a34", "#a8b850", "#d0c878", "#507a2c"),
    "granite_pink": lambda r: granite(r, "#c89080", "#e8c8b8", "#40383a", "#f0ece4", "#985a50", "#787074"),
    "leaves_autumn": lambda r: leaves(r, ("#2a1c12", "#5a4028", "#806038"), "#d8501c", "#e8a020", "#a82818", "#788a28", "#c87830", "#f0c850"),
    "marble_green": lambda r: marble(r, "#e8f0dc", "#7ab08a", "#2a6a58", "#103028"),
    "patchwork": lambda r: tiles(r, "#d84030", "#f0b030", "#3070b0", "#40a070", "#f0e8d8", "#70408a", "#303840"),
    "pebbles": lambda r: pebbles(r, "#a89880", "#706860", "#d0c4b0", "#8a5a40", "#5a7080", "#e0dcd0", "#b08a50"),
    "print": lambda r: print_(r, "#ece4d0", "#1a1a20", "#a02020", "#1a4080", "#207050", "#d8a020"),
    "spots_reef": lambda r: spots(r, ("#083a5a", "#1880a0", "#60c0b0"), "#f07040", "#f8d050", "#e84070", "#f8f0e0", "#205090", "#30a060"),
    "wood_oak": lambda r: wood(r, "#e0b070", "#b8803c", "#805024", "#4a2c14"),
    "wood_teal": lambda r: wood(r, "#d8e0c8", "#68a8a0", "#2c6874", "#183848"),
}


def main():
    ap = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    ap.add_argument("out")
    ap.add_argument("--only", default="")
    o = ap.parse_args()
    os.makedirs(o.out, exist_ok=True)
    for i, (name, make) in enumerate(TEXTURES.items()):
        if o.only and o.only not in name:
            continue
        x = make(np.random.default_rng(1000 + i))
        x = np.clip(x / np.percentile(x, 99.5) * 0.97, 0, 1)
        x **= np.clip(np.log(0.42) / np.log(x.mean()), 0.6, 1)             # the dark ones lighter
        b = (x * 255 + 0.5).astype(np.uint8)
        cv2.imwrite(os.path.join(o.out, name + ".png"), np.ascontiguousarray(b[..., ::-1]))


if __name__ == "__main__":
    main()
