"""A camera's numbers for the panel."""

from typing import NamedTuple


class Row(NamedTuple):
    """A number with its 95 % interval, or a part that is unknown and why."""

    name: str
    value: str | None
    interval: str
    why: str


def number(v):
    return f"{v:.3g}"


def interval(bounds, unit=""):
    return f"{number(bounds[0])} to {number(bounds[1])}{unit}" if bounds else ""


def inverse(bounds):
    """The interval of a distance from that of its inverse, whose low end may be 0 or less: infinity."""
    low, high = bounds
    far = f"{number(1.0 / low)} m" if low > 0.0 else "infinity"
    near = number(1.0 / high) if high > 0.0 else "infinity"
    return f"{near} to {far}"


def rows(camera):
    """What is known of a camera, and what is not."""
    found = []

    def known(name, value, bounds=""):
        found.append(Row(name, value, bounds, ""))

    exposure, lens, noise, sharpening = camera.exposure, camera.defocus, camera.noise, camera.sharpening
    if exposure.known:
        known("Exposure", f"{number(exposure.value)} ({exposure.shutter_angle:.0f}°)", interval(exposure.interval))
    else:
        fits = f"; {interval(exposure.fits)} fits" if exposure.fits else ""
        found.append(Row("Exposure", None, "", exposure.reason + fits))
    if lens.known:
        sigma = lens.sigma_px_at_infinity
        if sigma is not None:
            known("Blur at infinity", f"{number(sigma)} px", interval(lens.sigma_px_at_infinity_interval, " px"))
        d, bounds = lens.focus_inverse_depth, lens.focus_inverse_depth_interval
        outside = f", {lens.focus_outside} than what is seen" if lens.focus_outside else ""
        if d is None:
            known("Focus", "nowhere: sharp or evenly blurred")
        elif lens.focus_m is not None:
            known("Focus", f"{number(lens.focus_m)} m{outside}", inverse(bounds) if bounds else "")
        elif lens.depth_kind == "metric":
            known("Focus", f"at infinity{outside}", inverse(bounds) if bounds else "")
        else:
            known("Focus", f"{number(d)} of relative 1/depth{outside}", interval(bounds))
    else:
        found.append(Row("Lens", None, "", lens.reason))
    if noise.known:
        middle = camera.facts()["noise"]["std_of_encoded_rgb"][1]
        for c, channel in enumerate("RGB"):
            # Noise that was given has no interval.
            bounds = middle["interval"] and [255.0 * v for v in middle["interval"][c]]
            known(f"Noise at {middle['luminance']:g}, {channel}", f"{number(255.0 * middle['std'][c])} /255", interval(bounds))
    else:
        found.append(Row("Noise", None, "", noise.reason))
    if sharpening.known and sharpening.value:
        known("Sharpening", number(sharpening.value), interval(sharpening.interval))
    return found
