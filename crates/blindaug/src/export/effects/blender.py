import math
import os

import bpy

# Fraction of the frame interval that the shutter is open; None where it is unknown.
EXPOSURE = @exposure@
# Std of the blur at infinity in px of pictures HEIGHT px high, and the distance in focus in m.
SIGMA_PX_AT_INFINITY = @sigma@
FOCUS_M = @focus@
HEIGHT = @height@
# The shape of out-of-focus points: the number of blades (0: a disk), their rotation in radians, how many times it is as high as wide, and by how
# much its diameter exceeds that of the disk of the same std.
BLADES = @blades@
ROTATION = @rotation@
RATIO = @ratio@
LARGER = @larger@
# Vertical field of view in degrees; None: the camera keeps its own.
FOV_Y = @fov@
# Std of the noise's octaves, finest first, over encoded luminance Y, for R, G and B: slope * Y + intercept.
SLOPE = @slope@
INTERCEPT = @intercept@
CLIP = @clip@
# The octaves, in R, G, B, A, as 0.5 + GAIN n; each channel reads them at its own offset.
BANDS = "@bands@"
GAIN = @gain@
SIDE = @side@
OFFSETS = [@offsets@]


def set_shutter(scene):
    scene.render.use_motion_blur = True
    scene.render.motion_blur_shutter = EXPOSURE
    # From 4.5 on for both engines, before for Cycles alone.
    for settings in (scene.render, getattr(scene, "cycles", None)):
        if hasattr(settings, "motion_blur_position"):
            settings.motion_blur_position = "CENTER"


def set_lens(scene, camera):
    if FOV_Y is not None:
        camera.sensor_fit = "VERTICAL"
        camera.sensor_height = 24.0
        camera.lens = 0.5 * camera.sensor_height / math.tan(math.radians(0.5 * FOV_Y))
    # The blur's diameter at infinity over the picture's height is (f / N) (f / h) / P: of the camera's own angle, whatever it is.
    focal_m = camera.lens / 1000.0
    per_height = 0.5 / math.tan(0.5 * angle_y(scene, camera))
    # A Gaussian of the same std as a disk has a quarter of its diameter.
    diameter = LARGER * 4.0 * SIGMA_PX_AT_INFINITY / HEIGHT
    camera.dof.use_dof = True
    camera.dof.focus_distance = FOCUS_M
    camera.dof.aperture_fstop = focal_m * per_height / (diameter * FOCUS_M)
    camera.dof.aperture_blades = BLADES
    camera.dof.aperture_rotation = ROTATION
    camera.dof.aperture_ratio = RATIO


def angle_y(scene, camera):
    frame = camera.view_frame(scene=scene)
    height = max(c.y for c in frame) - min(c.y for c in frame)
    return 2.0 * math.atan(0.5 * height / abs(frame[0].z))


def add_grain(scene):
    """Adds the noise to the picture, in encoded values: view transform "Standard" shows and saves it as it is."""
    scene.view_settings.view_transform = "Standard"
    scene.use_nodes = True
    scene.render.use_compositing = True
    tree = scene.node_tree
    output = next((n for n in tree.nodes if n.type == "COMPOSITE"), None) or tree.nodes.new("CompositorNodeComposite")
    socket = output.inputs["Image"]
    if socket.is_linked:
        source = socket.links[0].from_socket
    else:
        source = tree.nodes.new("CompositorNodeRLayers").outputs["Image"]

    def node(kind, **settings):
        made = tree.nodes.new("CompositorNode" + kind)
        for name, value in settings.items():
            setattr(made, name, value)
        return made

    def connect(value, input):
        if isinstance(value, (int, float)):
            input.default_value = value
        else:
            tree.links.new(value, input)

    def maths(operation, *values):
        made = node("Math", operation=operation)
        for value, input in zip(values, made.inputs):
            connect(value, input)
        return made.outputs[0]

    def convert(image, source_space, target_space):
        made = node("ConvertColorSpace")
        made.from_color_space = source_space
        made.to_color_space = target_space
        connect(image, made.inputs[0])
        return made.outputs[0]

    encoded = node("SeparateColor")
    connect(convert(source, "Linear Rec.709", "sRGB"), encoded.inputs[0])
    values = [maths("MAXIMUM", encoded.outputs[c], 0.0) for c in range(3)]
    luma = maths("MULTIPLY", values[0], 0.299)
    luma = maths("MULTIPLY_ADD", values[1], 0.587, luma)
    luma = maths("MULTIPLY_ADD", values[2], 0.114, luma)

    folder = os.path.dirname(bpy.path.abspath(__file__)) if "__file__" in globals() else bpy.path.abspath("//")
    image = bpy.data.images.load(os.path.join(folder, BANDS), check_existing=True)
    image.colorspace_settings.name = "Non-Color"
    image.alpha_mode = "CHANNEL_PACKED"
    combined = node("CombineColor")
    for c in range(3):
        tile = node("Image", image=image)
        moved = node("Translate")
        # Without a wrap the tile would cover SIDE x SIDE px only.
        moved.wrap_axis = "BOTH"
        tree.links.new(tile.outputs["Image"], moved.inputs["Image"])
        for axis, (input, step) in enumerate((("X", 197), ("Y", 331))):
            # Another part of the tile for each frame: steps that share no factor with its side.
            driver = moved.inputs[input].driver_add("default_value").driver
            driver.expression = f"(frame * {step} + {OFFSETS[c][axis]}) % {SIDE}"
        octaves = node("SeparateColor")
        tree.links.new(moved.outputs["Image"], octaves.inputs[0])
        noise = 0.0
        for level in range(4):
            sigma = maths("MAXIMUM", maths("MULTIPLY_ADD", luma, SLOPE[c][level], INTERCEPT[c][level]), 0.0)
            band = octaves.outputs[level]
            noise = maths("MULTIPLY_ADD", sigma, maths("MULTIPLY_ADD", band, 1.0 / GAIN, -0.5 / GAIN), noise)
        # None where the sensor clips.
        noise = maths("MULTIPLY", noise, maths("LESS_THAN", values[c], CLIP))
        noisy = maths("MAXIMUM", maths("ADD", values[c], noise), 0.0)
        connect(noisy, combined.inputs[c])
    connect(encoded.outputs[3], combined.inputs[3])
    connect(convert(combined.outputs[0], "sRGB", "Linear Rec.709"), socket)


def apply(scene):
    if EXPOSURE is not None:
        set_shutter(scene)
    if SIGMA_PX_AT_INFINITY is not None and scene.camera:
        set_lens(scene, scene.camera.data)
    if SLOPE is not None:
        add_grain(scene)


if __name__ == "__main__":
    apply(bpy.context.scene)
