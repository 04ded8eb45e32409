"""Estimates the camera of a movie clip, and sets Blender's scene to it."""

from . import operators, panel, state

CLASSES = (*state.CLASSES, *operators.CLASSES, *panel.CLASSES)


def register():
    from bpy.utils import register_class

    for cls in CLASSES:
        register_class(cls)
    state.register()


def unregister():
    from bpy.utils import unregister_class

    operators.stop()
    state.unregister()
    for cls in reversed(CLASSES):
        unregister_class(cls)
