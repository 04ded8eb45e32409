"""Puts a layer that `blindaug composite --layer` wrote over its plate in Blender's compositor, and compares that with `composite`.

    python over.py PLATE.exr LAYER.exr COMPOSITE.exr OUT.exr
"""

import sys

import bpy
import numpy as np

plate, layer, composite, out = sys.argv[1:]
scene = bpy.context.scene
scene.use_nodes = True
scene.view_settings.view_transform = "Raw"
tree = scene.node_tree
tree.nodes.clear()


def image(path):
    node = tree.nodes.new("CompositorNodeImage")
    node.image = bpy.data.images.load(path)
    if node.image.type != "MULTILAYER":
        node.image.colorspace_settings.name = "Linear Rec.709"
    return node


def output(node, *names):
    """The output whose name is the first of these that there is."""
    for name in names:
        for socket in node.outputs:
            if socket.name == name and socket.enabled:
                return socket
    sys.exit(f"no output {names}; there are {[s.name for s in node.outputs]}")


def made(with_noise):
    """The pixels of the layer over the plate, plus its noise."""
    for node in list(tree.nodes):
        tree.nodes.remove(node)
    under, over = image(plate), image(layer)
    print("outputs:", [s.name for s in over.outputs])
    alpha_over = tree.nodes.new("CompositorNodeAlphaOver")
    tree.links.new(output(under, "Image", "Combined"), alpha_over.inputs[1])
    tree.links.new(output(over, "Combined", "Image"), alpha_over.inputs[2])
    last = alpha_over.outputs[0]
    if with_noise:
        add = tree.nodes.new("CompositorNodeMixRGB")
        add.blend_type = "ADD"
        tree.links.new(last, add.inputs[1])
        tree.links.new(output(over, "noise"), add.inputs[2])
        last = add.outputs[0]
    tree.links.new(last, tree.nodes.new("CompositorNodeComposite").inputs[0])
    width, height = under.image.size
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = width, height, 100
    scene.render.image_settings.file_format = "OPEN_EXR"
    scene.render.image_settings.color_depth = "32"
    scene.render.filepath = out
    bpy.ops.render.render(write_still=True)
    return pixels(out)


def pixels(path):
    loaded = bpy.data.images.load(path)
    loaded.colorspace_settings.name = "Linear Rec.709"
    values = np.array(loaded.pixels[:], dtype=np.float32).reshape(-1, 4)[:, :3]
    bpy.data.images.remove(loaded)
    return values


want, under = pixels(composite), pixels(plate)
# A half float has 11 significant bits; the layer's colour, its alpha and the noise are each rounded.
tolerance = 3 * 2.0**-11 * np.maximum(np.maximum(want, under), 0.01)
wrong = {noise: np.max(np.abs(made(noise) - want) / tolerance) for noise in (True, False)}
changed = np.mean(np.any(np.abs(want - under) > 0.01, axis=1))
print(f"largest difference: {wrong[True]:.2f} of the tolerance; without the noise {wrong[False]:.2f}; the object covers {100 * changed:.0f} %")
if not (wrong[True] <= 1.0 < wrong[False] and changed > 0.02):
    sys.exit("the layer over the plate is not the composite")
