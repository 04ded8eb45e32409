"""The nodes for ComfyUI, called by their functions. Where torch is not installed, a stand-in has what the nodes use of it."""

import importlib.util
import sys
import types
from pathlib import Path

import numpy as np
import pytest

import blindaug as ba

FOLDER = Path(__file__).resolve().parents[1] / "comfyui"


class Tensor:
    """The few methods of a tensor that the nodes call."""

    def __init__(self, values: np.ndarray) -> None:
        self.values = values

    def detach(self) -> "Tensor":
        return self

    def cpu(self) -> "Tensor":
        return self

    def numpy(self) -> np.ndarray:
        return self.values


try:
    import torch
except ImportError:
    torch = types.ModuleType("torch")
    torch.from_numpy = Tensor
    sys.modules["torch"] = torch


@pytest.fixture(scope="module")
def nodes():
    """The folder, loaded as ComfyUI loads it: as a package of any name."""
    spec = importlib.util.spec_from_file_location(
        "custom_node", FOLDER / "__init__.py", submodule_search_locations=[str(FOLDER)]
    )
    module = importlib.util.module_from_spec(spec)
    sys.modules["custom_node"] = module
    spec.loader.exec_module(module)
    return {name: node() for name, node in module.NODE_CLASS_MAPPINGS.items()}


def image(values: np.ndarray):
    """An IMAGE of frames."""
    return torch.from_numpy(np.ascontiguousarray(values, np.float32))


@pytest.fixture(scope="module")
def frames(clip) -> np.ndarray:
    return (clip.frames / 255.0).astype(np.float32)


@pytest.fixture(scope="module")
def layers(clip) -> tuple[np.ndarray, np.ndarray]:
    """The object's straight sRGB colour, and its alpha."""
    alpha = clip.layers[..., 3:].astype(np.float32)
    light = np.divide(clip.layers[..., :3], alpha, out=np.zeros_like(clip.layers[..., :3]), where=alpha > 0)
    light = np.clip(light, 0.0, 1.0)
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055), alpha[..., 0]


def test_inputs_are_those_of_the_functions(nodes) -> None:
    for node in nodes.values():
        inputs = node.INPUT_TYPES()
        names = [*inputs["required"], *inputs.get("optional", {})]
        code = getattr(node, node.FUNCTION).__code__
        assert list(code.co_varnames[1 : code.co_argcount]) == names
        assert len(node.RETURN_TYPES) == len(node.RETURN_NAMES)


def test_a_camera_is_that_of_the_package(nodes, frames, clip) -> None:
    estimate = nodes["BlindaugEstimateCamera"].estimate
    camera, text = estimate(image(frames), fps=30.0)
    assert camera == ba.estimate(frames, fps=30)
    assert text == str(camera) and "exposure" in text.lower()
    depth = np.repeat(clip.depth[..., None], 3, axis=-1)
    metric, _ = estimate(image(frames), depth=image(depth), flow=image(clip.flow))
    assert metric == ba.estimate(frames, depth=clip.depth.astype(np.float32), flow=clip.flow.astype(np.float32))
    # Negative control: other evidence gives another camera.
    assert metric != camera


def test_a_match_is_the_composite_of_the_package(nodes, frames, clip, camera, layers) -> None:
    match = nodes["BlindaugMatchCamera"].match
    colour, alpha = layers
    depth = np.repeat(clip.layer_depth[..., None], 3, axis=-1)
    given = dict(layer_depth=image(depth), layer_flow=image(clip.layer_motion), seed=7)
    (made,) = match(image(frames), image(colour), image(alpha), camera, first_frame=1, **given)
    made = made.numpy()
    assert made.shape == frames.shape and made.dtype == np.float32
    for i, frame in enumerate(frames):
        encoded = colour[i].astype(np.float32)
        light = np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)
        layer = np.dstack([light * alpha[i][..., None], alpha[i]]).astype(np.float32)
        wanted = ba.composite(
            frame, layer, camera, layer_depth=clip.layer_depth[i].astype(np.float32),
            layer_motion=clip.layer_motion[i].astype(np.float32), number=i + 1, seed=7,
        )
        assert np.array_equal(made[i], wanted), i
    # The layer as it was rendered is what the straight colour stands for, but for light where alpha is 0, which straight colour cannot hold.
    layer = np.where(clip.layers[0][..., 3:] > 0, clip.layers[0], np.float32(0))
    rendered = ba.composite(
        frames[0], layer, camera, layer_depth=clip.layer_depth[0], layer_motion=clip.layer_motion[0], number=1, seed=7
    )
    assert np.abs(made[0] - rendered).max() < 0.02
    # A part of the batch, counted on, is the same as the whole.
    part = dict(layer_depth=image(depth[2:]), layer_flow=image(clip.layer_motion[2:]), seed=7)
    (rest,) = match(image(frames[2:]), image(colour[2:]), image(alpha[2:]), camera, first_frame=3, **part)
    assert np.array_equal(rest.numpy(), made[2:])
    # Negative control: from 1 on, its noise is another.
    (other,) = match(image(frames[2:]), image(colour[2:]), image(alpha[2:]), camera, first_frame=1, **part)
    assert not np.array_equal(other.numpy(), made[2:])


def test_one_layer_is_for_all_frames(nodes, frames, camera, layers) -> None:
    match = nodes["BlindaugMatchCamera"].match
    colour, alpha = layers
    (made,) = match(image(frames[:2]), image(colour[:1]), image(alpha[:1]), camera, layer_metres=3.0)
    (same,) = match(image(frames[:2]), image(colour[[0, 0]]), image(alpha[[0, 0]]), camera, layer_metres=3.0)
    assert np.array_equal(made.numpy(), same.numpy())


def test_a_camera_over_relative_depth_takes_a_distance(nodes, frames, layers) -> None:
    match = nodes["BlindaugMatchCamera"].match
    colour, alpha = layers
    camera = ba.estimate(frames, fps=30)
    assert camera.defocus.depth_kind == "relative"
    arguments = (image(frames[:1]), image(colour[:1]), image(alpha[:1]))
    (scaled,) = match(*arguments, camera, layer_metres=3.0, at_x=136, at_y=136, at_metres=4.0)
    (wanted,) = match(*arguments, camera.to_metric(at=[(136, 136, 4.0)]), layer_metres=3.0)
    assert np.array_equal(scaled.numpy(), wanted.numpy())
    # Negative control: at another distance it is blurred in another way.
    (other,) = match(*arguments, camera, layer_metres=3.0, at_x=136, at_y=136, at_metres=2.0)
    assert not np.array_equal(other.numpy(), wanted.numpy())
    with pytest.raises(ba.Error, match="at_metres"):
        match(*arguments, camera, layer_metres=3.0)


def test_what_does_not_fit_is_one_sentence(nodes, frames, camera, layers) -> None:
    match = nodes["BlindaugMatchCamera"].match
    colour, alpha = layers
    for arguments, name in [
        ((frames, colour[:2], alpha, camera), "layer: has 2 frames, and the background 5"),
        ((frames, colour, alpha[:, :100], camera), "mask: is 272 x 100 px"),
        ((frames[0], colour, alpha, camera), "background: has the shape"),
    ]:
        *images, last = arguments
        with pytest.raises(ba.Error, match=name) as raised:
            match(*map(image, images), last)
        assert "\n" not in str(raised.value)
