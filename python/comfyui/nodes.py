"""The nodes. An IMAGE is a float tensor (B, H, W, C) of sRGB values in [0, 1], the frames of a clip first; a MASK is (B, H, W), 1 where the object is.

FLOW is a float tensor (B, H, W, 2): the motion to the next frame, px, x right and y down. CAMERA is a blindaug.Camera.
"""

from __future__ import annotations

from typing import Any

import blindaug as ba
import numpy as np
import numpy.typing as npt
import torch

_Array = npt.NDArray[np.float32]

CATEGORY = "blindaug"
DEPTH_KINDS = ["metric", "inverse", "relative-inverse"]


def _array(tensor: Any, name: str, axes: int, last: tuple[int, ...] = ()) -> _Array:
    """A tensor's values, whose last axis has one of these lengths."""
    values = np.ascontiguousarray(tensor.detach().cpu().numpy(), dtype=np.float32)
    if values.ndim != axes or last and values.shape[-1] not in last or values.shape[0] == 0:
        raise ba.Error(f"{name}: has the shape {tuple(values.shape)}, which is none of an image batch; give one with {axes} axes")
    return values


def _colour(images: Any, name: str) -> _Array:
    return _array(images, name, 4, (3, 4))[..., :3]


def _first_channel(images: Any, name: str) -> _Array:
    return _array(images, name, 4)[..., 0]


def _tensor(values: _Array) -> Any:
    return torch.from_numpy(np.ascontiguousarray(values))


def _light(encoded: _Array) -> _Array:
    """The light of sRGB values."""
    return np.where(encoded <= 0.04045, encoded / 12.92, ((np.maximum(encoded, 0.0) + 0.055) / 1.055) ** 2.4).astype(np.float32)


class EstimateCamera:
    """Estimates the camera of a clip."""

    CATEGORY = CATEGORY
    FUNCTION = "estimate"
    RETURN_TYPES = ("CAMERA", "STRING")
    RETURN_NAMES = ("camera", "text")
    DESCRIPTION = "Noise, exposure, defocus and sharpening of the camera that filmed these frames, each with its interval or with the reason why it is unknown."

    @classmethod
    def INPUT_TYPES(cls) -> dict[str, Any]:
        return {
            "required": {"images": ("IMAGE",)},
            "optional": {
                "fps": ("FLOAT", {"default": 0.0, "min": 0.0, "max": 1000.0, "tooltip": "Frames per second; 0: not known"}),
                "depth": ("IMAGE", {"tooltip": "Depth of each frame, in the first channel; without it the motion of the camera tells it"}),
                "depth_kind": (DEPTH_KINDS, {"default": "metric", "tooltip": "Metres, inverse depth in 1/m, or inverse depth without a unit, as networks find it"}),
                "flow": ("FLOW", {"tooltip": "Motion to the next frame, px; without it, it is found"}),
            },
        }

    def estimate(
        self, images: Any, fps: float = 0.0, depth: Any = None, depth_kind: Any = "metric", flow: Any = None
    ) -> tuple[ba.Camera, str]:
        camera = ba.estimate(
            _colour(images, "images"),
            fps=fps or None,
            depth=None if depth is None else _first_channel(depth, "depth"),
            depth_kind=depth_kind,
            flow=None if flow is None else _array(flow, "flow", 4, (2,)),
        )
        return camera, str(camera)


class MatchCamera:
    """Composites a rendered or generated object over frames as if the camera had filmed it."""

    CATEGORY = CATEGORY
    FUNCTION = "match"
    RETURN_TYPES = ("IMAGE",)
    RETURN_NAMES = ("images",)
    DESCRIPTION = "The layer over the background, with the camera's defocus, motion blur and noise."

    @classmethod
    def INPUT_TYPES(cls) -> dict[str, Any]:
        return {
            "required": {
                "background": ("IMAGE",),
                "layer": ("IMAGE", {"tooltip": "The object, sharp and noise-free"}),
                "mask": ("MASK", {"tooltip": "White where the object is. The mask of Load Image is the opposite: invert it"}),
                "camera": ("CAMERA",),
                "first_frame": ("INT", {"default": 1, "min": 0, "max": 2**31, "tooltip": "The number of the first frame: each has its own noise"}),
                "seed": ("INT", {"default": 0, "min": 0, "max": 2**63 - 1}),
            },
            "optional": {
                "layer_depth": ("IMAGE", {"tooltip": "Depth of the object, m, in the first channel"}),
                "layer_metres": ("FLOAT", {"default": 0.0, "min": 0.0, "max": 100000.0, "tooltip": "One depth for all of the object, m; 0: not known, so that it is not defocused"}),
                "layer_flow": ("FLOW", {"tooltip": "Motion of the object to the next frame, px"}),
                "depth": ("IMAGE", {"tooltip": "Depth of the background, m, in the first channel: what is nearer hides the object"}),
                "at_x": ("INT", {"default": 0, "min": 0, "max": 65535, "tooltip": "A place of the frames whose distance is known, px from the left"}),
                "at_y": ("INT", {"default": 0, "min": 0, "max": 65535, "tooltip": "The same, px from the top"}),
                "at_metres": ("FLOAT", {"default": 0.0, "min": 0.0, "max": 100000.0, "tooltip": "The distance of that place, m, which brings a camera over relative depth to metres; 0: not known"}),
                "noise": ("BOOLEAN", {"default": True}),
            },
        }

    def match(
        self,
        background: Any,
        layer: Any,
        mask: Any,
        camera: ba.Camera,
        first_frame: int = 1,
        seed: int = 0,
        layer_depth: Any = None,
        layer_metres: float = 0.0,
        layer_flow: Any = None,
        depth: Any = None,
        at_x: int = 0,
        at_y: int = 0,
        at_metres: float = 0.0,
        noise: bool = True,
    ) -> tuple[Any]:
        frames = _colour(background, "background")

        def of_each(name: str, values: _Array) -> _Array:
            if len(values) not in (1, len(frames)):
                raise ba.Error(f"{name}: has {len(values)} frames, and the background {len(frames)}; give one frame, or as many")
            return np.broadcast_to(values, (len(frames), *values.shape[1:]))

        colour, alpha = of_each("layer", _colour(layer, "layer")), of_each("mask", _array(mask, "mask", 3))
        if colour.shape[1:3] != alpha.shape[1:3]:
            raise ba.Error(f"mask: is {alpha.shape[2]} x {alpha.shape[1]} px, and the layer {colour.shape[2]} x {colour.shape[1]} px; give them in one size")
        z = None if layer_depth is None else of_each("layer_depth", _first_channel(layer_depth, "layer_depth"))
        motion = None if layer_flow is None else of_each("layer_flow", _array(layer_flow, "layer_flow", 4, (2,)))
        scene = None if depth is None else of_each("depth", _first_channel(depth, "depth"))
        if camera.defocus.depth_kind == "relative":
            if at_metres <= 0.0:
                raise ba.Error(
                    "camera: its lens is over relative depth: say how far away a place of the frames is (at_x, at_y, at_metres), or estimate it with depth in metres"
                )
            camera = camera.to_metric(at=[(at_x, at_y, at_metres)])
        made = []
        for i, frame in enumerate(frames):
            premultiplied = np.dstack([_light(colour[i]) * alpha[i][..., None], alpha[i]])
            made.append(
                ba.composite(
                    frame,
                    premultiplied,
                    camera,
                    layer_depth=(layer_metres or None) if z is None else z[i],
                    layer_motion=None if motion is None else motion[i],
                    depth=None if scene is None else scene[i],
                    number=first_frame + i,
                    seed=seed,
                    noise=noise,
                )
            )
        return (_tensor(np.stack(made)),)


NODE_CLASS_MAPPINGS = {"BlindaugEstimateCamera": EstimateCamera, "BlindaugMatchCamera": MatchCamera}
NODE_DISPLAY_NAME_MAPPINGS = {"BlindaugEstimateCamera": "Estimate Camera", "BlindaugMatchCamera": "Match Camera"}
