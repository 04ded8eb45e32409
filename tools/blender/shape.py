"""Renders a point behind the focus through the camera that `blindaug export --to blender` wrote, and compares its image with the model's shape.

    python shape.py CAMERA.py BLADES ROTATION SQUEEZE    # BLADES 0: a disk; ROTATION in degrees, clockwise, of a corner that is on top

The stds along x and y must be those of the model, and the corners lie where it has them. Needs Blender as a module: pip install bpy==4.5.15 (Python
3.11).
"""
import importlib.util
import math
import sys
import tempfile

import bpy
import numpy as np

SIZE = 192
# The std of the blur at infinity, px.
SIGMA = 6.0


def render(script):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    distance = 200.0 * script.CAMERA["focus_m"]
    # So small that its sharp image spans 2 px.
    bpy.ops.mesh.primitive_uv_sphere_add(radius=0.004 * distance, location=(0.0, distance, 0.0))
    material = bpy.data.materials.new("light")
    material.use_nodes = True
    tree = material.node_tree
    tree.nodes.clear()
    light, output = tree.nodes.new("ShaderNodeEmission"), tree.nodes.new("ShaderNodeOutputMaterial")
    light.inputs["Strength"].default_value = 100.0
    tree.links.new(light.outputs["Emission"], output.inputs["Surface"])
    bpy.context.object.data.materials.append(material)
    bpy.ops.object.camera_add(rotation=(math.pi / 2, 0.0, 0.0))
    scene.camera = bpy.context.object
    scene.render.engine = "CYCLES"
    scene.cycles.device, scene.cycles.use_denoising, scene.cycles.samples = "CPU", False, 3000
    scene.cycles.use_adaptive_sampling = False
    scene.cycles.filter_width = 1.0
    scene.render.resolution_x = scene.render.resolution_y = SIZE
    # A blur in which the shape is seen, in pictures of this height, and no grain.
    script.CAMERA.update(height=SIZE, sigma_px_at_infinity=SIGMA, noise=None)
    script.apply(scene)
    scene.render.image_settings.file_format, scene.render.image_settings.color_depth = "OPEN_EXR", "32"
    with tempfile.TemporaryDirectory() as folder:
        scene.render.filepath = folder + "/point.exr"
        bpy.ops.render.render(write_still=True)
        image = bpy.data.images.load(scene.render.filepath)
        pixels = np.array(image.pixels[:]).reshape(SIZE, SIZE, 4)
    # Blender's rows go from the bottom up.
    return pixels[::-1, :, 0]


def main():
    path, blades, rotation, squeeze = sys.argv[1], int(sys.argv[2]), float(sys.argv[3]), float(sys.argv[4])
    spec = importlib.util.spec_from_file_location("camera", path)
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    picture = render(script)
    y, x = np.mgrid[:SIZE, :SIZE].astype(float)
    weight = picture / picture.sum()
    x, y = x - (weight * x).sum(), y - (weight * y).sum()
    stds = [math.sqrt((weight * v * v).sum()) for v in (x, y)]
    sigma = SIGMA * (1.0 - 1.0 / 200.0)
    want = [sigma * math.sqrt(2.0 / (1.0 + squeeze**2)) * s for s in (1.0, squeeze)]
    print(f"stds {stds[0]:.2f} x {stds[1]:.2f} px, of the model {want[0]:.2f} x {want[1]:.2f} px")
    wrong = [abs(a / b - 1.0) > 0.03 for a, b in zip(stds, want)]
    if blades:
        # The shape is turned before it is stretched. Its harmonic of as many periods as blades is in phase at the corners.
        x, y = x / want[0], y / want[1]
        angle, radius = np.arctan2(x, -y), np.hypot(x, y)
        phase = np.angle((weight * radius**blades * np.exp(1j * blades * angle)).sum()) / blades
        sector = 360.0 / blades
        off = (math.degrees(phase) - rotation + 0.5 * sector) % sector - 0.5 * sector
        print(f"corners {off:+.1f} degrees from the model's")
        wrong.append(abs(off) > 2.0)
    sys.exit(any(wrong))


if __name__ == "__main__":
    main()
