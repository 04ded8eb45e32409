"""What a movie clip keeps of its estimate, in the .blend file."""

import functools

import blindaug
import bpy


class BLINDAUG_PG_place(bpy.types.PropertyGroup):
    """A place of the picture whose distance is known."""

    x: bpy.props.FloatProperty(name="X", description="px from the left")
    y: bpy.props.FloatProperty(name="Y", description="px from the top")
    metres: bpy.props.FloatProperty(name="Distance")


class BLINDAUG_PG_clip(bpy.types.PropertyGroup):
    """The camera of a clip."""

    estimated: bpy.props.StringProperty(description="The camera as it was estimated or loaded, as the text of camera.json")
    places: bpy.props.CollectionProperty(type=BLINDAUG_PG_place)
    left: bpy.props.StringProperty(description="What could not be set in the scene, a sentence in each line")
    distance: bpy.props.FloatProperty(
        name="Distance",
        description="Distance of the place from the camera along the view, in metres",
        default=2.0,
        min=0.001,
        soft_max=100.0,
        precision=3,
    )
    over_clip: bpy.props.BoolProperty(
        name="Over the Clip",
        description="Put the rendered picture over this clip in the compositor",
        default=True,
    )


CLASSES = (BLINDAUG_PG_place, BLINDAUG_PG_clip)

# The cameras of this session with what their estimates rest on, for reports, by their text.
KEPT = {}


def register():
    bpy.types.MovieClip.blindaug = bpy.props.PointerProperty(type=BLINDAUG_PG_clip)


def unregister():
    del bpy.types.MovieClip.blindaug
    KEPT.clear()
    camera_from.cache_clear()


@functools.lru_cache(maxsize=8)
def camera_from(text, places):
    camera = blindaug.Camera.from_json(text)
    return camera.to_metric(at=list(places)) if places else camera


def places_of(clip):
    return tuple((place.x, place.y, place.metres) for place in clip.blindaug.places)


def camera_of(clip):
    """The camera of a clip, in metres where a distance is known; None if there is none yet. Raises blindaug.Error."""
    text = clip.blindaug.estimated
    return camera_from(text, places_of(clip)) if text else None


def set_camera(clip, camera):
    """Makes a camera, estimated or read, the clip's."""
    clip.blindaug.estimated = camera.to_json()
    clip.blindaug.places.clear()
    clip.blindaug.left = ""


def keep(camera):
    # One estimate's frames are enough memory.
    KEPT.clear()
    KEPT[camera.to_json()] = camera


def kept(clip):
    return KEPT.get(clip.blindaug.estimated)


def clip_of(context):
    """The clip of the clip editor; else the scene's."""
    return getattr(context, "edit_movieclip", None) or context.scene.active_clip
