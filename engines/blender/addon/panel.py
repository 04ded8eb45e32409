"""The panel in the sidebar of the clip editor."""

import textwrap

import blindaug
import bpy

from . import operators, state, words


def sentences(layout, text, icon, width):
    """A text in lines that fit."""
    column = layout.column(align=True)
    for i, line in enumerate(textwrap.wrap(text, width)):
        column.label(text=line, icon=icon if i == 0 else "BLANK1")


class BLINDAUG_PT_camera(bpy.types.Panel):
    bl_label = "Camera's Noise and Blur"
    bl_space_type = "CLIP_EDITOR"
    bl_region_type = "UI"
    bl_category = "blindaug"

    @classmethod
    def poll(cls, context):
        return state.clip_of(context) is not None

    def draw(self, context):
        layout, clip = self.layout, state.clip_of(context)
        # Letters are about 7 px wide at the usual scale of the interface, which is 0 without a window.
        letter = 7.0 * (context.preferences.system.ui_scale or 1.0)
        width = max(20, int(context.region.width / letter) - 6)
        column = layout.column(align=True)
        column.operator("blindaug.estimate", icon="CAMERA_DATA")
        for job in operators.RUNNING:
            text = f"{job.done} of {job.total} frames; Esc stops it"
            column.progress(text=text, factor=min(job.done / job.total, 1.0))
        row = column.row(align=True)
        row.operator("blindaug.load", text="Load", icon="FILE_FOLDER")
        row.operator("blindaug.save", text="Save", icon="FILE_TICK")
        row.operator("blindaug.report", text="Report", icon="TEXT")
        try:
            camera = state.camera_of(clip)
        except blindaug.Error as error:
            sentences(layout, str(error), "ERROR", width)
            return
        if camera is None:
            return
        box = layout.box().column(align=True)
        for row in words.rows(camera):
            if row.value is None:
                box.label(text=f"{row.name}: unknown", icon="QUESTION")
                sentences(box, row.why, "BLANK1", width)
            else:
                split = box.split(factor=0.4)
                split.label(text=row.name)
                split.label(text=row.value)
                if row.interval:
                    split = box.split(factor=0.4)
                    split.label(text="")
                    split.label(text=row.interval)
        for warning in camera.warnings:
            sentences(layout, warning, "ERROR", width)
        if camera.defocus.known and (camera.defocus.depth_kind == "relative" or clip.blindaug.places):
            self.draw_scale(layout, clip)
        column = layout.column(align=True)
        column.prop(clip.blindaug, "over_clip")
        column.operator("blindaug.apply", icon="SCENE_DATA")
        for sentence in clip.blindaug.left.splitlines():
            sentences(layout, sentence, "INFO", width)

    def draw_scale(self, layout, clip):
        column = layout.column(align=True)
        column.label(text="A place whose distance is known:")
        column.prop(clip.blindaug, "distance", text="Metres")
        row = column.row(align=True)
        row.operator("blindaug.set_distance", text="Pick", icon="EYEDROPPER").place = "PICK"
        row.operator("blindaug.set_distance", text="Active Track", icon="TRACKER").place = "TRACK"
        for place in clip.blindaug.places:
            column.label(text=f"{place.x:.0f}, {place.y:.0f} px: {place.metres:.3g} m", icon="CHECKMARK")
        if clip.blindaug.places:
            column.operator("blindaug.clear_distances", text="Clear", icon="X")


CLASSES = (BLINDAUG_PT_camera,)
