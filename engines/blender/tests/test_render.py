"""What Blender renders with the add-on's settings and nodes, beside the command line's composite of the same layer, which Blender renders
sharp, with its depth and motion.

Squares that shine evenly stand before a camera: three that do not move, in focus, behind and before it, one in focus that moves, and greys
in focus for the noise. What is compared are widths of edges and stds of noise.
"""

import json
import math
import os
from pathlib import Path
from types import SimpleNamespace

import bpy
import numpy as np
import OpenEXR
import pytest
from conftest import ROOT, start_scene

WIDTH, HEIGHT = 384, 256
FRAME = 2
FOCUS, SIGMA, EXPOSURE = 2.5, 3.0, 0.5
# The motion of the moving square, px to the next frame, to the right.
MOTION = 16.0
GREYS = (0.15, 0.35, 0.55, 0.75, 0.9)
# The most that the std of an edge's blur may differ, px and as a share, and that of the noise, as a share.
EDGE_PX, EDGE_SHARE, NOISE_SHARE = 0.04, 0.02, 0.04
# The least PSNR of the two pictures, dB.
ALIKE = 48.0


class Square:
    """A square in px of the picture at a depth in m, whose left edge is looked at."""

    def __init__(self, left, top, side, depth, light=0.8):
        self.left, self.top, self.side, self.depth, self.light = left, top, side, depth, light


SQUARES = {
    "focus": Square(30, 24, 60, 2.5),
    "far": Square(130, 24, 60, 8.0),
    "near": Square(230, 24, 60, 1.4),
    "moving": Square(60, 108, 60, 2.5),
}
PATCHES = [Square(20 + 70 * i, 190, 56, 2.5, grey) for i, grey in enumerate(GREYS)]


def light_of(encoded):
    return encoded / 12.92 if encoded <= 0.04045 else ((encoded + 0.055) / 1.055) ** 2.4


def encoded_of(light):
    light = np.maximum(light, 0.0)
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)


def expected(square, moves=False):
    """The std of the blur of a square's upright edge."""
    if moves:
        return EXPOSURE * MOTION / math.sqrt(12.0)
    return SIGMA * abs(1.0 - FOCUS / square.depth)


def build(metres_per_unit=1.0):
    """The scene, whose unit is as many metres."""
    scene = start_scene((WIDTH, HEIGHT))
    scene.unit_settings.scale_length = metres_per_unit
    scene.render.engine = "CYCLES"
    scene.cycles.device = "CPU"
    scene.cycles.samples = 128
    scene.cycles.use_adaptive_sampling = scene.cycles.use_denoising = False
    scene.render.dither_intensity = 0.0
    scene.frame_end = 3
    lens = scene.camera.data
    lens.sensor_width, lens.lens = 36.0, 40.0
    lens.clip_start = 0.01 / metres_per_unit
    scene.camera.rotation_euler = (math.pi / 2, 0.0, 0.0)
    px = lens.sensor_width / lens.lens / WIDTH
    for square in [*SQUARES.values(), *PATCHES]:
        depth = square.depth / metres_per_unit
        at = lambda x, y: ((x - 0.5 * WIDTH) * px * depth, depth, (0.5 * HEIGHT - y) * px * depth)
        middle = at(square.left + 0.5 * square.side, square.top + 0.5 * square.side)
        bpy.ops.mesh.primitive_plane_add(size=square.side * px * depth, location=middle, rotation=(math.pi / 2, 0.0, 0.0))
        thing = bpy.context.object
        material = bpy.data.materials.new("light")
        material.use_nodes = True
        nodes = material.node_tree.nodes
        nodes.clear()
        shine = nodes.new("ShaderNodeEmission")
        shine.inputs["Color"].default_value = (*[light_of(square.light)] * 3, 1.0)
        material.node_tree.links.new(shine.outputs[0], nodes.new("ShaderNodeOutputMaterial").inputs["Surface"])
        thing.data.materials.append(material)
        if square is SQUARES["moving"]:
            for frame in (FRAME - 2, FRAME + 2):
                thing.location = np.array(middle) + np.array([(frame - FRAME) * MOTION * px * depth, 0.0, 0.0])
                thing.keyframe_insert("location", frame=frame)
            for curve in thing.animation_data.action.fcurves:
                for key in curve.keyframe_points:
                    key.interpolation = "LINEAR"
    return scene


def render(scene, path, frame=FRAME):
    settings = scene.render.image_settings
    if str(path).endswith(".exr"):
        settings.file_format, settings.color_depth = "OPEN_EXR_MULTILAYER", "32"
    else:
        settings.file_format, settings.color_mode, settings.color_depth = "PNG", "RGB", "16"
    scene.frame_set(frame)
    scene.render.filepath = str(path)
    bpy.ops.render.render(write_still=True)
    return path


def pixels(path):
    """Encoded values, from the top left."""
    image = bpy.data.images.load(str(path))
    image.colorspace_settings.name = "Non-Color"
    values = np.array(image.pixels[:], dtype=np.float64).reshape(image.size[1], image.size[0], 4)[::-1, :, :3]
    bpy.data.images.remove(image)
    return values


def write_png(path, values):
    """Writes encoded values with 16 bits."""
    height, width, _ = values.shape
    image = bpy.data.images.new("plate", width, height, float_buffer=True)
    image.colorspace_settings.name = "Non-Color"
    image.pixels.foreach_set(np.dstack([values, np.ones((height, width))])[::-1].astype(np.float32).ravel())
    scene = bpy.data.scenes.new("to write")
    scene.view_settings.view_transform = "Raw"
    settings = scene.render.image_settings
    settings.file_format, settings.color_mode, settings.color_depth = "PNG", "RGB", "16"
    image.save_render(str(path), scene=scene)
    bpy.data.scenes.remove(scene)
    bpy.data.images.remove(image)


def edge_std(light, square, reach=22):
    """The std of the spread of a square's left edge, px, of a picture in light: the second moment of the edge's derivative."""
    rows = slice(square.top + 22, square.top + square.side - 22)
    profile = light[rows, square.left - reach : square.left + reach].mean(axis=(0, 2))
    spread = np.diff(profile)
    spread /= spread.sum()
    x = np.arange(len(spread))
    middle = (spread * x).sum()
    return math.sqrt(max((spread * (x - middle) ** 2).sum(), 0.0))


def blurs(picture, sharp):
    """The std of the blur of each square's edge: what is wider than in the sharp picture."""
    light = [np.vectorize(light_of)(p) for p in (picture, sharp)]
    both = {name: [edge_std(of, square) for of in light] for name, square in SQUARES.items()}
    return {name: math.sqrt(max(wide**2 - narrow**2, 0.0)) for name, (wide, narrow) in both.items()}


def apart(found, wanted):
    """The names of the edges whose blur differs by more than the tolerance."""
    return {name for name, std in wanted.items() if abs(found[name] - std) > EDGE_PX + EDGE_SHARE * std}


def stds(pictures):
    """The std of the noise of R, G and B on each grey."""
    inside = lambda s: (slice(s.top + 10, s.top + s.side - 10), slice(s.left + 10, s.left + s.side - 10))
    return np.array([[np.std([p[inside(s)][..., c] - p[inside(s)][..., c].mean() for p in pictures]) for c in range(3)] for s in PATCHES])


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    kept = os.environ.get("BLINDAUG_BLENDER_PICTURES")
    path = Path(kept) if kept else tmp_path_factory.mktemp("render")
    for name in ("plate", "layer"):
        (path / name).mkdir(parents=True, exist_ok=True)
    return path


@pytest.fixture(scope="module")
def camera(folder):
    """Cameras with and without noise, as files."""
    model = json.loads((ROOT / "tools/blender/camera.json").read_text())
    model["capture"].update(width=WIDTH, height=HEIGHT)
    model["motion_blur"].update(exposure=EXPOSURE, interval=[EXPOSURE] * 2)
    model["defocus"].update(sigma_px_at_infinity=SIGMA, focus_inverse_depth=1.0 / FOCUS)
    noisy, clean = folder / "noisy.json", folder / "clean.json"
    noisy.write_text(json.dumps(model))
    model["noise"] = {"unknown": "it is left out", "reason": "not_estimated"}
    clean.write_text(json.dumps(model))
    return SimpleNamespace(noisy=noisy, clean=clean)


@pytest.fixture(scope="module")
def plate(installed, folder):
    """Three frames of a camera's dim footage, with a gradient from left to right and some noise."""
    start_scene()
    rng = np.random.default_rng(1)
    for frame in range(1, 4):
        values = np.tile(np.linspace(0.18, 0.24, WIDTH)[None, :, None], (HEIGHT, 1, 3)) + rng.normal(0.0, 0.004, (HEIGHT, WIDTH, 3))
        write_png(folder / f"plate/{frame:04}.png", values)
    return folder / "plate/0001.png"


@pytest.fixture(scope="module")
def layer(plate, folder):
    """The layer as Blender renders it sharp: premultiplied light with depth and motion; and the sharp picture over the plate."""
    scene = build()
    scene.render.film_transparent = True
    view = scene.view_layers[0]
    view.use_pass_z = view.use_pass_vector = True
    for frame in range(1, 4):
        render(scene, folder / f"layer/{frame:04}.exr", frame)
    with OpenEXR.File(str(folder / f"layer/{FRAME:04}.exr"), separate_channels=True) as file:
        channels = {name.split(".", 1)[1]: channel.pixels for name, channel in file.channels().items()}
    light = np.stack([channels[f"Combined.{c}"] for c in "RGB"], axis=-1)
    return SimpleNamespace(light=light, alpha=channels["Combined.A"][..., None])


@pytest.fixture(scope="module")
def sharp(layer, plate, folder):
    under = np.vectorize(light_of)(pixels(folder / f"plate/{FRAME:04}.png"))
    return encoded_of(layer.light + (1.0 - layer.alpha) * under)


@pytest.fixture(scope="module")
def composite(layer, camera, blindaug, folder):
    """The command line's composites, by the name of the camera."""

    def made(name):
        blindaug(
            *("composite", folder / "plate", "--virtual", folder / "layer", "--camera", getattr(camera, name)),
            *("--bokeh", "disk", "-o", folder / f"composite_{name}", "--overwrite"),
        )
        return [pixels(folder / f"composite_{name}/{frame:04}.png") for frame in range(1, 4)]

    return {name: made(name) for name in ("noisy", "clean")}


def through_blender(camera, plate, path, change=None, frames=(FRAME,), metres_per_unit=1.0):
    """The pictures that Blender renders after the add-on has set the scene. `change` spoils a setting."""
    scene = build(metres_per_unit)
    scene.active_clip = bpy.data.movieclips.load(str(plate))
    assert bpy.ops.blindaug.load(filepath=str(camera)) == {"FINISHED"}
    assert bpy.ops.blindaug.apply() == {"FINISHED"}
    if change:
        change(scene)
    return [pixels(render(scene, path.with_name(f"{path.stem}_{frame}.png"), frame)) for frame in frames]


def psnr(a, b):
    return -10.0 * math.log10(np.mean((a - b) ** 2))


@pytest.fixture(scope="module")
def rendered(camera, plate, folder):
    return through_blender(camera.clean, plate, folder / "blender.png")[0]


def test_blur_is_the_command_line_s_and_the_model_s(rendered, composite, sharp):
    wanted = {name: expected(square, name == "moving") for name, square in SQUARES.items()}
    blender, ours = blurs(rendered, sharp), blurs(composite["clean"][FRAME - 1], sharp)
    print("\nstd of the blur, px:    model  Blender  composite")
    for name in SQUARES:
        print(f"{name:20} {wanted[name]:8.3f} {blender[name]:8.3f} {ours[name]:8.3f}")
    alike = psnr(rendered, composite["clean"][FRAME - 1])
    print(f"PSNR of Blender's picture and the composite: {alike:.1f} dB")
    assert alike > ALIKE
    assert not apart(blender, wanted) and not apart(ours, wanted) and not apart(blender, ours)


@pytest.mark.parametrize(
    "name, change, edges",
    [
        ("f-stop", lambda scene: setattr(scene.camera.data.dof, "aperture_fstop", 1.5 * scene.camera.data.dof.aperture_fstop), {"far", "near"}),
        ("focus", lambda scene: setattr(scene.camera.data.dof, "focus_distance", 1.2 * FOCUS), {"focus", "far", "near"}),
        ("shutter", lambda scene: setattr(scene.render, "motion_blur_shutter", 1.5 * EXPOSURE), {"moving"}),
    ],
)
def test_a_wrong_setting_is_told(name, change, edges, camera, plate, folder, sharp, composite):
    picture = through_blender(camera.clean, plate, folder / f"wrong_{name}.png", change)[0]
    ours = composite["clean"][FRAME - 1]
    print(f"\nwrong {name}: {blurs(picture, sharp)}, PSNR {psnr(picture, ours):.1f} dB")
    assert apart(blurs(picture, sharp), blurs(ours, sharp)) == edges
    assert psnr(picture, ours) < ALIKE


def test_the_scene_s_unit_changes_nothing(camera, plate, folder, sharp, rendered):
    picture = through_blender(camera.clean, plate, folder / "unit.png", metres_per_unit=0.01)[0]
    assert not apart(blurs(picture, sharp), blurs(rendered, sharp))
    assert psnr(picture, rendered) > ALIKE


def test_the_plate_is_left_as_it_is(camera, plate, folder, layer):
    """Where the layer is not, and no noise of it."""
    picture = through_blender(camera.noisy, plate, folder / "noise.png")[0]
    clear = np.ones((HEIGHT, WIDTH), bool)
    for square in [*SQUARES.values(), *PATCHES]:
        clear[max(square.top - 24, 0) : square.top + square.side + 24, max(square.left - 24, 0) : square.left + square.side + 24] = False
    differences = np.abs(picture - pixels(folder / f"plate/{FRAME:04}.png"))
    assert clear.sum() > 2000
    assert differences[clear].max() < 1e-4 < differences[~clear].max()


def test_noise_is_the_command_line_s(installed, camera, plate, folder, composite):
    pictures = through_blender(camera.noisy, plate, folder / "noise.png", frames=(1, 2, 3))
    blender, ours = stds(pictures), stds(composite["noisy"])
    model = installed.state.camera_of(bpy.context.scene.active_clip).noise.std(np.array(GREYS))
    print("\nstd of the noise, 1/255, R G B:   model   Blender   composite")
    for row in zip(GREYS, 255 * model, 255 * blender, 255 * ours):
        print(f"luminance {row[0]}: " + "   ".join(" ".join(f"{v:.2f}" for v in of) for of in row[1:]))
    assert np.abs(blender / model - 1.0).max() < NOISE_SHARE
    assert np.abs(blender / ours - 1.0).max() < NOISE_SHARE
    # Each frame has its own, and each channel.
    square = PATCHES[2]
    inside = (slice(square.top + 10, square.top + square.side - 10), slice(square.left + 10, square.left + square.side - 10))
    flat = [(p[inside] - p[inside].mean(axis=(0, 1))).reshape(-1, 3) for p in pictures]
    together = np.corrcoef(np.hstack(flat[:2]).T)
    assert np.abs(together - np.eye(6)).max() < 0.2
    # Neighbours in place are as alike as in the composite: the spectrum.
    def likeness(pictures):
        values = [p[inside] - p[inside].mean(axis=(0, 1)) for p in pictures]
        return np.mean([(v[:, 1:] * v[:, :-1]).mean() / (v**2).mean() for v in values])

    print(f"correlation of neighbours: {likeness(pictures):.3f}, composite {likeness(composite['noisy']):.3f}")
    assert abs(likeness(pictures) - likeness(composite["noisy"])) < 0.05


def test_wrong_noise_is_told(installed, camera, plate, folder):
    spoil = lambda scene: setattr(scene.node_tree.nodes["blindaug grain"].inputs["Amount"], "default_value", 1.2)
    pictures = through_blender(camera.noisy, plate, folder / "wrong_noise.png", spoil, frames=(1, 2, 3))
    model = installed.state.camera_of(bpy.context.scene.active_clip).noise.std(np.array(GREYS))
    assert (stds(pictures) / model - 1.0).min() > NOISE_SHARE
