#!/usr/bin/env python3
"""Writes ICC profiles into crates/blindaug-io/tests/icc/, and reference.csv beside them: colours of 8 bits and what they are in sRGB, by littlecms.

The profiles are made here from the numbers of the standards, but for srgb.icc, which is littlecms' own. The numbers in reference.csv are those of
littlecms (relative colorimetric), not of blindaug. Profiles that blindaug refuses are made as well.
Needs: pip install pillow numpy (13.0.0, with littlecms 2.19, was used).
"""

import io
import pathlib
import struct

import numpy as np
from PIL import Image, ImageCms

D50 = np.array([0.9642, 1.0, 0.8249])
D65 = (0.3127, 0.329)
BRADFORD = np.array([[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]])
P3 = [(0.68, 0.32), (0.265, 0.69), (0.15, 0.06)]
REC709 = [(0.64, 0.33), (0.3, 0.6), (0.15, 0.06)]
ADOBE = [(0.64, 0.33), (0.21, 0.71), (0.15, 0.06)]
ROMM = [(0.7347, 0.2653), (0.1596, 0.8404), (0.0366, 0.0001)]
OWN = [(0.66, 0.33), (0.25, 0.66), (0.14, 0.07)]
COLOURS = [(96, 128, 112), (128, 128, 128), (180, 150, 120), (60, 80, 140), (200, 210, 190), (40, 30, 35), (230, 180, 190)]


def xyz(xy):
    return np.array([xy[0] / xy[1], 1.0, (1 - xy[0] - xy[1]) / xy[1]])


def colorants(primaries, white):
    """XYZ of red, green and blue (columns), adapted to D50, and the matrix of the adaptation."""
    columns = np.stack([xyz(p) for p in primaries], axis=1)
    native = columns * np.linalg.solve(columns, xyz(white))
    to_d50 = np.linalg.inv(BRADFORD) @ np.diag((BRADFORD @ D50) / (BRADFORD @ xyz(white))) @ BRADFORD
    return to_d50 @ native, to_d50


def fixed(values):
    return b"".join(struct.pack(">i", round(v * 65536)) for v in np.ravel(values))


def xyz_tag(v):
    return b"XYZ \0\0\0\0" + fixed(v)


def curve(values):
    """A table; of one value the power in 1/256; of none light itself."""
    return b"curv\0\0\0\0" + struct.pack(">I", len(values)) + b"".join(struct.pack(">H", v) for v in values)


def parametric(kind, *numbers):
    return b"para\0\0\0\0" + struct.pack(">HH", kind, 0) + fixed(numbers)


def text(name, version):
    if version < 4:
        ascii_name = name.encode() + b"\0"
        return b"desc\0\0\0\0" + struct.pack(">I", len(ascii_name)) + ascii_name + bytes(4 + 4 + 2 + 1 + 67)
    utf16 = name.encode("utf-16-be")
    return b"mluc\0\0\0\0" + struct.pack(">II2s2sII", 1, 12, b"en", b"US", len(utf16), 28) + utf16


def profile(name, version, tags, space=b"RGB ", kind=b"mntr"):
    tags = {b"desc": text(name, version), b"wtpt": xyz_tag(D50), **tags}
    data, entries, at = b"", b"", 128 + 4 + 12 * len(tags)
    for key, value in tags.items():
        entries += key + struct.pack(">II", at + len(data), len(value))
        data += value + bytes(-len(value) % 4)
    size = at + len(data)
    head = struct.pack(">I4sI4s4s4s6H4s4sI4sIQI", size, b"\0" * 4, version << 24, kind, space, b"XYZ ", 2026, 1, 1, 0, 0, 0,
                       b"acsp", b"\0" * 4, 0, b"\0" * 4, 0, 0, 1) + fixed(D50)
    head += bytes(128 - len(head))
    return head + struct.pack(">I", len(tags)) + entries + data


def matrix_profile(name, version, primaries, white, trc):
    rgb, to_d50 = colorants(primaries, white)
    tags = {key: xyz_tag(rgb[:, i]) for i, key in enumerate([b"rXYZ", b"gXYZ", b"bXYZ"])}
    tags |= {key: trc for key in [b"rTRC", b"gTRC", b"bTRC"]}
    if version >= 4:
        tags[b"chad"] = b"sf32\0\0\0\0" + fixed(to_d50)
    return profile(name, version, tags)


def srgb_light(v):
    return v / 12.92 if v <= 0.04045 else ((v + 0.055) / 1.055) ** 2.4


def table_profile():
    """An RGB profile whose colours are found in a table of 2 x 2 x 2 (lut8Type)."""
    grid = b"".join(bytes([255 * r, 255 * g, 255 * b]) for r in range(2) for g in range(2) for b in range(2))
    lut = b"mft1\0\0\0\0" + bytes([3, 3, 2, 0]) + fixed(np.eye(3)) + bytes(range(256)) * 3 + grid + bytes(range(256)) * 3
    return profile("A table", 2, {b"A2B0": lut}, kind=b"scnr")


def main():
    srgb_curve = parametric(3, 2.4, 1 / 1.055, 0.055 / 1.055, 1 / 12.92, 0.04045)
    table = curve([round(65535 * srgb_light(i / 1023)) for i in range(1024)])
    known = {
        "srgb": ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes(),
        "srgb-table": matrix_profile("sRGB by a table", 2, REC709, D65, table),
        "display-p3": matrix_profile("Display P3", 4, P3, D65, srgb_curve),
        "adobe-rgb": matrix_profile("Adobe RGB (1998)", 2, ADOBE, D65, curve([563])),
        "prophoto": matrix_profile("ProPhoto RGB", 2, ROMM, (0.3457, 0.3585), curve([461])),
        "linear": matrix_profile("Linear Rec. 709", 4, REC709, D65, parametric(0, 1.0)),
        "own": matrix_profile("Primaries of its own", 2, OWN, D65, curve([614])),
    }
    refused = {
        "gamma-1.4": matrix_profile("A power of 1.4", 2, REC709, D65, curve([358])),
        "table": table_profile(),
        "cmyk": profile("Inks", 2, {}, space=b"CMYK", kind=b"prtr"),
    }
    folder = pathlib.Path(__file__).parent.parent / "crates/blindaug-io/tests/icc"
    folder.mkdir(exist_ok=True)
    to = ImageCms.createProfile("sRGB")
    picture = Image.fromarray(np.array([COLOURS], dtype=np.uint8))
    lines = ["profile,r,g,b,srgb_r,srgb_g,srgb_b"]
    for name, data in known.items():
        (folder / f"{name}.icc").write_bytes(data)
        of = ImageCms.ImageCmsProfile(io.BytesIO(data))
        made = ImageCms.profileToProfile(picture, of, to, ImageCms.Intent.RELATIVE_COLORIMETRIC, flags=0)
        for before, after in zip(COLOURS, np.asarray(made)[0].tolist()):
            lines.append(",".join([name, *map(str, (*before, *after))]))
    for name, data in refused.items():
        (folder / f"{name}.icc").write_bytes(data)
    (folder / "reference.csv").write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
