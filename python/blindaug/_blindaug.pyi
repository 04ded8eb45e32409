"""The compiled part of the package: what `blindaug` exports."""

import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, Literal, TypeAlias, TypedDict, final, overload

import numpy as np
import numpy.typing as npt

_Path: TypeAlias = str | os.PathLike[str]
_Array: TypeAlias = npt.NDArray[Any]
_Interval: TypeAlias = tuple[float, float]
# Frames: a file or folder, an array (T, H, W, 3), or frames (H, W, 3) one after another.
_Footage: TypeAlias = _Path | _Array | Iterable[_Array]
# What belongs to frames: a file or folder, an array for all frames or with the frames first, or an array or None for each frame.
_Beside: TypeAlias = _Path | _Array | Sequence[_Array | None]
_DepthKind: TypeAlias = Literal["metric", "inverse", "relative-inverse"]
# What is applied of an exposure that is unknown: nothing, or the middle of those that fit.
_Unknown: TypeAlias = Literal["leave", "middle"]
# Called with the number of frames that are done, and of all frames or None.
_Progress: TypeAlias = Callable[[int, int | None], object]

__all__ = [
    "COLOUR_SPACES",
    "Camera",
    "Defocus",
    "EXPORT_TARGETS",
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
    "run",
    "set_memory_budget",
    "track",
    "write_track",
]
__version__: str
COLOUR_SPACES: list[str]
EXPORT_TARGETS: list[str]

class Error(ValueError):
    """What was handed in cannot be used; one sentence names the argument and says what to do."""

class FileError(Error):
    """A file cannot be read, written or used; the sentence begins with its name."""

class UnknownError(Error):
    """A number was asked of a part of a camera that is unknown; the sentence says why it is."""

@final
class Exposure:
    """The shutter: how long it is open, as a share of the frame interval."""

    @property
    def known(self) -> bool: ...
    @property
    def value(self) -> float | None:
        """The exposure fraction, in [0, 1]."""
    @property
    def interval(self) -> _Interval | None:
        """The 95 % confidence interval of the exposure fraction."""
    @property
    def fits(self) -> _Interval | None:
        """The exposure fractions that fit, where the exposure itself is unknown and the footage tells that much."""
    @property
    def reason(self) -> str | None:
        """Why the exposure is unknown."""
    @property
    def reason_code(self) -> str | None:
        """The same for programs, such as "no_motion"."""
    @property
    def shutter_angle(self) -> float | None:
        """The exposure fraction times 360 degrees."""
    @property
    def phase_degrees(self) -> float | None:
        """When the shutter opens, degrees after the frame's time; None: the exposure is centred on it."""
    @property
    def seconds(self) -> float | None:
        """The exposure time, where the frame rate is known."""
    @property
    def method(self) -> str | None: ...
    @property
    def samples(self) -> int | None:
        """The number of tiles or places that the estimate rests on."""

@final
class Noise:
    """The noise of encoded frames."""

    @property
    def known(self) -> bool: ...
    @property
    def reason(self) -> str | None: ...
    @property
    def reason_code(self) -> str | None: ...
    def std(self, luminance: npt.ArrayLike = 0.5, *, level: int | None = None) -> npt.NDArray[np.float32]:
        """The std of R, G and B as encoded values, over an even grey of this luminance (Rec. 601 Y of encoded values, in [0, 1]).

        An array of the shape of `luminance` with a last axis of 3. `level`: that of one level of the pyramid, from 0, the finest, to 3.
        Raises UnknownError if the noise is unknown.
        """
    @property
    def clip(self) -> float | None:
        """The encoded value from which on the sensor clips, so that there is no noise."""
    @property
    def temporal_correlation(self) -> float | None:
        """The correlation of a frame's noise with that of the frame before it, in place."""
    @property
    def method(self) -> str | None: ...
    @property
    def samples(self) -> int | None: ...

@final
class Defocus:
    """The lens: the blur of what is out of focus, as the std of the Gaussian that is equivalent to it."""

    @property
    def known(self) -> bool: ...
    @property
    def reason(self) -> str | None: ...
    @property
    def reason_code(self) -> str | None: ...
    @property
    def depth_kind(self) -> Literal["metric", "relative"] | None:
        """Whether the lens is over inverse depth in 1/m, or over relative inverse depth, whose scale is not known."""
    @overload
    def sigma_px(self, depth_m: float) -> float: ...
    @overload
    def sigma_px(self, depth_m: npt.ArrayLike) -> npt.NDArray[np.float32]:
        """The std of the blur, px of the frames' width, at depths in metres (NaN where they are 0, negative or NaN), or at inverse depths in the
        lens's own unit.

        Raises UnknownError if the lens is unknown, and Error if depths in metres are given to a lens over relative inverse depth.
        """
    @overload
    def sigma_px(self, *, inverse_depth: float) -> float: ...
    @overload
    def sigma_px(self, *, inverse_depth: npt.ArrayLike) -> npt.NDArray[np.float32]: ...
    @property
    def sigma_px_at_infinity(self) -> float | None: ...
    @property
    def sigma_px_at_infinity_interval(self) -> _Interval | None: ...
    @property
    def focus_inverse_depth(self) -> float | None:
        """The inverse depth in focus, in the lens's own unit."""
    @property
    def focus_inverse_depth_interval(self) -> _Interval | None: ...
    @property
    def focus_m(self) -> float | None:
        """The distance in focus, m, of a metric lens."""
    @property
    def focus_outside(self) -> Literal["nearer", "beyond"] | None:
        """Where the focus is, if it lies outside of all that was seen: its number is then not well known."""
    @property
    def method(self) -> str | None: ...
    @property
    def samples(self) -> int | None: ...

@final
class Sharpening:
    """The camera's sharpening, as an unsharp mask."""

    @property
    def known(self) -> bool: ...
    @property
    def value(self) -> float | None:
        """The amount of the mask."""
    @property
    def interval(self) -> _Interval | None: ...
    @property
    def radius_px(self) -> float | None: ...
    @property
    def reason(self) -> str | None: ...
    @property
    def reason_code(self) -> str | None: ...

@final
class Export:
    """A camera as settings of another tool."""

    @property
    def target(self) -> str: ...
    @property
    def files(self) -> dict[str, str | npt.NDArray[np.float32]]:
        """Texts, and textures (H, W, 4) in [0, 1], by the names of their files; the tool loads the first one."""
    @property
    def notes(self) -> list[str]:
        """What the tool cannot do, and what is left at its default."""
    def write(self, folder: _Path) -> list[str]:
        """Writes the files into a folder, and gives their paths."""

@final
class Camera:
    """A camera: its noise, exposure, defocus and sharpening, each with an interval or with the reason why it is unknown.

    Cameras do not change, compare by their numbers, and can be pickled (without what they keep for a report). `str` describes one in words.
    """

    @classmethod
    def read(cls, path: _Path) -> Camera:
        """Reads camera.json."""
    @classmethod
    def from_json(cls, text: str) -> Camera:
        """The camera of the text of camera.json, or of one line of a track."""
    def to_json(self) -> str:
        """The text of camera.json; of a tracked camera, the line of a track."""
    def write(self, path: _Path) -> None:
        """Writes camera.json."""
    @property
    def exposure(self) -> Exposure: ...
    @property
    def noise(self) -> Noise: ...
    @property
    def defocus(self) -> Defocus: ...
    @property
    def sharpening(self) -> Sharpening: ...
    @property
    def width(self) -> int:
        """The width of the frames, px, for which numbers in px hold."""
    @property
    def height(self) -> int: ...
    @property
    def fps(self) -> float | None: ...
    @property
    def frames_used(self) -> int: ...
    @property
    def warnings(self) -> list[str]:
        """What makes the numbers less sure than their intervals say."""
    @property
    def notes(self) -> list[str]:
        """What was chosen in the estimate, why, and what was left out."""
    @property
    def shots(self) -> list[tuple[int, int]]:
        """The numbers of the first and last frame of each shot of the footage, for `estimate(.., frames=shot)`; empty if the camera is not from
        `estimate`."""
    @property
    def frame(self) -> int | None:
        """The number of the frame, of a tracked camera."""
    @property
    def changed(self) -> list[Literal["defocus", "exposure", "sharpening", "noise"]]:
        """The parts that were found to have changed just before this frame, of a tracked camera."""
    @overload
    def to_metric(self, scale: float, offset: float = 0.0) -> Camera: ...
    @overload
    def to_metric(self, *, at: Sequence[tuple[float, float, float]]) -> Camera:
        """The camera with its lens over metres: by the scene's scale, where relative inverse depth is scale / Z + offset, or by one or two
        places (x, y, metres) of the frames whose distance is known."""
    def replace(
        self,
        *,
        shutter: float | None = None,
        shutter_phase: float | None = None,
        focus: float | None = None,
        blur: float | None = None,
        bokeh: str | None = None,
        squeeze: float | None = None,
        cats_eye: float | None = None,
        grain: float | None = None,
    ) -> Camera:
        """The camera with parts that are set by hand.

        shutter: the shutter angle, degrees, 0 to 360. shutter_phase: when the shutter opens, degrees after the frame's time, -180 to 180.
        focus: the distance in focus, m. blur: the blur at infinity, std in px of the camera's width, 0 to 100.
        bokeh: the shape of out-of-focus points: "gaussian", "disk" or "polygon:N[,ROUNDNESS[,ROTATION]]". squeeze: how many times these are
            as high as wide, 0.25 to 4. cats_eye: how much they are cut towards the picture's edges, 0 to 1.
        grain: the factor of the noise's std, 0 to 100.
        """
    def export(
        self,
        target: str,
        *,
        fov: float | None = None,
        size: tuple[int, int] | None = None,
        scene_scale: tuple[float, float] | None = None,
    ) -> Export:
        """The camera as settings of another tool, one of EXPORT_TARGETS.

        `fov`: the vertical field of view of the tool's camera, degrees. `size`: width and height of its pictures, px; the footage's by default.
        `scene_scale`: scale and offset as of `to_metric`.
        """
    def facts(self) -> dict[str, Any]:
        """What follows from the camera, with all intervals: what `blindaug inspect --json` prints."""
    def report(self, path: _Path) -> None:
        """Writes a page of HTML with what the estimate rests on. Needs `estimate(.., samples=True)`."""
    def _repr_html_(self) -> str: ...

def estimate(
    footage: _Footage,
    *,
    depth: _Beside | None = None,
    flow: _Beside | None = None,
    clean: _Beside | None = None,
    fps: float | None = None,
    frames: tuple[int | None, int | None] | None = None,
    colour_space: str | None = None,
    depth_kind: _DepthKind = "metric",
    method: Literal["auto", "spectral", "removal"] = "auto",
    networks: Sequence[str] | None = None,
    curve: Literal["thin-lens", "quadratic"] = "thin-lens",
    blur_in: Literal["linear", "encoded"] = "linear",
    noise_model: Literal["curves", "lines"] = "curves",
    samples: bool = False,
    progress: _Progress | None = None,
) -> Camera:
    """Estimates a camera from its footage.

    footage: a video, an image or a folder of images; an array (T, H, W, 3); or frames (H, W, 3) one after another: a list, a generator, ..
        Values are encoded (sRGB if nothing else is said) and uint8, uint16 or floats in [0, 1].
    depth: metres, (H, W) for a frame; 0, negative or NaN: unknown. `depth_kind`: inverse depth in 1/m, or relative inverse depth, instead.
    flow: the motion to the next frame, px, x right and y down, (H, W, 2); NaN: unknown.
    clean: the frames without noise and blur.
        Each of these three is a folder, an array for all frames or with the frames first, or a list with an array or None for each frame.
    fps: frames per second, where the footage does not say it.
    frames: the numbers of the first and last frame of a file or folder that are used; None: from the beginning, to the end.
    colour_space: what the frames are encoded in, one of COLOUR_SPACES; what a file says by default, else sRGB.
    method: how blur is estimated: from local spectra, or by its removal (by comparison with `clean`, or by networks); "auto" takes the surer.
    networks: names of installed networks (`blindaug models list`) that remove noise or blur, or find flow or depth, or their manifests;
        "none": none. By default method="removal" takes the built-in ones.
    curve, blur_in, noise_model: the curve of defocus over inverse depth, the values that shutter and lens act on, the kind of noise model.
    samples: keep a few frames, for `Camera.report`.
    progress: is called with the numbers of frames that are done and of all frames (None if that is not known).

    Raises Error, and what `footage` or `progress` raise. Ctrl-C stops it at the next frame.
    """

def apply(
    rgb: _Array,
    cam: Camera,
    *,
    depth: _Array | None = None,
    flow: _Array | None = None,
    number: int | None = None,
    seed: int = 0,
    noise: bool = True,
    unknown: _Unknown = "leave",
    colour_space: str | None = None,
    depth_kind: _DepthKind = "metric",
) -> _Array:
    """A sharp, noise-free frame (H, W, 3) as the camera would have filmed it: defocused by its depth, blurred along its flow, sharpened, with
    noise. The result has the type and the colour space of `rgb`.

    number: the frame's number, by default the camera's or 1; each number and seed has its own noise.
    unknown: what is applied of an exposure that is unknown, "leave" for nothing or "middle" for the middle of those that fit.
    """

class _DistortedLayer(TypedDict):
    """What a composite adds to a frame F: layer's colour + (1 - its alpha) F + noise is the composite, in scene-linear values."""

    layer: npt.NDArray[np.float32]
    noise: npt.NDArray[np.float32]
    holdout: npt.NDArray[np.float32]
    depth: npt.NDArray[np.float32]
    motion: npt.NDArray[np.float32]

@overload
def composite(
    frame: _Array,
    layer: _Array,
    cam: Camera | None,
    *,
    layer_depth: _Array | float | Literal["plate"] | None = None,
    layer_motion: _Array | tuple[float, float] | Literal["plate"] | None = None,
    depth: _Array | None = None,
    flow: _Array | None = None,
    with_: _Array | None = None,
    without: _Array | None = None,
    holdout: _Array | None = None,
    match_at: tuple[float, float] | None = None,
    number: int | None = None,
    seed: int = 0,
    noise: bool = True,
    unknown: _Unknown = "leave",
    product: Literal["composite"] = "composite",
    colour_space: str | None = None,
    layer_colour_space: str | None = None,
) -> _Array:
    """A rendered object over a frame (H, W, 3) as if the camera had filmed it. The result has the type and the colour space of `frame`.

    layer: (H, W, 4), premultiplied by alpha, scene-linear floats.
    cam: the camera; None pastes the object as it is.
    layer_depth: the object's depth in metres, (H, W) or one number, or "plate" for the median of `depth` where the object is; without it, the
        object is not defocused and nothing is in front of it.
    layer_motion: the object's motion to the next frame, px, (H, W, 2) or one pair, or "plate" for the median of `flow` where the object is;
        without it, the object is not motion-blurred.
    depth: the depth of the filmed scene in metres, (H, W): what is nearer hides the object.
    with_, without: sharp renders of the local scene with and without the object, for its shadows and reflections; integers are sRGB, floats
        scene-linear. flow: the motion of the filmed scene, by which these are blurred.
    holdout: a matte of things in front of the object, (H, W) of uint8, uint16 or floats in [0, 1]: white hides it.
    match_at: a place x, y in px: the object is as blurred as the frame is there, whatever its depth, so that no scale is needed.
    number: the frame's number, by default the camera's or 1; each number and seed has its own noise.
    unknown: what is applied of an exposure that is unknown, "leave" for nothing or "middle" for the middle of those that fit.
    product: "layer" gives, instead of the composite, what it adds to the frame, as arrays by their names: layer (H, W, 4), noise (H, W, 3),
        holdout (H, W), depth (H, W) and motion (H, W, 2).
    """

@overload
def composite(
    frame: _Array,
    layer: _Array,
    cam: Camera | None,
    *,
    layer_depth: _Array | float | Literal["plate"] | None = None,
    layer_motion: _Array | tuple[float, float] | Literal["plate"] | None = None,
    depth: _Array | None = None,
    flow: _Array | None = None,
    with_: _Array | None = None,
    without: _Array | None = None,
    holdout: _Array | None = None,
    match_at: tuple[float, float] | None = None,
    number: int | None = None,
    seed: int = 0,
    noise: bool = True,
    unknown: _Unknown = "leave",
    product: Literal["layer"],
    colour_space: str | None = None,
    layer_colour_space: str | None = None,
) -> _DistortedLayer: ...

@final
class Track(Iterator[Camera]):
    """The cameras of the frames of some footage, found while they are asked for, up to 624 frames ahead."""

    def __iter__(self) -> Track: ...
    def __next__(self) -> Camera: ...
    def __length_hint__(self) -> int: ...

def track(
    footage: _Footage,
    *,
    depth: _Beside | None = None,
    flow: _Beside | None = None,
    fps: float | None = None,
    frames: tuple[int | None, int | None] | None = None,
    colour_space: str | None = None,
    depth_kind: _DepthKind = "metric",
    progress: _Progress | None = None,
) -> Track:
    """Estimates a camera for each frame, which follows changes of light, focus and shutter. The arguments are those of `estimate`.

    A frame's noise is a mean over the frames before and after it, so that cameras come up to 624 frames late; footage without an end is for
    `Tracker`.
    """

@final
class Tracker:
    """Follows a camera by frames that are pushed one after another, from one thread at a time.

    The cameras are those of `track`, but for the noise: it is what is known when the frame comes, and a change of it is told when it is noticed.
    """

    def __new__(
        cls, *, fps: float | None = None, colour_space: str | None = None, depth_kind: _DepthKind = "metric"
    ) -> Tracker: ...
    def push(
        self, frame: _Array, *, depth: _Array | None = None, flow: _Array | None = None, number: int | None = None
    ) -> Camera | None:
        """Takes the next frame, and gives the camera of the frame before it, which needed this one; None for the first frame.

        number: the frame's number, by default that of the last frame plus 1; a gap in the numbers is a gap in time.
        """
    def finish(self) -> Camera | None:
        """The camera of the last frame; None if none waits."""

def read_track(path: _Path) -> list[Camera]:
    """Reads the cameras of a track, or one camera."""

def write_track(path: _Path, cameras: Sequence[Camera]) -> None:
    """Writes the cameras of a track, a line of JSON each."""

def set_memory_budget(bytes: int) -> None:
    """Sets how much memory may be taken, in bytes; 0 for the default, half of what the machine has."""

def run(arguments: Sequence[_Path]) -> int:
    """Runs the command line of these arguments, of which the first is the program's name, and gives its exit status."""
