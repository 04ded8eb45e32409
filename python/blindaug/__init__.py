"""Estimates a camera's noise, motion blur and defocus from any video, and gives virtual content the same.

    import blindaug as ba

    cam = ba.estimate("shot.mp4")
    cam.exposure.value, cam.exposure.interval
    out = ba.composite(frame, layer, cam.to_metric(at=[(640, 360, 2.5)]), layer_depth=z, layer_motion=uv)

Everything is computed by the same code as in the command line ``blindaug``, with the same results, bit by bit. Frames are arrays
(H, W, 3) of uint8, uint16 or floats; what is unknown says why (``cam.exposure.reason``).
"""

from ._blindaug import (
    COLOUR_SPACES,
    EXPORT_TARGETS,
    Camera,
    Defocus,
    Error,
    Export,
    Exposure,
    FileError,
    Noise,
    Sharpening,
    Track,
    Tracker,
    UnknownError,
    __version__,
    apply,
    composite,
    estimate,
    read_track,
    set_memory_budget,
    track,
    write_track,
)

__all__ = [
    "COLOUR_SPACES",
    "EXPORT_TARGETS",
    "Camera",
    "Defocus",
    "Error",
    "Export",
    "Exposure",
    "FileError",
    "Noise",
    "Sharpening",
    "Track",
    "Tracker",
    "UnknownError",
    "__version__",
    "apply",
    "composite",
    "estimate",
    "read_track",
    "set_memory_budget",
    "track",
    "write_track",
]
