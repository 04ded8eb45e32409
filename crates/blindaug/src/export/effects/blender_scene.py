"""Sets Blender's scene to a camera: its shutter, its lens, and its noise in the compositor.

The text is part of the script that `blindaug export --to blender` writes, and a module of blindaug's add-on. A camera is a dictionary:

exposure: the share of the frame interval that the shutter is open; None where it is unknown
position: when it opens: "START" at the frame's time, "CENTER", or "END" when it has closed by then
sigma_px_at_infinity, focus_m: std of the blur at infinity, px of pictures `height` px high, and the distance in focus, m; None where the
    lens is unknown
blades, rotation, ratio, larger: the shape of out-of-focus points: the number of blades (0: a disk), their rotation in radians, how many times
    it is as high as wide, and by how much its diameter exceeds that of the disk of the same std
fov_y_degrees: the vertical field of view, degrees; None: the camera keeps its own
noise: None where it is unknown, else a dictionary
    slope, intercept: std of R, G and B in each octave, finest first, over encoded luminance Y: slope * Y + intercept
    clip: the encoded value from which on there is no noise
    gain, side, offsets: the image of the octaves is `side` px wide and holds 0.5 + gain n in R, G, B, A, n of std 1; R, G and B of the
        picture read it at offsets of their own
"""

import math

import bpy

# The names of what is made in the compositor.
PLATE = "blindaug plate"
FIT = "blindaug plate at the picture's size"
OVER = "blindaug over"
GRAIN = "blindaug grain"


def metres_per_unit(scene):
    units = scene.unit_settings
    return 1.0 if units.system == "NONE" else units.scale_length


def set_shutter(scene, camera):
    scene.render.use_motion_blur = True
    scene.render.motion_blur_shutter = camera["exposure"]
    # From 4.5 on for both engines, before for Cycles alone.
    for settings in (scene.render, getattr(scene, "cycles", None)):
        if hasattr(settings, "motion_blur_position"):
            settings.motion_blur_position = camera["position"]


def set_lens(scene, camera):
    """Sets the lens of the scene's camera, or says in a sentence why that cannot be."""
    if scene.camera is None or scene.camera.type != "CAMERA":
        return "depth of field is not set: the scene has no camera"
    lens = scene.camera.data
    if lens.type != "PERSP":
        return f"depth of field is not set: {scene.camera.name} is not a perspective camera"
    if camera["fov_y_degrees"] is not None:
        lens.sensor_fit = "VERTICAL"
        lens.sensor_height = 24.0
        lens.lens = 0.5 * lens.sensor_height / math.tan(math.radians(0.5 * camera["fov_y_degrees"]))
    # The blur's diameter at infinity over the picture's height is (f / N) (f / h) / P: of the camera's own angle, whatever it is. Blender takes
    # the millimetres of a focal length as thousandths of a unit, whatever a unit is.
    focal = lens.lens / 1000.0
    focus = camera["focus_m"] / metres_per_unit(scene)
    frame = lens.view_frame(scene=scene)
    per_height = abs(frame[0].z) / (max(c.y for c in frame) - min(c.y for c in frame))
    # A Gaussian of the same std as a disk has a quarter of its diameter.
    diameter = camera["larger"] * 4.0 * camera["sigma_px_at_infinity"] / camera["height"]
    lens.dof.use_dof = True
    # An object in focus would be used instead of the distance.
    lens.dof.focus_object = None
    lens.dof.focus_distance = focus
    lens.dof.aperture_fstop = focal * per_height / (diameter * focus)
    lens.dof.aperture_blades = camera["blades"]
    lens.dof.aperture_rotation = camera["rotation"]
    lens.dof.aperture_ratio = camera["ratio"]
    return None


class Nodes:
    """Makes nodes in a tree, from the left to the right."""

    def __init__(self, tree):
        self.tree = tree

    def node(self, kind, **settings):
        made = self.tree.nodes.new(kind)
        made.location = (40.0 * len(self.tree.nodes), -12.0 * (len(self.tree.nodes) % 20))
        made.hide = True
        for name, value in settings.items():
            setattr(made, name, value)
        return made

    def connect(self, value, socket):
        if isinstance(value, (int, float)):
            socket.default_value = value
        else:
            self.tree.links.new(value, socket)

    def maths(self, operation, *values):
        made = self.node("CompositorNodeMath", operation=operation)
        for value, socket in zip(values, made.inputs):
            self.connect(value, socket)
        return made.outputs[0]

    def convert(self, image, source_space, target_space):
        made = self.node("CompositorNodeConvertColorSpace", from_color_space=source_space, to_color_space=target_space)
        self.connect(image, made.inputs[0])
        return made.outputs[0]


def grain_group(noise, bands):
    """A group of nodes that adds the noise to a picture, in encoded values. `bands`: the image of the octaves."""
    group = bpy.data.node_groups.new(GRAIN, "CompositorNodeTree")
    for name, kind, value in (
        ("Image", "NodeSocketColor", (0.0, 0.0, 0.0, 1.0)),
        ("Layer", "NodeSocketColor", (1.0, 1.0, 1.0, 1.0)),
        ("Amount", "NodeSocketFloat", 1.0),
    ):
        group.interface.new_socket(name, in_out="INPUT", socket_type=kind).default_value = value
    group.interface.new_socket("Image", in_out="OUTPUT", socket_type="NodeSocketColor")
    made = Nodes(group)
    entry = made.node("NodeGroupInput")
    encoded = made.node("CompositorNodeSeparateColor")
    made.connect(made.convert(entry.outputs["Image"], "Linear Rec.709", "sRGB"), encoded.inputs[0])
    values = [made.maths("MAXIMUM", encoded.outputs[c], 0.0) for c in range(3)]
    luma = made.maths("MULTIPLY", values[0], 0.299)
    luma = made.maths("MULTIPLY_ADD", values[1], 0.587, luma)
    luma = made.maths("MULTIPLY_ADD", values[2], 0.114, luma)
    # Where the layer has an alpha of a, 1 - a of the plate's own noise remains: sqrt(1 - (1 - a)^2) of the noise is missing.
    layer = made.node("CompositorNodeSeparateColor")
    made.connect(entry.outputs["Layer"], layer.inputs[0])
    through = made.maths("SUBTRACT", 1.0, layer.outputs[3])
    missing = made.maths("SUBTRACT", 1.0, made.maths("MULTIPLY", through, through))
    amount = made.maths("MULTIPLY", made.maths("SQRT", made.maths("MAXIMUM", missing, 0.0)), entry.outputs["Amount"])

    bands.colorspace_settings.name = "Non-Color"
    bands.alpha_mode = "CHANNEL_PACKED"
    tile = made.node("CompositorNodeImage", image=bands)
    # Another part of the tile for each frame: steps that share no factor with its side.
    frame = made.node("CompositorNodeSceneTime").outputs["Frame"]
    combined = made.node("CompositorNodeCombineColor")
    for c in range(3):
        moved = made.node("CompositorNodeTranslate")
        # Without a wrap the tile would cover side x side px only.
        moved.wrap_axis = "BOTH"
        made.connect(tile.outputs["Image"], moved.inputs["Image"])
        for axis, (name, step) in enumerate((("X", 197), ("Y", 331))):
            place = made.maths("MULTIPLY_ADD", frame, step, noise["offsets"][c][axis])
            made.connect(made.maths("MODULO", place, noise["side"]), moved.inputs[name])
        octaves = made.node("CompositorNodeSeparateColor")
        made.connect(moved.outputs["Image"], octaves.inputs[0])
        total = 0.0
        for level, (slope, intercept) in enumerate(zip(noise["slope"][c], noise["intercept"][c])):
            sigma = made.maths("MAXIMUM", made.maths("MULTIPLY_ADD", luma, slope, intercept), 0.0)
            band = made.maths("MULTIPLY_ADD", octaves.outputs[level], 1.0 / noise["gain"], -0.5 / noise["gain"])
            total = made.maths("MULTIPLY_ADD", sigma, band, total)
        # The sensor clips: no noise above, and none beyond.
        below = made.maths("LESS_THAN", values[c], noise["clip"])
        added = made.maths("MULTIPLY", made.maths("MULTIPLY", total, amount), below)
        noisy = made.maths("MINIMUM", made.maths("ADD", values[c], added), made.maths("MAXIMUM", values[c], noise["clip"]))
        made.connect(made.maths("MAXIMUM", noisy, 0.0), combined.inputs[c])
    made.connect(encoded.outputs[3], combined.inputs[3])
    made.connect(made.convert(combined.outputs[0], "sRGB", "Linear Rec.709"), made.node("NodeGroupOutput").inputs[0])
    return group


def compositor(scene):
    """The compositor's nodes, and the input of the node where the picture ends."""
    scene.use_nodes = True
    scene.render.use_compositing = True
    nodes = scene.node_tree.nodes
    end = next((n for n in nodes if n.type == "COMPOSITE"), None) or nodes.new("CompositorNodeComposite")
    if not end.inputs["Image"].is_linked:
        layers = next((n for n in nodes if n.type == "R_LAYERS"), None) or nodes.new("CompositorNodeRLayers")
        scene.node_tree.links.new(layers.outputs["Image"], end.inputs["Image"])
    return scene.node_tree, end.inputs["Image"]


def new_before(tree, socket, kind, name):
    """A new node at the left of an input's node, and the output that the input was linked to, which the node is to take."""
    node = tree.nodes.new(kind)
    node.name = node.label = name
    node.location = socket.node.location
    socket.node.location.x += 220.0
    return node, socket.links[0].from_socket


def show_as_it_is(scene):
    """Shows and saves encoded values as they are: those of a clip, and those that noise is added to."""
    scene.view_settings.view_transform = "Standard"
    scene.view_settings.look = "None"


def over_clip(scene, clip):
    """Puts the picture over a movie clip."""
    show_as_it_is(scene)
    tree, end = compositor(scene)
    # Without it the world would hide the clip.
    scene.render.film_transparent = True
    if OVER not in tree.nodes:
        if GRAIN in tree.nodes:
            end = tree.nodes[GRAIN].inputs["Image"]
        over, layer = new_before(tree, end, "CompositorNodeAlphaOver", OVER)
        plate = tree.nodes.new("CompositorNodeMovieClip")
        plate.name = plate.label = PLATE
        fit = tree.nodes.new("CompositorNodeScale")
        fit.name = fit.label = FIT
        fit.space = "RENDER_SIZE"
        fit.frame_method = "STRETCH"
        plate.location = (over.location.x - 440.0, over.location.y - 260.0)
        fit.location = (over.location.x - 220.0, over.location.y - 260.0)
        tree.links.new(plate.outputs["Image"], fit.inputs["Image"])
        tree.links.new(fit.outputs["Image"], over.inputs[1])
        tree.links.new(layer, over.inputs[2])
        tree.links.new(over.outputs["Image"], end)
        if GRAIN in tree.nodes:
            tree.links.new(layer, tree.nodes[GRAIN].inputs["Layer"])
    # Whoever has taken the node away goes without it.
    if PLATE in tree.nodes:
        tree.nodes[PLATE].clip = clip


def add_grain(scene, noise, bands):
    """Adds the noise to the picture, where it is over a clip only as far as the picture hides the clip's own."""
    show_as_it_is(scene)
    tree, end = compositor(scene)
    group = grain_group(noise, bands)
    if GRAIN in tree.nodes:
        old = tree.nodes[GRAIN].node_tree
        tree.nodes[GRAIN].node_tree = group
        if old is not None and old.users == 0:
            bpy.data.node_groups.remove(old)
        group.name = GRAIN
    else:
        grain, last = new_before(tree, end, "CompositorNodeGroup", GRAIN)
        grain.node_tree = group
        tree.links.new(last, grain.inputs["Image"])
        if OVER in tree.nodes:
            tree.links.new(tree.nodes[OVER].inputs[2].links[0].from_socket, grain.inputs["Layer"])
        tree.links.new(grain.outputs["Image"], end)


def set_scene(scene, camera, bands=None, clip=None):
    """Sets all that is known of a camera, and leaves the rest as it is in the scene.

    bands: the image of the noise's octaves. clip: a movie clip to put the picture over. Returns sentences on what could not be set.
    """
    problems = []
    if camera["exposure"] is not None:
        set_shutter(scene, camera)
    if camera["sigma_px_at_infinity"] is not None:
        problems.append(set_lens(scene, camera))
    if clip is not None:
        over_clip(scene, clip)
    if camera["noise"] is not None:
        add_grain(scene, camera["noise"], bands)
    return [problem for problem in problems if problem]
