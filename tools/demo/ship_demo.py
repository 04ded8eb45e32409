"""Make the small copy of a packed clip that the demo ships.

    python ship_demo.py PACKED OUT

The truth keeps three frames, which have neighbours on both sides. Keeps Z and the forward flow. Z stays float32 with 11 bits of mantissa (0.02 %), the flow is rounded to 1/64 px.
"""
import json
import os
import sys

import cv2
import numpy as np
import OpenEXR

try:
    import zopfli.png as zopfli            # pip install zopfli: 2 to 3 % smaller
except ImportError:
    zopfli = None


def read_exr(path):
    with OpenEXR.File(path, separate_channels=True) as f:
        return {k: np.asarray(v.pixels) for k, v in f.channels().items()}


def round_z(z, bits=11):
    """float32 with `bits` bits of mantissa, to nearest."""
    drop = 23 - bits
    i = z.astype(np.float32).view(np.uint32).astype(np.uint64)
    i = ((i + (1 << (drop - 1))) >> drop) << drop
    return np.where(z >= 1e10, np.float32(1e10), i.astype(np.uint32).view(np.float32))


def round_flow(u):
    return (np.round(u.astype(np.float32) * 64) / 64).astype(np.float16)


def write_exr(path, channels):
    OpenEXR.File({"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}, channels).write(path)


def geometry(d):
    return {"Z": round_z(d["Z"]), "forward.u": round_flow(d["forward.u"]), "forward.v": round_flow(d["forward.v"])}


def small_png(src, dst):
    """The same pixels, with whichever of the encoder's settings makes the smallest file."""
    x = cv2.imread(src, cv2.IMREAD_UNCHANGED)
    best = None
    flags = [getattr(cv2, "IMWRITE_PNG_FILTER", None), getattr(cv2, "IMWRITE_PNG_STRATEGY", None)]
    tries = [[cv2.IMWRITE_PNG_COMPRESSION, 9, flags[1], s] for s in (0, 1, 2, 3)]
    if flags[0] is not None:                                               # the filters by name came with OpenCV 4.12
        tries += [[cv2.IMWRITE_PNG_COMPRESSION, 9, flags[0], f] for f in (8, 16, 32, 64, 128, 248)]
    for t in tries:
        ok, e = cv2.imencode(".png", x, t)
        if ok and (best is None or len(e) < len(best)):
            best = e
    best = best.tobytes()
    if zopfli:
        best = min(best, zopfli.optimize(best), key=len)
    with open(dst, "wb") as f:
        f.write(best)
    assert (cv2.imread(dst, cv2.IMREAD_UNCHANGED) == x).all()


def main():
    packed, out = sys.argv[1:3]
    for name, cond, ext in (("frames", "full_without", ".png"), ("scene", "clean", ".exr"), ("without", "clean", ".png"),
                            ("with", "clean_with", ".png"), ("virtual", "virtual", ".exr"), ("truth_with", "full_with", ".png")):
        os.makedirs(os.path.join(out, name), exist_ok=True)
        for f in sorted(os.listdir(os.path.join(packed, cond))):
            src, dst = os.path.join(packed, cond, f), os.path.join(out, name, f)
            if not f.endswith(ext) or name == "truth_with" and f[:4] not in ("0002", "0003", "0004"):
                continue
            if ext == ".png":
                small_png(src, dst)
                continue
            d = read_exr(src)
            g = geometry(d)
            if name == "virtual":
                seen = d["A"] > 0                                          # nothing there: nothing to keep
                g = {k: np.where(seen, v, v.dtype.type(1e10) if k == "Z" else v.dtype.type(0)) for k, v in g.items()}
                g = {k: d[k] for k in "RGBA"} | g
            write_exr(dst, g)
    truth = json.load(open(os.path.join(packed, "truth.json")))
    t = truth["full_without"]
    demo = {k: t[k] for k in ("exposure", "lens", "noise", "fps", "width", "height")}
    json.dump({"demo": demo}, open(os.path.join(out, "truth.json"), "w"), indent=1)


if __name__ == "__main__":
    main()
