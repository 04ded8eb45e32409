"""Compares a blind estimate with the camera that was exported: python compare.py CAMERA ESTIMATE TRUTH_FACTS FOUND_FACTS

The last two are what `blindaug inspect --json` says of the first two.
"""
import json
import sys

NOISE_TOLERANCE = 0.15


def read(path):
    with open(path) as file:
        return json.load(file)


def rows(truth, estimate, truth_facts, found_facts):
    """(what, true, estimated, low, high) of each number."""
    found = estimate["motion_blur"]
    yield "exposure", truth["motion_blur"]["exposure"], found.get("exposure"), *found.get("interval", [None, None])
    found = estimate["defocus"]
    for name in ("sigma_px_at_infinity", "focus_inverse_depth"):
        interval = found.get("interval", {}).get(name, [None, None])
        yield name, truth["defocus"][name], found.get(name), *interval
    stds = [facts["noise"].get("std_of_encoded_rgb", []) for facts in (truth_facts, found_facts)]
    for true, got in zip(*stds):
        for channel, t, g in zip("RGB", true["std"], got["std"]):
            low, high = t * (1 - NOISE_TOLERANCE), t * (1 + NOISE_TOLERANCE)
            yield f"noise std {channel} at luminance {true['luminance']:.1f}", t, g, low, high


def main(*paths):
    truth, estimate, truth_facts, found_facts = map(read, paths)
    failed = []
    seen = 0
    print(f"{'':36}{'exported':>10}{'estimated':>11}   95 % interval (noise: within 15 %)")
    for what, true, got, low, high in rows(truth, estimate, truth_facts, found_facts):
        seen += 1
        noise = what.startswith("noise")
        holds = got is not None and low <= (got if noise else true) <= high
        interval = "unknown" if got is None else f"{low:.4f} to {high:.4f}"
        print(f"{what:36}{true:10.4f}{got or 0.0:11.4f}   {interval}{'' if holds else '   <- not within'}")
        failed += [] if holds else [what]
    # A camera with other parameters must be told from this one.
    other = json.loads(json.dumps(truth))
    other["motion_blur"]["exposure"] *= 1.6
    other["defocus"]["sigma_px_at_infinity"] *= 1.6
    told = [w for w, true, got, low, high in rows(other, estimate, truth_facts, found_facts) if got and not low <= true <= high]
    if not {"exposure", "sigma_px_at_infinity"} <= set(told):
        failed.append("a camera with 1.6 times the blur, which is not told from this one")
    if failed or seen < 6:
        sys.exit(f"the loop does not close: {', '.join(failed) or 'too little was estimated'}")
    print("the loop closes")


if __name__ == "__main__":
    main(*sys.argv[1:])
