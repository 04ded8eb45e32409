"""Renders a clip through the camera that `blindaug export --to blender` wrote, and its sharp depth.

    python render.py CAMERA.py OUT        # frames/NNNN.png and depth/NNNN.exr, 512 x 384 px

Needs Blender as a module: pip install bpy==4.5.15 (Python 3.11).
"""
import importlib.util
import math
import os
import random
import sys

import bpy

FRAMES = 5
# The samples per px: enough for the render's own noise to be a tenth of the camera's.
SAMPLES = 128


def surface(seed, scale):
    """An evenly lit surface with texture at all scales."""
    material = bpy.data.materials.new(f"surface{seed}")
    material.use_nodes = True
    tree = material.node_tree
    tree.nodes.clear()
    rng = random.Random(seed)
    coordinates = tree.nodes.new("ShaderNodeTexCoord")
    noise = tree.nodes.new("ShaderNodeTexNoise")
    noise.noise_dimensions = "4D"
    noise.inputs["W"].default_value = seed
    noise.inputs["Scale"].default_value = scale
    noise.inputs["Detail"].default_value = 12.0
    noise.inputs["Roughness"].default_value = 0.72
    ramp = tree.nodes.new("ShaderNodeValToRGB")
    low, high = ramp.color_ramp.elements
    low.position, high.position = 0.36, 0.64
    low.color = [rng.uniform(0.01, 0.06) for _ in range(3)] + [1.0]
    high.color = [rng.uniform(0.35, 0.75) for _ in range(3)] + [1.0]
    light = tree.nodes.new("ShaderNodeEmission")
    output = tree.nodes.new("ShaderNodeOutputMaterial")
    tree.links.new(coordinates.outputs["Object"], noise.inputs["Vector"])
    tree.links.new(noise.outputs["Fac"], ramp.inputs["Fac"])
    tree.links.new(ramp.outputs["Color"], light.inputs["Color"])
    tree.links.new(light.outputs["Emission"], output.inputs["Surface"])
    return material


def build():
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    rng = random.Random(3)
    # The scene is a wall 9 m away, and blocks from 1.2 m on.
    for i, (x, z, depth, size) in enumerate(
        [(0.0, 0.0, 9.0, 14.0)]
        + [(rng.uniform(-0.45, 0.45) * d, rng.uniform(-0.3, 0.3) * d, d, 0.28 * d) for d in (1.2, 1.6, 2.1, 2.8, 3.8, 5.2, 7.0)]
    ):
        bpy.ops.mesh.primitive_cube_add(size=size, location=(x, depth + 0.5 * size, z), rotation=(0.0, 0.0, 0.0))
        bpy.context.object.data.materials.append(surface(i, 18.0 / depth))
    bpy.ops.object.camera_add(rotation=(math.pi / 2, 0.0, 0.0))
    camera = bpy.context.object
    scene.camera = camera
    camera.data.sensor_width, camera.data.lens = 36.0, 40.0
    # The camera moves sideways and turns slightly, so that near and far things move, but differently.
    for frame in (1, FRAMES + 1):
        t = frame - 1
        camera.location = (0.035 * t, 0.0, 0.012 * t)
        camera.rotation_euler = (math.pi / 2, 0.0, -0.012 * t)
        camera.keyframe_insert("location", frame=frame)
        camera.keyframe_insert("rotation_euler", frame=frame)
    for curve in camera.animation_data.action.fcurves:
        curve.extrapolation = "LINEAR"
        for key in curve.keyframe_points:
            key.interpolation = "LINEAR"
    scene.render.engine = "CYCLES"
    scene.cycles.device = "CPU"
    scene.cycles.use_denoising = False
    scene.cycles.pixel_filter_type = "BLACKMAN_HARRIS"
    scene.cycles.filter_width = 1.2
    scene.render.resolution_x, scene.render.resolution_y = 512, 384
    scene.view_settings.view_transform = "Standard"
    return scene


def render(scene, path, file_format, color_depth, samples):
    scene.cycles.samples = samples
    scene.render.image_settings.file_format = file_format
    scene.render.image_settings.color_depth = color_depth
    for frame in range(1, FRAMES + 1):
        scene.frame_set(frame)
        scene.render.filepath = os.path.join(path, f"{frame:04}")
        bpy.ops.render.render(write_still=True)
        print(f"rendered {scene.render.filepath}", file=sys.stderr, flush=True)


def main(camera_script, out):
    scene = build()
    scene.view_layers[0].use_pass_z = True
    render(scene, os.path.join(out, "depth"), "OPEN_EXR_MULTILAYER", "32", 1)
    spec = importlib.util.spec_from_file_location("camera", camera_script)
    camera = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(camera)
    camera.apply(scene)
    scene.view_layers[0].use_pass_z = False
    # Blender's own dither is noise too.
    scene.render.dither_intensity = 0.0
    render(scene, os.path.join(out, "frames"), "PNG", "8", SAMPLES)


if __name__ == "__main__":
    main(*sys.argv[1:])
    # Blender's module can hang while it shuts down.
    sys.stdout.flush()
    os._exit(0)
