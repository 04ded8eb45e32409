#!/usr/bin/env bash
# Encodes flat patches with the exported film grain table and compares the decoded grain with the camera's model.
#
# Needs aomenc and aomdec (aom-tools), dav1d and python3; BLINDAUG is the binary to check, built here where it is not set.
# The model is read from the texture target, so that nothing of the table's own arithmetic is on both sides.
# Run with aomenc and aomdec 3.6.0, dav1d 1.0.0, Python 3.11 (Debian 12). SVT-AV1 1.4.1 there has no --fgs-table yet.
set -euo pipefail
cd "$(dirname "$0")/.."

source tools/common.sh
need aom-tools aomenc
need dav1d dav1d
dir=$(mktemp -d)
trap 'rm -rf "$dir"' EXIT

cat >"$dir/grain.py" <<'PY'
"""cameras DIR | clip FILE | compare NAME DIR GRAINY CLEAN: 3 where the grain is not the model's."""
import json
import struct
import sys
import zlib
from math import sqrt

W, H, FRAMES, BAND = 352, 288, 40, 32
# The luma of each band of the clip, code values; a band has the grain's block height. The last two are above the level at which the strong
# camera clips.
LUMAS = [28, 60, 84, 108, 132, 156, 176, 204, 220]
# The relative tolerance of a std: rounding to 8 bits adds a variance of 1/12, which makes a std of 0.7 8 % larger.
TOLERANCE = 0.15
# The tolerance of a correlation: the autoregression has 24 taps.
LAG_TOLERANCE = 0.1


def camera(levels, clip, width, height):
    levels = [{"slope": s, "intercept": i} for s, i in levels]
    return {
        "format": "blindaug-camera", "version": 1,
        "capture": {"width": width, "height": height, "fps": 30.0, "frames_used": 5},
        "transfer": "srgb",
        "noise": {"levels": levels, "clip": clip, "method": "given", "samples": 0},
        "motion_blur": {"exposure": 0.5, "interval": [0.5, 0.5], "method": "given", "samples": 0},
        "defocus": {
            "model": "thin_lens", "sigma_px_at_infinity": 2.0, "focus_inverse_depth": 0.4,
            "depth_kind": "metric", "method": "given", "samples": 0,
        },
    }


def cameras(folder):
    sample = [
        ([0.012, 0.010, 0.018], [0.010, 0.008, 0.014]), ([0.008, 0.007, 0.013], [0.007, 0.006, 0.010]),
        ([0.004, 0.003, 0.006], [0.003, 0.003, 0.005]), ([0.002, 0.0015, 0.003], [0.0015, 0.0015, 0.002]),
    ]
    # The std of each pyramid level of white noise of std 1.
    white = [0.943, 0.230, 0.1005, 0.0488]
    weak = [([0.0] * 3, [0.01 * s] * 3) for s in white]
    coarse = [([0.03 * s] * 3, [0.025 * s] * 3) for s in (1.0, 0.9, 0.6, 0.3)]
    for name, levels, clip, w, h in (
        ("sample", sample, 1.0, 512, 384), ("weak_white", weak, 1.0, 640, 480),
        ("strong_coarse", coarse, 0.85, 1920, 1080),
    ):
        double = [([2 * v for v in s], [2 * v for v in i]) for s, i in levels]
        for suffix, l in (("", levels), ("_twice", double)):
            with open(f"{folder}/{name}{suffix}.json", "w") as f:
                json.dump(camera(l, clip, w, h), f)


def clip(path):
    frame = b"".join(bytes([v]) * (W * BAND) for v in LUMAS) + bytes([128]) * (W * H // 2)
    with open(path, "wb") as f:
        f.write(b"YUV4MPEG2 W%d H%d F25:1 Ip A1:1 C420jpeg XCOLORRANGE=LIMITED\n" % (W, H))
        f.write((b"FRAME\n" + frame) * FRAMES)


def planes(path):
    """Y, Cb, Cr of each frame as rows."""
    data = open(path, "rb").read()
    size = W * H * 3 // 2
    assert len(data) == size * FRAMES, f"{path}: {len(data)} bytes"
    out = []
    for at in range(0, len(data), size):
        frame = []
        for w, h in ((W, H), (W // 2, H // 2), (W // 2, H // 2)):
            frame.append([data[at + w * y : at + w * (y + 1)] for y in range(h)])
            at += w * h
        out.append(frame)
    return out


def weights(height):
    """The weights of R, G, B in Y, Cb, Cr: BT.709 from 720 lines on, else BT.601."""
    r, b = (0.2126, 0.0722) if height >= 720 else (0.299, 0.114)
    y = [r, 1 - r - b, b]
    return [y] + [[((i == c) - y[i]) / (2 * (1 - y[c])) for i in range(3)] for c in (2, 0)]


def table(path):
    """The rows of a grain table: luminance, and std of R, G and B."""
    lines = [line for line in open(path) if not line.startswith("#")][1:]
    return [[float(v) for v in line.split(",")[:4]] for line in lines]


def std_at(rows, y):
    for a, b in zip(rows, rows[1:]):
        if y <= b[0]:
            t = (y - a[0]) / (b[0] - a[0])
            return [p + t * (q - p) for p, q in zip(a[1:], b[1:])]
    return rows[-1][1:]


def tile(path):
    """The model's noise at luminance 0.5, R, G, B with std 1 each, from an 8-bit RGBA PNG."""
    data, at, parts = open(path, "rb").read(), 8, []
    while at < len(data):
        length, kind = struct.unpack(">I4s", data[at : at + 8])
        body = data[at + 8 : at + 8 + length]
        if kind == b"IHDR":
            w, h, depth, colour = struct.unpack(">IIBB", body[:10])
            assert (depth, colour) == (8, 6)
        parts += [body] if kind == b"IDAT" else []
        at += 12 + length
    raw, above, rows = zlib.decompress(b"".join(parts)), bytearray(4 * w), []
    for y in range(h):
        kind, line = raw[y * (4 * w + 1)], bytearray(raw[y * (4 * w + 1) + 1 : (y + 1) * (4 * w + 1)])
        for i in range(4 * w if kind else 0):
            a, b, c = (line[i - 4] if i >= 4 else 0), above[i], (above[i - 4] if i >= 4 else 0)
            if kind == 4:
                p = a + b - c
                near = min((abs(p - a), 0, a), (abs(p - b), 1, b), (abs(p - c), 2, c))[2]
            else:
                near = (0, a, b, (a + b) // 2)[kind]
            line[i] = (line[i] + near) & 255
        rows.append([[(v - 127.5) * 8 / 255 for v in line[4 * x : 4 * x + 3]] for x in range(w)])
        above = line
    return rows


def halved(p):
    return [
        [(p[y][x] + p[y][x + 1] + p[y + 1][x] + p[y + 1][x + 1]) / 4 for x in range(0, len(p[0]), 2)]
        for y in range(0, len(p), 2)
    ]


def rms(rows):
    return sqrt(sum(v * v for r in rows for v in r) / sum(len(r) for r in rows))


def product(pairs):
    """Mean products of rows, each pair of the same length."""
    total = count = 0
    for a, b in pairs:
        total += sum(map(int.__mul__, a, b)) if isinstance(a[0], int) else sum(p * q for p, q in zip(a, b))
        count += len(a)
    return total / count


LAGS = [(1, 0), (0, 1), (1, 1), (2, 0)]


def correlations(fields):
    """The correlations at LAGS, over several fields of rows."""
    power = product((r, r) for f in fields for r in f)
    out = []
    for dx, dy in LAGS:
        pairs = ((a[: len(a) - dx], b[dx:]) for f in fields for a, b in zip(f, f[dy:]))
        out.append(product(pairs) / power if power else 0.0)
    return out


def compare(name, folder, grainy, clean):
    spec = json.load(open(f"{folder}/{name}.json"))
    matrix = weights(spec["capture"]["height"])
    rows = table(f"{folder}/{name}.d/blindaug_grain.csv")
    noise = tile(f"{folder}/{name}.d/blindaug_grain.png")
    middle = std_at(rows, 0.5)
    mixed = [[[sum(m[c] * middle[c] * p[c] for c in range(3)) for p in r] for r in noise] for m in matrix]
    model = [mixed[0]] + [halved(p) for p in mixed[1:]]
    # The share of chroma's std that is left in means of 2 x 2 px.
    kept = [1.0] + [rms(model[p]) / rms(mixed[p]) for p in (1, 2)]

    with_grain, without = planes(grainy), planes(clean)
    for y in (0, BAND):
        assert without[0][0][y][0] == LUMAS[y // BAND], "the clip itself has changed in encoding"
    failed, checked, seen = [], 0, []
    print(f"{name}: std in code values: wanted, decoded, ratio")
    print(("  luma" + "".join(f"{p:>10}" + " " * 19 for p in ("Y", "Cb", "Cr"))).rstrip())
    for band, luma in enumerate(LUMAS):
        y = (luma - 16) / 219
        rgb = std_at(rows, y) if y < spec["noise"]["clip"] else [0.0] * 3
        line, fields = f"  {luma:4}", []
        for p in range(3):
            scale, size = (219, BAND) if p == 0 else (224, BAND // 2)
            wanted = scale * kept[p] * sqrt(sum((w * s) ** 2 for w, s in zip(matrix[p], rgb)))
            field = [
                [[a - b for a, b in zip(g[p][r], n[p][r])] for r in range(band * size, (band + 1) * size)]
                for g, n in zip(with_grain, without)
            ]
            fields.append(field)
            values = [v for f in field for r in f for v in r]
            mean = sum(values) / len(values)
            decoded = sqrt(max(sum(v * v for v in values) / len(values) - mean * mean, 0.0))
            if wanted == 0:
                fits, ratio = decoded == 0, "      "
            else:
                fits, ratio = abs(decoded / wanted - 1) <= TOLERANCE, f"{decoded / wanted:6.3f}"
            # Where the range of values ends within 3 std, grain is cut off, as noise would be; the model's std does not show that.
            cut = p == 0 and 3 * wanted > min(luma - 16, 235 - luma)
            checked += not cut
            if not fits and not cut:
                failed.append(f"{('Y', 'Cb', 'Cr')[p]} at luma {luma}")
            line += f"{wanted:10.2f} {decoded:7.2f} {ratio}" + (" cut" if cut else "    " if fits else " BAD")
        print(line.rstrip())
        if luma == 132:
            seen = fields
    assert checked >= 18, "too few patches"
    frames = [f[0] for f in seen]
    if frames[0][0] == frames[1][0]:
        failed.append("grain that is the same in every frame")
    print("  correlation at lag" + "".join(f"{str(l):>16}" for l in LAGS))
    for p in range(3):
        pairs = list(zip(correlations([model[p]]), correlations(seen[p])))
        print(f"  {('Y', 'Cb', 'Cr')[p]:18}" + "".join(f"{a:9.2f} {b:6.2f}" for a, b in pairs))
        if any(abs(a - b) > LAG_TOLERANCE for a, b in pairs):
            failed.append(f"{('Y', 'Cb', 'Cr')[p]}'s correlations")
    # The correlation of chroma with luma in the same place.
    small = [halved(f) for f in seen[0]]
    for p in (1, 2):
        a = halved(mixed[0])
        wanted = product(zip(a, model[p])) / rms(a) / rms(model[p])
        flat = [[float(v) for v in r] for f in seen[p] for r in f]
        luma_rows = [r for f in small for r in f]
        power = rms(flat) * rms(luma_rows)
        decoded = product(zip(luma_rows, flat)) / power if power else 0.0
        print(f"  {('Y', 'Cb', 'Cr')[p]} with Y in place{wanted:13.2f} {decoded:6.2f}")
        if abs(wanted - decoded) > LAG_TOLERANCE:
            failed.append(f"{('Y', 'Cb', 'Cr')[p]}'s correlation with Y")
    if failed:
        print("  does not agree: " + ", ".join(failed))
        sys.exit(3)


{"cameras": cameras, "clip": clip, "compare": compare}[sys.argv[1]](*sys.argv[2:])
PY

# Exports a camera to a target; the notes are shown only if the export fails.
export_to() {
    timeout 60 "$BLINDAUG" export "$dir/$1.json" --to "$2" -o "$3" 2>"$dir/log" || {
        cat "$dir/log" >&2
        return 1
    }
}

# Encodes the clip with a camera's table, and decodes it to NAME_grain.yuv and NAME_clean.yuv.
decode() {
    local name=$1
    export_to "$name" av1-grain "$dir/$name.tbl"
    timeout 300 aomenc "$dir/clip.y4m" -o "$dir/$name.ivf" --ivf --film-grain-table="$dir/$name.tbl" --passes=1 \
        --lag-in-frames=0 --cpu-used=6 --end-usage=q --cq-level=4 --threads=2 >"$dir/log" 2>&1 || {
        cat "$dir/log" >&2
        return 1
    }
    timeout 60 dav1d -q -i "$dir/$name.ivf" --filmgrain 1 -o "$dir/${name}_grain.yuv"
    timeout 60 dav1d -q -i "$dir/$name.ivf" --filmgrain 0 -o "$dir/${name}_clean.yuv"
    # The other decoder must give the same bytes.
    timeout 60 aomdec "$dir/$name.ivf" --rawvideo -o "$dir/other.yuv"
    cmp "$dir/${name}_grain.yuv" "$dir/other.yuv"
}

python3 "$dir/grain.py" cameras "$dir"
python3 "$dir/grain.py" clip "$dir/clip.y4m"
status=0
for name in sample weak_white strong_coarse; do
    mkdir "$dir/$name.d"
    export_to "$name" texture "$dir/$name.d"
    decode "$name"
    python3 "$dir/grain.py" compare "$name" "$dir" "$dir/${name}_grain.yuv" "$dir/${name}_clean.yuv" || status=1
    # A table for twice the noise, and no grain at all, must not be taken for this camera's grain.
    decode "${name}_twice"
    for other in "${name}_twice_grain" "${name}_clean"; do
        code=0
        python3 "$dir/grain.py" compare "$name" "$dir" "$dir/$other.yuv" "$dir/${name}_clean.yuv" >"$dir/log" || code=$?
        if ((code != 3)) || ! grep -q "does not agree: .*Y at luma" "$dir/log"; then
            echo "$other was taken for the grain of $name"
            cat "$dir/log"
            status=1
        fi
    done
done
((status == 0)) && echo "film grain tables: the decoded grain is the model's"
exit "$status"
