"""The files and frames of a movie clip."""

import os
import re
from typing import NamedTuple

import bpy


class Footage(NamedTuple):
    """What is estimated: a video, or images of one name with a number each."""

    path: str
    # The numbers of the first and of the last frame: of a video from 1 on, of images those of their names.
    first: int
    last: int
    # Frames per second; None: as the file says.
    fps: float | None


def numbered(path):
    """The path with # for the digits of its number, and the number; of a name without a number None and 1."""
    folder, name = os.path.split(path)
    stem, extension = os.path.splitext(name)
    found = re.fullmatch(r"(.*?)(\d+)(\D*)", stem)
    if found is None:
        return None, 1
    before, digits, after = found.groups()
    return os.path.join(folder, f"{before}{'#' * len(digits)}{after}{extension}"), int(digits)


def first_number(clip):
    return numbered(clip.filepath)[1] if clip.source == "SEQUENCE" else 1


def scene_frame(clip, number):
    """The scene's frame at which the clip shows its frame of this number."""
    return number - first_number(clip) - clip.frame_offset + clip.frame_start


def footage_of(clip, scene):
    """The footage of those frames of a clip that lie in the scene's range. Raises ValueError with a sentence."""
    path = os.path.normpath(bpy.path.abspath(clip.filepath, library=clip.library))
    if not os.path.isfile(path):
        raise ValueError(f"{path}: there is no such file; choose the clip's file again")
    preview = scene.use_preview_range
    start, end = (scene.frame_preview_start, scene.frame_preview_end) if preview else (scene.frame_start, scene.frame_end)
    number = first_number(clip)
    # What lies before the scene's first frame is the first frame, held.
    offset = number - clip.frame_start + clip.frame_offset
    first, last = max(start + offset, number), min(end + offset, number + clip.frame_duration - 1)
    if first > last:
        raise ValueError(f"{clip.name}: none of its frames lies in the scene's range of frames, {start} to {end}")
    if clip.source == "SEQUENCE":
        pattern, _ = numbered(path)
        return Footage(pattern or path, first, last, scene.render.fps / scene.render.fps_base)
    return Footage(path, first, last, None)
