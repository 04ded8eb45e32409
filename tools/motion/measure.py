"""What `blindaug estimate` tells of clips whose exposure is known, for the other programs here."""
import json, os, subprocess, tempfile
import numpy as np


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
