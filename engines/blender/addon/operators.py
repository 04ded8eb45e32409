"""What the panel's buttons do."""

import functools
import json
import os

import blindaug
import bpy
from bpy_extras.io_utils import ExportHelper, ImportHelper

from . import footage, scene, state
from .job import Job
from .settings import Settings

# The estimate that runs in the background, of which there is one at a time.
RUNNING = []


def stop():
    """Ends the estimate in the background, when the add-on is turned off."""
    for job in RUNNING:
        job.cancel()
        job.wait(10.0)
    RUNNING.clear()


def says_errors(method):
    """Tells the user in one sentence what cannot be used, and changes nothing."""

    def tried(self, *args):
        try:
            return method(self, *args)
        except (ValueError, OSError) as error:
            self.report({"ERROR"}, " ".join(str(error).split()))
            return {"CANCELLED"}

    # Blender counts the parameters.
    if method.__code__.co_argcount == 2:
        return functools.wraps(method)(lambda self, context: tried(self, context))
    return functools.wraps(method)(lambda self, context, event: tried(self, context, event))


def apply(context, clip):
    """Sets the scene to the clip's camera, and keeps what could not be set."""
    camera = state.camera_of(clip)
    render = context.scene.render
    percent = render.resolution_percentage / 100.0
    size = (max(1, round(render.resolution_x * percent)), max(1, round(render.resolution_y * percent)))
    settings = Settings(camera, size)
    over = clip if clip.blindaug.over_clip else None
    problems = scene.set_scene(context.scene, settings.numbers, settings.bands(), over)
    aspect, clips = size[0] / size[1], camera.width / camera.height
    if abs(aspect / clips - 1.0) > 0.01:
        problems.append(
            f"pictures of {size[0]} x {size[1]} px have another shape than the clip of {camera.width} x {camera.height} px, which is stretched"
        )
    clip.blindaug.left = "\n".join(problems + settings.notes)


def clip_editors(context):
    return [area for window in context.window_manager.windows for area in window.screen.areas if area.type == "CLIP_EDITOR"]


class ClipOperator:
    """An operator on the clip of the clip editor."""

    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context):
        return state.clip_of(context) is not None


class CameraOperator(ClipOperator):
    """An operator that needs a camera."""

    @classmethod
    def poll(cls, context):
        clip = state.clip_of(context)
        if clip is None or not clip.blindaug.estimated:
            cls.poll_message_set("Estimate or load a camera first")
            return False
        return True


class BLINDAUG_OT_estimate(ClipOperator, bpy.types.Operator):
    """Estimate noise, motion blur and defocus from the clip's frames in the scene's range, and set the scene to them"""

    bl_idname = "blindaug.estimate"
    bl_label = "Estimate Camera"

    @classmethod
    def poll(cls, context):
        if RUNNING:
            cls.poll_message_set("An estimate is running; Esc stops it")
            return False
        return super().poll(context)

    def finish(self, context, clip, job):
        if job.error:
            raise ValueError(job.error)
        if job.camera is None:
            self.report({"INFO"}, "The estimate was stopped; nothing has changed")
            return {"CANCELLED"}
        state.set_camera(clip, job.camera)
        state.keep(job.camera)
        apply(context, clip)
        for warning in job.camera.warnings:
            self.report({"WARNING"}, warning)
        self.report({"INFO"}, f"Estimated; frames used: {job.camera.frames_used}")
        return {"FINISHED"}

    @says_errors
    def execute(self, context):
        clip = state.clip_of(context)
        job = Job(footage.footage_of(clip, context.scene))
        manager = context.window_manager
        manager.progress_begin(0, job.total)
        try:
            job.run(lambda done, total: manager.progress_update(done))
        finally:
            manager.progress_end()
        return self.finish(context, clip, job)

    @says_errors
    def invoke(self, context, event):
        if bpy.app.background:
            return self.execute(context)
        clip = state.clip_of(context)
        # Undo while it runs makes new data of the same names.
        self.clip = clip.name
        self.job = Job(footage.footage_of(clip, context.scene))
        self.job.start()
        RUNNING.append(self.job)
        manager = context.window_manager
        self.timer = manager.event_timer_add(0.2, window=context.window)
        manager.progress_begin(0, self.job.total)
        manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    @says_errors
    def modal(self, context, event):
        job = self.job
        if event.type == "ESC" and event.value == "PRESS":
            job.cancel()
            return {"RUNNING_MODAL"}
        if event.type != "TIMER":
            return {"PASS_THROUGH"}
        if job.running:
            hint = "stopping" if job.cancelled else "Esc stops it"
            context.window_manager.progress_update(job.done)
            for area in clip_editors(context):
                area.tag_redraw()
            context.workspace.status_text_set(f"Estimating {self.clip}: {job.done} of {job.total} frames; {hint}")
            return {"PASS_THROUGH"}
        self.tidy(context)
        clip = bpy.data.movieclips.get(self.clip)
        if clip is None:
            raise ValueError(f"{self.clip}: the clip was removed while it was estimated")
        return self.finish(context, clip, job)

    def tidy(self, context):
        context.window_manager.event_timer_remove(self.timer)
        context.window_manager.progress_end()
        context.workspace.status_text_set(None)
        if self.job in RUNNING:
            RUNNING.remove(self.job)

    def cancel(self, context):
        """Blender ends the operator, since another file is opened or the window closed."""
        self.job.cancel()
        self.tidy(context)


class BLINDAUG_OT_apply(CameraOperator, bpy.types.Operator):
    """Set the scene camera's lens, the render's shutter and the compositor to the camera; what is unknown stays as it is"""

    bl_idname = "blindaug.apply"
    bl_label = "Apply to Scene"

    @says_errors
    def execute(self, context):
        apply(context, state.clip_of(context))
        return {"FINISHED"}


class BLINDAUG_OT_load(ClipOperator, bpy.types.Operator, ImportHelper):
    """Load a camera.json, as blindaug or this add-on has written it"""

    bl_idname = "blindaug.load"
    bl_label = "Load Camera"
    filename_ext = ".json"
    filter_glob: bpy.props.StringProperty(default="*.json", options={"HIDDEN"})

    @says_errors
    def execute(self, context):
        state.set_camera(state.clip_of(context), blindaug.Camera.read(bpy.path.abspath(self.filepath)))
        return {"FINISHED"}


class BLINDAUG_OT_save(CameraOperator, bpy.types.Operator, ExportHelper):
    """Save the camera as camera.json, for the command line and other programs"""

    bl_idname = "blindaug.save"
    bl_label = "Save Camera"
    bl_options = {"REGISTER"}
    filename_ext = ".json"
    filter_glob: bpy.props.StringProperty(default="*.json", options={"HIDDEN"})

    @says_errors
    def execute(self, context):
        state.camera_of(state.clip_of(context)).write(bpy.path.abspath(self.filepath))
        return {"FINISHED"}


class BLINDAUG_OT_report(CameraOperator, bpy.types.Operator, ExportHelper):
    """Write a page with all that the estimate rests on"""

    bl_idname = "blindaug.report"
    bl_label = "Export Report"
    bl_options = {"REGISTER"}
    filename_ext = ".html"
    filter_glob: bpy.props.StringProperty(default="*.html", options={"HIDDEN"})

    @says_errors
    def execute(self, context):
        clip = state.clip_of(context)
        camera = state.kept(clip)
        if camera is None:
            raise ValueError(f"{clip.name}: its camera was not estimated since Blender was started; estimate it again for a report")
        path = bpy.path.abspath(self.filepath)
        camera.report(path)
        self.report({"INFO"}, f"Wrote {os.path.basename(path)}")
        return {"FINISHED"}


class BLINDAUG_OT_set_distance(CameraOperator, bpy.types.Operator):
    """Say how far away a place of the picture is, so that the lens is known in metres"""

    bl_idname = "blindaug.set_distance"
    bl_label = "Set Distance"

    place: bpy.props.EnumProperty(
        name="Place",
        items=[
            ("PICK", "Pick", "A place that is clicked on"),
            ("TRACK", "Track", "The active track's marker"),
            ("AT", "At", "The place X, Y"),
        ],
        options={"SKIP_SAVE"},
    )
    x: bpy.props.FloatProperty(name="X", description="Px from the left of the picture", options={"SKIP_SAVE"})
    y: bpy.props.FloatProperty(name="Y", description="Px from the top of the picture", options={"SKIP_SAVE"})

    def put(self, camera, u, v):
        """Takes a place of normalized coordinates, v up."""
        self.x, self.y = u * camera.width, (1.0 - v) * camera.height

    @says_errors
    def execute(self, context):
        clip = state.clip_of(context)
        camera = state.camera_of(clip)
        if self.place == "TRACK":
            track = clip.tracking.tracks.active
            if track is None:
                raise ValueError(f"{clip.name}: no track is active; select one")
            frame = depth_frame(clip, camera) or context.scene.frame_current
            marker = track.markers.find_frame(frame - clip.frame_start + 1)
            if marker is None or marker.mute:
                raise ValueError(f"{track.name}: it has no marker at frame {frame}, in which depth was found")
            self.put(camera, *marker.co)
        elif self.place == "PICK" and not self.properties.is_property_set("x"):
            raise ValueError("x, y: a place can be picked in the clip editor only")
        known = state.places_of(clip)[-1:] + ((self.x, self.y, clip.blindaug.distance),)
        # One that does not go with the first replaces it.
        tried = [known, known[-1:]]
        for places in tried:
            try:
                state.camera_from(clip.blindaug.estimated, places)
                break
            except blindaug.Error:
                if places == tried[-1]:
                    raise
        clip.blindaug.places.clear()
        for x, y, metres in places:
            place = clip.blindaug.places.add()
            place.x, place.y, place.metres = x, y, metres
        apply(context, clip)
        return {"FINISHED"}

    @says_errors
    def invoke(self, context, event):
        if self.place != "PICK" or bpy.app.background:
            return self.execute(context)
        clip = state.clip_of(context)
        frame = depth_frame(clip, state.camera_of(clip))
        if frame is not None:
            context.scene.frame_set(frame)
        context.window.cursor_modal_set("EYEDROPPER")
        context.workspace.status_text_set("Click on a place of the picture whose distance you know; Esc cancels")
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    @says_errors
    def modal(self, context, event):
        if event.value != "PRESS" or event.type not in {"LEFTMOUSE", "RIGHTMOUSE", "ESC"}:
            return {"PASS_THROUGH"} if event.type in {"MIDDLEMOUSE", "WHEELUPMOUSE", "WHEELDOWNMOUSE"} else {"RUNNING_MODAL"}
        context.window.cursor_modal_restore()
        context.workspace.status_text_set(None)
        if event.type != "LEFTMOUSE":
            return {"CANCELLED"}
        for area in clip_editors(context):
            for region in area.regions:
                x, y = event.mouse_x - region.x, event.mouse_y - region.y
                if region.type == "WINDOW" and 0 <= x < region.width and 0 <= y < region.height:
                    u, v = region.view2d.region_to_view(x, y)
                    if 0.0 <= u < 1.0 and 0.0 <= v < 1.0:
                        self.put(state.camera_of(state.clip_of(context)), u, v)
                        return self.execute(context)
        raise ValueError("this place is not in the clip's picture; press the button again")


def depth_frame(clip, camera):
    """The scene's frame in which the camera's depth was found, to which places belong; None if none was found."""
    depth = json.loads(camera.to_json()).get("scene_depth")
    return depth and footage.scene_frame(clip, depth["frame"])


class BLINDAUG_OT_clear_distances(CameraOperator, bpy.types.Operator):
    """Forget the places whose distance was set"""

    bl_idname = "blindaug.clear_distances"
    bl_label = "Clear Distances"

    @says_errors
    def execute(self, context):
        state.clip_of(context).blindaug.places.clear()
        return {"FINISHED"}


CLASSES = (
    BLINDAUG_OT_estimate,
    BLINDAUG_OT_apply,
    BLINDAUG_OT_load,
    BLINDAUG_OT_save,
    BLINDAUG_OT_report,
    BLINDAUG_OT_set_distance,
    BLINDAUG_OT_clear_distances,
)
