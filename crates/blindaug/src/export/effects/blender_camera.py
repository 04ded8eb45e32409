

# What is set.
CAMERA = {
    "exposure": @exposure@,
    "position": @position@,
    "sigma_px_at_infinity": @sigma@,
    "focus_m": @focus@,
    "blades": @blades@,
    "rotation": @rotation@,
    "ratio": @ratio@,
    "larger": @larger@,
    "height": @height@,
    "fov_y_degrees": @fov@,
    "noise": @noise@,
}
# The image of the noise's octaves, in the folder of this script.
BANDS = "@bands@"


def apply(scene):
    import os

    folder = os.path.dirname(bpy.path.abspath(__file__)) if "__file__" in globals() else bpy.path.abspath("//")
    bands = CAMERA["noise"] and bpy.data.images.load(os.path.join(folder, BANDS), check_existing=True)
    for problem in set_scene(scene, CAMERA, bands):
        print(problem)


if __name__ == "__main__":
    apply(bpy.context.scene)
