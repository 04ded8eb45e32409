"""All of it on one clip: estimated, brought to metres by a place, and an object rendered over the clip."""

import math
import os
from pathlib import Path

import bpy
import numpy as np
from conftest import DEMO, start_scene
from test_render import pixels, render

# The object's depth, m, between the camera and its focus at 4 m; its motion, m to the next frame.
DEPTH, MOTION = 2.2, 0.05


def add_object():
    """An evenly coloured ring that moves to the right before a camera, and a lamp."""
    camera = bpy.context.scene.camera
    camera.rotation_euler = (math.pi / 2, 0.0, 0.0)
    camera.data.sensor_width, camera.data.lens = 36.0, 50.0
    bpy.ops.object.light_add(type="SUN", rotation=(0.6, 0.3, 0.0))
    bpy.context.object.data.energy = 2.5
    bpy.ops.mesh.primitive_torus_add(major_radius=0.28, minor_radius=0.11, major_segments=96, minor_segments=48, rotation=(1.2, 0.4, 0.0))
    ring = bpy.context.object
    bpy.ops.object.shade_smooth()
    material = bpy.data.materials.new("blue")
    material.use_nodes = True
    material.node_tree.nodes["Principled BSDF"].inputs["Base Color"].default_value = (0.05, 0.25, 0.6, 1.0)
    ring.data.materials.append(material)
    for frame in (1, 5):
        ring.location = (0.12 + (frame - 3) * MOTION, DEPTH, 0.08)
        ring.keyframe_insert("location", frame=frame)
    for curve in ring.animation_data.action.fcurves:
        for key in curve.keyframe_points:
            key.interpolation = "LINEAR"
    world = bpy.data.worlds.new("grey")
    world.color = (0.25, 0.25, 0.25)
    bpy.context.scene.world = world


def fine_noise(picture, where):
    """The std of white noise of which a part of the picture has the differences of four neighbours, of which smooth shades have little."""
    part = picture[where]
    across = part[1:, 1:] - part[1:, :-1] - part[:-1, 1:] + part[:-1, :-1]
    return float(np.std(across)) / 2.0


def test_an_object_over_the_clip_looks_as_if_filmed(installed, tmp_path):
    folder = Path(os.environ.get("BLINDAUG_BLENDER_PICTURES", tmp_path))
    scene = start_scene()
    add_object()
    scene.render.engine = "CYCLES"
    scene.cycles.device = "CPU"
    scene.cycles.samples = 128
    scene.cycles.use_denoising = False
    clip = scene.active_clip = bpy.data.movieclips.load(str(DEMO / "frames/0001.png"))
    # Pasted on: over the clip alone.
    installed.scene.over_clip(scene, clip)
    pasted = pixels(render(scene, folder / "pasted.png", 3))
    assert bpy.ops.blindaug.estimate() == {"FINISHED"}
    clip.blindaug.distance = 2.5
    bpy.ops.blindaug.set_distance(place="AT", x=200.0, y=220.0)
    filmed = pixels(render(scene, folder / "filmed.png", 3))
    # A part of the ring with few shades.
    ring = (slice(102, 132), slice(100, 120))
    noise = [fine_noise(picture, ring) for picture in (pasted, filmed)]
    wanted = float(np.mean(installed.state.camera_of(clip).noise.std(float(filmed[ring].mean()))))
    print(f"\nfine noise on the object: pasted on {255 * noise[0]:.2f}, filmed {255 * noise[1]:.2f}, of all noise {255 * wanted:.2f} (1/255)")
    assert noise[0] < 0.3 * wanted and 0.6 * wanted < noise[1] < 1.2 * wanted
    # Its left edge, upright there, is blurred: the steepest step from a pixel to the next, of means over rows.
    steps = [np.abs(np.diff(p[113:124, 80:100].mean(axis=0), axis=0)).max() for p in (pasted, filmed)]
    print(f"steepest step at the ring's left edge: pasted on {steps[0]:.3f}, filmed {steps[1]:.3f}")
    assert steps[1] < 0.6 * steps[0]
