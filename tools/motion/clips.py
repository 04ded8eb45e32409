"""Clips whose exposure is known, and what `blindaug estimate` tells of them, for the other programs here."""
import json, os, subprocess, tempfile
import numpy as np


def light_of_srgb(values):
    """Light of encoded values in [0, 1]."""
    return np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)


def srgb_of_light(light):
    """Encoded values of light, which is not negative."""
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)


def write(path, frames, pixels, fps, coder):
    """Writes frames, of a height, a width and three channels in ffmpeg's format `pixels`, as a video or as images, by these options of ffmpeg."""
    frames = list(frames)
    height, width = frames[0].shape[:2]
    os.makedirs(os.path.dirname(path), exist_ok=True)
    subprocess.run(["ffmpeg", "-v", "error", "-y", "-f", "rawvideo", "-pix_fmt", pixels, "-s", f"{width}x{height}", "-r", str(fps), "-i", "-", *coder, path],
                   input=b"".join(frame.tobytes() for frame in frames), check=True)


def write_truth(out, truth):
    with open(os.path.join(out, "truth.json"), "w") as file:
        json.dump(truth, file, indent=1)


def read_truth(out):
    return json.load(open(os.path.join(out, "truth.json")))


def measure(blindaug, kind, clips, *options, step=0.0):
    """Prints a line for each clip, and how many exposures are known, how many 95 % intervals hold the truth, the mean error, and of how many clips it is
    said that they were, or may have been, compressed. `clips` holds (name, path, true exposure); an exposure is true within half a `step`."""
    errors, covered, compressed = [], 0, 0
    for name, path, exposure in clips:
        with tempfile.TemporaryDirectory() as folder:
            camera = os.path.join(folder, "camera.json")
            subprocess.run([blindaug, "estimate", path, *options, "-o", camera], check=True, capture_output=True)
            found = json.load(open(camera))
        compressed += any("compressed" in warning for warning in found.get("warnings", []))
        motion = found["motion_blur"]
        if "exposure" not in motion:
            print(f"{name}, {kind}: {exposure:.2f}, unknown")
            continue
        low, high = motion["interval"][0] - step / 2, motion["interval"][1] + step / 2
        errors.append(abs(motion["exposure"] - exposure))
        covered += low <= exposure <= high
        print(f"{name}, {kind}: {exposure:.2f}, found {motion['exposure']:.2f} ({low:.2f} to {high:.2f})", flush=True)
    mean = np.mean(errors) if errors else float("nan")
    print(f"{kind}: {len(errors)} of {len(clips)} are known, {covered} are covered; mean error {mean:.3f}; compressed: {compressed}")
