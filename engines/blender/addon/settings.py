"""A camera as what scene.py takes: the numbers and the image that are exported to Blender."""

import ast
import os
import tempfile

import bpy


class Settings:
    """`numbers`: as scene.py takes them. `notes`: a sentence each on what is unknown or cannot be set."""

    def __init__(self, camera, size):
        self._export = camera.export("blender", size=size)
        # The exported script has limits that the add-on has not.
        self.notes = [note for note in self._export.notes if not note.startswith("this script ")]
        script = next(iter(self._export.files.values()))
        numbers = next(
            node.value
            for node in ast.parse(script).body
            if isinstance(node, ast.Assign) and node.targets[0].id == "CAMERA"
        )
        self.numbers = ast.literal_eval(numbers)

    def bands(self):
        """The image of the noise's octaves, kept in the .blend file; None if the noise is unknown."""
        names = [name for name in self._export.files if name.endswith(".png")]
        if not names:
            return None
        image = bpy.data.images.get(names[0])
        if image is None or not image.has_data:
            with tempfile.TemporaryDirectory() as folder:
                self._export.write(folder)
                image = bpy.data.images.load(os.path.join(folder, names[0]))
                image.pack()
        return image
