"""Uses the add-on in Blender's window, with keys and clicks: run by window.sh.

Estimate in the background, undo, redo, a click on a place, Esc. Each step is a call of Blender's timer, which waits between them.
"""

import pathlib
import subprocess
import sys
import traceback

import bpy

ARCHIVE, FOLDER = map(pathlib.Path, sys.argv[sys.argv.index("--") + 1 :])
DEMO = pathlib.Path(__file__).resolve().parents[3] / "apps/cli/assets/demo"
# Where the tab of the sidebar is, px of the display.
TAB = (1043, 340)
# The place that is clicked on, px of the clip, and its distance, m.
PLACE, METRES = (200.0, 220.0), 2.5


def press(*arguments, after=0.0):
    """Moves the mouse or presses keys, after some seconds."""
    subprocess.Popen(["sh", "-c", f"sleep {after}; xdotool {' '.join(map(str, arguments))}"])


def shot(name):
    subprocess.run(["import", "-window", "root", str(FOLDER / f"{name}.png")], check=True)


def editor(kind="CLIP_EDITOR"):
    window = bpy.context.window_manager.windows[0]
    area = next(area for area in window.screen.areas if area.type == kind)
    return window, area, next(region for region in area.regions if region.type == "WINDOW")


def there(kind="CLIP_EDITOR"):
    window, area, region = editor(kind)
    return bpy.context.temp_override(window=window, area=area, region=region)


def state():
    """What undo is to bring back."""
    scene, clip = bpy.context.scene, bpy.data.movieclips[0]
    return round(scene.render.motion_blur_shutter, 4), scene.use_nodes, clip.blindaug.estimated != "", len(clip.blindaug.places)


def running():
    return sys.modules["bl_ext.user_default.blindaug"].operators.RUNNING


def steps():
    """Yields the seconds to wait before the next step."""
    if "bl_pkg" not in bpy.context.preferences.addons:
        bpy.ops.preferences.addon_enable(module="bl_pkg")
    bpy.ops.extensions.package_install_files(filepath=str(ARCHIVE), repo="user_default", enable_on_install=True)
    # The splash screen goes.
    press("mousemove 640 60 click 1 key Escape")
    yield 3.0
    window = bpy.context.window_manager.windows[0]
    area = max(window.screen.areas, key=lambda area: area.width * area.height)
    area.type = "CLIP_EDITOR"
    clip = bpy.data.movieclips.load(str(DEMO / "frames/0001.png"))
    area.spaces[0].clip = bpy.context.scene.active_clip = clip
    area.spaces[0].show_region_ui = True
    scene = bpy.context.scene
    scene.render.resolution_x = scene.render.resolution_y = 272
    with there():
        bpy.ops.clip.view_all()
    bpy.ops.ed.undo_push(message="clip")
    yield 2.0
    press("mousemove", *TAB, "click 1")
    yield 3.0

    before = state()
    with there():
        assert bpy.ops.blindaug.estimate("INVOKE_DEFAULT") == {"RUNNING_MODAL"}
        assert not bpy.ops.blindaug.estimate.poll()
    pictures = 0
    while running():
        yield 0.5
        if running():
            pictures += 1
            shot(f"running_{pictures}")
    yield 2.0
    shot("estimated")
    after = state()
    assert before == (0.5, False, False, 0) and after == (0.69, True, True, 0), (before, after)
    with there():
        bpy.ops.ed.undo()
    assert state() == before, state()
    with there():
        bpy.ops.ed.redo()
    assert state() == after, state()
    yield 1.0

    bpy.data.movieclips[0].blindaug.distance = METRES
    with there():
        assert bpy.ops.blindaug.set_distance("INVOKE_DEFAULT", place="PICK") == {"RUNNING_MODAL"}
    window, _, region = editor()
    x, y = region.view2d.view_to_region(PLACE[0] / 272.0, 1.0 - PLACE[1] / 272.0)
    press("mousemove", region.x + x, window.height - (region.y + y), "sleep 1 click 1", after=1.0)
    yield 5.0
    shot("in_metres")
    [place] = bpy.data.movieclips[0].blindaug.places
    assert abs(place.x - PLACE[0]) < 3.0 and abs(place.y - PLACE[1]) < 3.0 and place.metres == METRES, (place.x, place.y)
    dof = bpy.context.scene.camera.data.dof
    assert dof.use_dof and 3.0 < dof.focus_distance < 6.0, dof.focus_distance
    with there():
        bpy.ops.ed.undo()
    assert state() == after and not bpy.context.scene.camera.data.dof.use_dof
    yield 1.0

    estimated = bpy.data.movieclips[0].blindaug.estimated
    bpy.context.scene.frame_end = 4
    with there():
        bpy.ops.blindaug.estimate("INVOKE_DEFAULT")
    press("key Escape", after=0.3)
    while running():
        yield 0.3
    yield 1.0
    # An estimate of four frames would be another one.
    assert bpy.data.movieclips[0].blindaug.estimated == estimated

    _, area, _ = editor()
    area.type, area.ui_type = "NODE_EDITOR", "CompositorNodeTree"
    yield 2.0
    with there("NODE_EDITOR"):
        bpy.ops.node.view_all()
    yield 2.0
    shot("nodes")
    (FOLDER / "passed").touch()


STEPS = steps()


def step():
    try:
        return next(STEPS)
    except StopIteration:
        pass
    except Exception:
        traceback.print_exc()
    bpy.ops.wm.quit_blender()


bpy.app.timers.register(step, first_interval=4.0)
