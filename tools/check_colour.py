#!/usr/bin/env python3
"""Compares what blindaug makes of files of every colour space, kind and bit depth with OpenColorIO's numbers, and prints a table.

    tools/check_colour.py BLINDAUG      # the program; half a minute

Frames go through `blindaug apply` with a camera that distorts nothing, from one colour space to another. OpenColorIO converts the values that
are in the file; what is left is the rounding of both files. Needs pip install opencolorio openexr opencv-python-headless, and ffmpeg.
"""

import json
import pathlib
import subprocess
import sys
import tempfile

import cv2
import numpy as np
import OpenEXR
import PyOpenColorIO as ocio

from colour_reference import CURVES, SPACES

blindaug = sys.argv[1]
config = ocio.Config.CreateFromBuiltinConfig("studio-config-latest")
SIZE = (72, 128)
CAMERA = {
    "format": "blindaug-camera",
    "version": 1,
    "capture": {"width": SIZE[1], "height": SIZE[0], "frames_used": 1},
    "noise": {"unknown": "left out"},
    "motion_blur": {"unknown": "left out"},
    "defocus": {"unknown": "left out"},
}
TRANSFERS = {
    "srgb": "srgb", "display-p3": "srgb", "linear-srgb": "srgb", "acescg": "srgb", "aces2065-1": "srgb", "rec709": "bt1886",
    "s-log3": "s_log3", "s-log3-cine": "s_log3", "logc3": "log_c3", "logc4": "log_c4", "v-log": "v_log", "log3g10": "log3_g10",
    "canon-log3": "canon_log3", "pq": "pq", "hlg": "hlg",
}  # fmt: skip
LINEAR = ("linear-srgb", "acescg", "aces2065-1")


def processors(space):
    """OpenColorIO's conversions from a space to ACES2065-1, in order."""
    if space in SPACES:
        return [config.getProcessor(SPACES[space], "ACES2065-1")]
    return [config.getProcessor(ocio.BuiltinTransform(CURVES[space])), config.getProcessor("Linear Rec.2020", "ACES2065-1")]


def to_aces(values, space):
    values = np.ascontiguousarray(values, dtype=np.float32)
    for processor in processors(space):
        processor.getDefaultCPUProcessor().applyRGB(values)
    return values


def write(path, values, bits):
    if path.suffix == ".exr":
        kind = np.float16 if bits == 16 else np.float32
        channels = {c: np.ascontiguousarray(values[..., i].astype(kind)) for i, c in enumerate("RGB")}
        OpenEXR.File({"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}, channels).write(str(path))
    else:
        whole = np.round(np.clip(values, 0, 1) * (2**bits - 1)).astype(np.uint8 if bits == 8 else np.uint16)
        cv2.imwrite(str(path), whole[..., ::-1])


def read(path):
    if path.suffix == ".exr":
        with OpenEXR.File(str(path), separate_channels=True) as file:
            channels = file.channels()
            return np.stack([channels[c].pixels.astype(np.float32) for c in "RGB"], axis=-1)
    whole = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)[..., ::-1]
    return whole.astype(np.float32) / np.iinfo(whole.dtype).max


def colours(space):
    """A ramp of grey beside colours that are not too saturated for any space, as values of the space."""
    y, x = np.indices(SIZE)
    level = 0.12 + 0.7 * x / SIZE[1]
    # No colour may lie outside of the smallest space, in which it would be cut off.
    tint = (0.01 if space in LINEAR else 0.04) * np.stack([np.sin(y / 7.0), np.sin(y / 7.0 + 2), np.sin(y / 7.0 + 4)], axis=-1)
    values = level[..., None] + tint
    return values**2.2 if space in LINEAR else values


def video(path, values, words):
    raw = np.round(np.clip(values, 0, 1) * 65535).astype("<u2").tobytes()
    subprocess.run(
        ["ffmpeg", "-v", "error", "-y", "-f", "rawvideo", "-pix_fmt", "rgb48le", "-s", f"{SIZE[1]}x{SIZE[0]}", "-i", "-", *words.split(), str(path)],
        input=raw, check=True,
    )  # fmt: skip


# The file, its space, what is said of it, the file that is made, its space, and the tolerance: steps of the coarser file in its own values.
VIDEO = "-vf scale=out_color_matrix={m}:out_range=tv -colorspace {m} -color_primaries {p} -color_trc {t} -pix_fmt yuv444p10le -c:v libx265 -x265-params lossless=1:log-level=error"
CASES = [
    *[("png", 16, s, True, "exr", 32, "aces2065-1") for s in SPACES if s not in LINEAR],
    *[("tif", 16, s, True, "exr", 32, "aces2065-1") for s in CURVES],
    *[("exr", 32, s, True, "png", 16, "srgb") for s in LINEAR],
    *[("exr", 32, "acescg", True, "png", 16, s) for s in ("s-log3", "logc3", "logc4", "v-log", "log3g10", "canon-log3", "display-p3", "rec709")],
    ("png", 8, "srgb", False, "exr", 16, "acescg"),
    ("exr", 16, "linear-srgb", False, "exr", 16, "linear-srgb"),
    ("mp4", 10, "pq", False, "exr", 32, "aces2065-1"),
    ("mp4", 10, "hlg", False, "exr", 32, "aces2065-1"),
]
failed = False
print("| in | colour space | out | colour space | largest error | of |\n|---|---|---|---|---|---|")
with tempfile.TemporaryDirectory() as folder:
    folder = pathlib.Path(folder)
    for i, (kind, bits, space, said, out_kind, out_bits, out_space) in enumerate(CASES):
        values = colours(space)
        source, made, camera = folder / f"{i}.{kind}", folder / f"{i}-out.{out_kind}", folder / "camera.json"
        camera.write_text(json.dumps({**CAMERA, "transfer": TRANSFERS[space]}))
        if kind == "mp4":
            video(source, values, VIDEO.format(m="bt2020nc", p="bt2020", t={"pq": "smpte2084", "hlg": "arib-std-b67"}[space]))
        else:
            write(source, values, bits)
            values = read(source)
        words = [blindaug, "apply", source, "--camera", camera, "-o", made, "--bits", out_bits, "--output-colour-space", out_space]
        words += ["--colour-space", space] if said else []
        words += ["--frames", "1..1"] if kind == "mp4" else []
        done = subprocess.run([str(w) for w in words], capture_output=True, text=True)
        if done.returncode:
            sys.exit(f"{kind} {space}: {done.stderr}")
        # Both are brought to ACES2065-1 by OpenColorIO; the error is relative to the colour's brightest channel.
        want, got = to_aces(values.copy(), space), to_aces(read(made), out_space)
        brightest = np.maximum(np.abs(want).max(axis=-1, keepdims=True), 0.01)
        error = np.max(np.abs(got - want) / brightest)
        # A step of the coarser file is this share of a value in the middle; codes of ten bits in YCbCr lose one more.
        step = max({8: 2.0**-8, 10: 2.0**-8, 16: 2.0**-13, 32: 2.0**-13}[b] for b in (bits, out_bits))
        tolerance = 12 * step if space not in LINEAR or out_space not in LINEAR else 2.0**-10
        failed |= not error <= tolerance
        print(f"| {kind.upper()} {bits} bit{'' if said else ', as it says'} | {space} | {out_kind.upper()} {out_bits} bit | {out_space} | {error:.5f} | {tolerance:.5f} |")
        if i == 0:
            # Negative control: another space's numbers are far away.
            assert np.max(np.abs(got - to_aces(values, "logc3")) / brightest) > 0.2
if failed:
    sys.exit("an error is larger than the files' rounding")
