"""The add-on: its archive, estimates beside the command line's, what is unknown, bad input, the background."""

import json
import shutil
import subprocess
import time
import tomllib
import zipfile
from types import SimpleNamespace

import bpy
import numpy as np
import pytest
from conftest import DEMO, MODULE, ROOT

FIRST = DEMO / "frames/0001.png"


class Layout:
    """Stands for a panel's layout, and notes the texts."""

    def __init__(self, texts):
        self.texts = texts

    def label(self, text="", icon=""):
        self.texts.append(text)

    def operator(self, name, text="", icon=""):
        getattr(bpy.ops, name.split(".")[0])
        self.texts.append(f"[{name}]")
        return SimpleNamespace()

    def prop(self, data, name, text=""):
        assert hasattr(data, name)

    def progress(self, text="", factor=0.0):
        assert 0.0 <= factor <= 1.0
        self.texts.append(text)

    def column(self, align=False):
        return self

    row = column
    box = split = lambda self, factor=0.5: self


def panel(context=None):
    """The texts that the panel draws."""
    texts = []
    real = bpy.context
    context = SimpleNamespace(scene=real.scene, preferences=real.preferences, region=SimpleNamespace(width=300), **(context or {}))
    bpy.types.BLINDAUG_PT_camera.draw(SimpleNamespace(layout=Layout(texts), draw_scale=draw_scale), context)
    return texts


def draw_scale(layout, clip):
    bpy.types.BLINDAUG_PT_camera.draw_scale(None, layout, clip)


def rows(installed, clip):
    return {row.name: row for row in installed.words.rows(installed.state.camera_of(clip))}


def refused(operator, **arguments):
    """The sentence with which an operator refuses."""
    with pytest.raises(RuntimeError) as error:
        operator(**arguments)
    text = str(error.value)
    assert text.startswith("Error: ") and "Traceback" not in text and text.count("\n") <= 1, text
    return text.removeprefix("Error: ").strip()


def test_the_archive_says_what_is_in_it(archive):
    with zipfile.ZipFile(archive) as files:
        names = files.namelist()
        manifest = tomllib.loads(files.read("blender_manifest.toml").decode())
        scene = files.read("scene.py").decode()
    cargo = tomllib.loads((ROOT / "Cargo.toml").read_text())
    assert manifest["version"] == cargo["workspace"]["package"]["version"]
    assert manifest["wheels"] and manifest["platforms"]
    for wheel in manifest["wheels"]:
        assert wheel.startswith("./wheels/blindaug-") and wheel.removeprefix("./") in names
        assert manifest["version"] in wheel and "abi3" in wheel
    assert [name for name in names if name.startswith("wheels/")] == [w.removeprefix("./") for w in manifest["wheels"]]
    assert {"__init__.py", "LICENSE-MIT", "LICENSE-APACHE"} <= set(names)
    # The script that the command line writes holds the same text.
    assert scene == (ROOT / "crates/blindaug/src/export/effects/blender_scene.py").read_text()


def test_the_exported_scripts_and_the_add_on_share_their_text(installed, archive, blindaug, tmp_path):
    with zipfile.ZipFile(archive) as files:
        shared = files.read("scene.py").decode()
    model = ROOT / "tools/blender/camera.json"
    package = next(iter(installed.state.blindaug.Camera.read(model).export("blender").files.values()))
    assert shared in package, "the wheel and the archive were built from different sources"
    blindaug("export", model, "--to", "blender", "-o", tmp_path / "camera.py")
    assert shared in (tmp_path / "camera.py").read_text(), "the program and the archive were built from different sources"


def test_it_can_be_turned_off_and_on(installed, scene):
    import addon_utils

    assert hasattr(bpy.types, "BLINDAUG_PT_camera") and hasattr(bpy.types.MovieClip, "blindaug")
    addon_utils.disable(MODULE)
    assert not hasattr(bpy.types, "BLINDAUG_PT_camera") and not hasattr(bpy.types.MovieClip, "blindaug")
    assert addon_utils.enable(MODULE) is not None
    assert hasattr(bpy.types, "BLINDAUG_PT_camera")


def test_an_estimate_is_the_command_line_s(installed, scene, load, blindaug, facts, tmp_path):
    clip = load(FIRST)
    assert bpy.ops.blindaug.estimate() == {"FINISHED"}
    blindaug("estimate", DEMO / "frames", "--fps", 24, "-o", tmp_path / "camera.json")
    wanted = facts(tmp_path / "camera.json")
    assert installed.state.camera_of(clip).facts() == wanted
    # The clip was made with an exposure of 0.6, a lens of a std of 2.66 px at infinity and a noise of a std of 0.0347 at luminance 0.5.
    truth = json.loads((DEMO / "truth.json").read_text())["demo"]
    assert truth["exposure"] == 0.6
    low, high = wanted["motion_blur"]["interval"]
    assert low <= truth["exposure"] <= high
    # The panel shows these numbers.
    found = rows(installed, clip)
    exposure, lens, noise = wanted["motion_blur"], wanted["defocus"], wanted["noise"]["std_of_encoded_rgb"][1]
    assert found["Exposure"].value.startswith(f"{exposure['exposure']:.3g} ")
    assert found["Exposure"].interval == "{:.3g} to {:.3g}".format(*exposure["interval"])
    assert found["Blur at infinity"].value == f"{lens['sigma_px_at_infinity']:.3g} px"
    assert found["Blur at infinity"].interval == "{:.3g} to {:.3g} px".format(*lens["sigma_px_at_infinity_interval"])
    assert found["Focus"].value == f"{lens['focus_inverse_depth']:.3g} of relative 1/depth"
    name = f"Noise at {noise['luminance']:g}"
    for c, channel in enumerate("RGB"):
        shown = found[f"{name}, {channel}"]
        assert shown.value == f"{255 * noise['std'][c]:.3g} /255"
        assert shown.interval == "{:.3g} to {:.3g}".format(*(255 * v for v in noise["interval"][c]))
    drawn = panel()
    for row in found.values():
        assert row.value in drawn and (not row.interval or row.interval in drawn), row
    # The scene has the shutter, and the lens waits for a scale.
    assert scene.render.use_motion_blur and scene.render.motion_blur_shutter == pytest.approx(exposure["exposure"])
    assert scene.render.motion_blur_position == "CENTER"
    assert not scene.camera.data.dof.use_dof and any("scene's scale" in line for line in clip.blindaug.left.splitlines())
    assert "[blindaug.set_distance]" in drawn and "this script" not in clip.blindaug.left
    # Negative control: fewer frames give other numbers.
    scene.frame_end = 3
    bpy.ops.blindaug.estimate()
    assert installed.state.camera_of(clip).facts() != wanted and installed.state.camera_of(clip).frames_used == 3


@pytest.mark.skipif(shutil.which("ffmpeg") is None, reason="there is no ffmpeg to make a video with")
def test_a_compressed_video_is_told(installed, scene, load, blindaug, facts, tmp_path):
    video = tmp_path / "shot.mp4"
    encode = ["ffmpeg", "-loglevel", "error", "-framerate", "25", "-i", DEMO / "frames/%04d.png", "-pix_fmt", "yuv420p", "-crf", "23", video]
    subprocess.run(encode, check=True)
    clip = load(video)
    assert clip.source == "MOVIE" and clip.frame_duration == 5
    assert bpy.ops.blindaug.estimate() == {"FINISHED"}
    blindaug("estimate", video, "-o", tmp_path / "camera.json")
    wanted = facts(tmp_path / "camera.json")
    assert installed.state.camera_of(clip).facts() == wanted and wanted["capture"]["fps"] == 25
    assert wanted["warnings"]
    drawn = " ".join(panel())
    assert all(warning in drawn for warning in wanted["warnings"])


def test_frames_are_those_of_the_scene_s_range(installed, scene, load, tmp_path):
    for i in range(1, 6):
        shutil.copy(DEMO / f"frames/000{i}.png", tmp_path / f"shot2.{100 + i}.png")
    shutil.copy(FIRST, tmp_path / "other.101.png")
    clip = load(tmp_path / "shot2.101.png")
    of = lambda: installed.footage.footage_of(clip, scene)
    assert of() == (str(tmp_path / "shot2.###.png"), 101, 105, 24.0)
    scene.frame_start, scene.frame_end = 2, 4
    assert of()[1:3] == (102, 104)
    clip.frame_start = 3
    assert of()[1:3] == (101, 102)
    assert installed.footage.scene_frame(clip, 102) == 4
    clip.frame_offset = 1
    assert of()[1:3] == (101, 103)
    assert installed.footage.scene_frame(clip, 103) == 4
    scene.use_preview_range, scene.frame_preview_start, scene.frame_preview_end = True, 4, 4
    assert of()[1:3] == (103, 103)
    scene.frame_preview_start = scene.frame_preview_end = 900
    assert "none of its frames" in refused(bpy.ops.blindaug.estimate)


def test_what_is_unknown_stays_as_it_is(installed, scene, load, tmp_path):
    for i in range(1, 6):
        shutil.copy(FIRST, tmp_path / f"000{i}.png")
    clip = load(tmp_path / "0001.png")
    scene.render.motion_blur_shutter = 0.123
    dof = scene.camera.data.dof
    dof.aperture_fstop, dof.focus_distance = 3.3, 7.7
    assert bpy.ops.blindaug.estimate() == {"FINISHED"}
    found = rows(installed, clip)
    assert found["Exposure"].value is None and "moves" in found["Exposure"].why
    assert not scene.render.use_motion_blur and scene.render.motion_blur_shutter == pytest.approx(0.123)
    assert not dof.use_dof and dof.aperture_fstop == pytest.approx(3.3) and dof.focus_distance == pytest.approx(7.7)
    drawn = panel()
    assert "Exposure: unknown" in drawn and "Lens: unknown" in drawn
    assert any("motion blur is left" in line for line in clip.blindaug.left.splitlines())
    # Negative control: with a known exposure the shutter is set.
    bpy.ops.blindaug.load(filepath=str(ROOT / "tools/blender/camera.json"))
    bpy.ops.blindaug.apply()
    assert scene.render.use_motion_blur and scene.render.motion_blur_shutter == pytest.approx(0.45)


def test_a_distance_gives_the_scale(installed, scene, load, blindaug, tmp_path):
    clip = load(FIRST)
    bpy.ops.blindaug.estimate()
    clip.blindaug.distance = 2.5
    assert bpy.ops.blindaug.set_distance(place="AT", x=200.0, y=220.0) == {"FINISHED"}
    blindaug("estimate", DEMO / "frames", "--fps", 24, "-o", tmp_path / "camera.json", "--at", "200,220=2.5m")
    bpy.ops.blindaug.save(filepath=str(tmp_path / "saved.json"))
    wanted, got = (json.loads((tmp_path / name).read_text()) for name in ("camera.json", "saved.json"))
    assert got["defocus"] == wanted["defocus"] and got["defocus"]["depth_kind"] == "metric"
    dof = scene.camera.data.dof
    assert dof.use_dof and dof.focus_distance == pytest.approx(1.0 / wanted["defocus"]["focus_inverse_depth"], rel=1e-4)
    assert "200, 220 px: 2.5 m" in panel()
    # A marker at the same place gives the same scale, and another place another one.
    clip.tracking.tracks.new(name="corner", frame=5).markers[0].co = (200.0 / 272.0, 1.0 - 220.0 / 272.0)
    clip.tracking.tracks.active = clip.tracking.tracks["corner"]
    bpy.ops.blindaug.clear_distances()
    assert installed.state.camera_of(clip).defocus.depth_kind == "relative"
    bpy.ops.blindaug.set_distance(place="TRACK")
    place = clip.blindaug.places[0]
    assert (place.x, place.y) == pytest.approx((200.0, 220.0), abs=1e-3)
    near = dof.focus_distance
    bpy.ops.blindaug.clear_distances()
    bpy.ops.blindaug.set_distance(place="AT", x=20.0, y=250.0)
    assert dof.focus_distance > 1.1 * near
    # Two places are kept, of which the later ones count.
    clip.blindaug.distance = 9.0
    bpy.ops.blindaug.set_distance(place="AT", x=100.0, y=30.0)
    assert len(clip.blindaug.places) == 2
    before = clip.blindaug.places[1].x
    assert "900" in refused(bpy.ops.blindaug.set_distance, place="AT", x=900.0, y=10.0)
    assert len(clip.blindaug.places) == 2 and clip.blindaug.places[1].x == before
    assert "clip editor" in refused(bpy.ops.blindaug.set_distance, place="PICK")
    clip.tracking.tracks["corner"].markers[0].mute = True
    assert "no marker" in refused(bpy.ops.blindaug.set_distance, place="TRACK")


def test_what_is_applied_twice_is_there_once(installed, scene, load, tmp_path):
    clip = load(FIRST)
    bpy.ops.blindaug.load(filepath=str(ROOT / "tools/blender/camera.json"))
    bpy.ops.blindaug.apply()
    counts = len(scene.node_tree.nodes), len(scene.node_tree.links), len(bpy.data.node_groups), len(bpy.data.images)
    assert {"blindaug plate", "blindaug over", "blindaug grain"} <= set(scene.node_tree.nodes.keys())
    bpy.ops.blindaug.apply()
    assert counts == (len(scene.node_tree.nodes), len(scene.node_tree.links), len(bpy.data.node_groups), len(bpy.data.images))
    # All of it is in the file, the octaves too.
    rows_before = rows(installed, clip)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "scene.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "scene.blend"))
    assert rows(installed, bpy.context.scene.active_clip) == rows_before
    image = bpy.data.images["blindaug_bands.png"]
    assert image.packed_file and tuple(image.size) == (512, 512)
    values = np.array(image.pixels[:]).reshape(512, 512, 4)[::-1]
    camera = installed.state.camera_of(bpy.context.scene.active_clip)
    assert np.abs(values - camera.export("blender").files["blindaug_bands.png"]).max() <= 0.51 / 255


def test_the_nodes_are_put_into_a_tree_that_is_there(installed, scene, load):
    load(FIRST)
    scene.use_nodes = True
    tree = scene.node_tree
    end = next(n for n in tree.nodes if n.type == "COMPOSITE")
    glare = tree.nodes.new("CompositorNodeGlare")
    tree.links.new(end.inputs[0].links[0].from_socket if end.inputs[0].is_linked else tree.nodes["Render Layers"].outputs[0], glare.inputs[0])
    tree.links.new(glare.outputs[0], end.inputs[0])
    bpy.ops.blindaug.load(filepath=str(ROOT / "tools/blender/camera.json"))
    bpy.ops.blindaug.apply()
    grain, over = tree.nodes["blindaug grain"], tree.nodes["blindaug over"]
    assert end.inputs[0].links[0].from_node == grain
    assert grain.inputs["Image"].links[0].from_node == over
    assert over.inputs[2].links[0].from_node == glare and grain.inputs["Layer"].links[0].from_node == glare
    # Without the clip first, and with it later.
    scene = bpy.data.scenes.new("other")
    numbers = installed.settings.Settings(installed.state.camera_of(bpy.data.movieclips[0]), (512, 384))
    installed.scene.set_scene(scene, numbers.numbers, numbers.bands())
    assert "blindaug over" not in scene.node_tree.nodes
    installed.scene.set_scene(scene, numbers.numbers, numbers.bands(), bpy.data.movieclips[0])
    grain, over = scene.node_tree.nodes["blindaug grain"], scene.node_tree.nodes["blindaug over"]
    assert grain.inputs["Image"].links[0].from_node == over and grain.inputs["Layer"].is_linked
    end = next(n for n in scene.node_tree.nodes if n.type == "COMPOSITE")
    assert end.inputs[0].links[0].from_node == grain


def test_bad_input_is_told_in_a_sentence(installed, scene, load, tmp_path):
    clip = load(FIRST)
    bpy.ops.blindaug.load(filepath=str(ROOT / "tools/blender/camera.json"))
    before = clip.blindaug.estimated
    clip.filepath = str(tmp_path / "gone.png")
    assert "gone.png: there is no such file" in refused(bpy.ops.blindaug.estimate)
    (tmp_path / "broken.mp4").write_bytes(b"\x00\x00\x00\x18ftypmp42" + b"\x00" * 200)
    clip.filepath = str(tmp_path / "broken.mp4")
    assert "broken.mp4" in refused(bpy.ops.blindaug.estimate)
    (tmp_path / "0001.png").write_bytes(FIRST.read_bytes()[:3000])
    clip.filepath = str(tmp_path / "0001.png")
    assert "0001.png" in refused(bpy.ops.blindaug.estimate)
    for name, text in (
        ("broken.json", "{"),
        ("newer.json", before.replace('"version": 1', '"version": 99')),
        ("other.json", '{"format": "something else"}'),
        ("empty.json", ""),
    ):
        (tmp_path / name).write_text(text)
        assert name in refused(bpy.ops.blindaug.load, filepath=str(tmp_path / name))
    assert "missing.json" in refused(bpy.ops.blindaug.load, filepath=str(tmp_path / "missing.json"))
    assert "no_folder" in refused(bpy.ops.blindaug.save, filepath=str(tmp_path / "no_folder/camera.json"))
    assert "estimate it again" in refused(bpy.ops.blindaug.report, filepath=str(tmp_path / "report.html"))
    # The camera of before is still there.
    assert clip.blindaug.estimated == before and clip.blindaug.left == ""
    # What a .blend file holds may be of a later version, too.
    clip.blindaug.estimated = before.replace('"version": 1', '"version": 99')
    assert any("99" in text for text in panel())
    assert "99" in refused(bpy.ops.blindaug.apply)
    clip.blindaug.estimated = ""
    assert not bpy.ops.blindaug.apply.poll()


def test_one_frame_is_no_error(installed, scene, load, tmp_path):
    shutil.copy(FIRST, tmp_path / "still.png")
    clip = load(tmp_path / "still.png")
    assert bpy.ops.blindaug.estimate() == {"FINISHED"}
    camera = installed.state.camera_of(clip)
    assert camera.frames_used == 1 and not camera.exposure.known and camera.warnings
    drawn = " ".join(panel())
    assert "Exposure: unknown" in drawn and " ".join(camera.warnings[0].split()[:4]) in drawn


def test_a_camera_that_has_no_lens_for_it_is_told(installed, scene, load):
    clip = load(FIRST)
    bpy.ops.blindaug.load(filepath=str(ROOT / "tools/blender/camera.json"))
    scene.camera.data.type = "ORTHO"
    bpy.ops.blindaug.apply()
    assert "not a perspective camera" in clip.blindaug.left and not scene.camera.data.dof.use_dof
    scene.camera = None
    bpy.ops.blindaug.apply()
    assert "the scene has no camera" in clip.blindaug.left
    assert "which is stretched" in clip.blindaug.left


def test_a_report_is_written(installed, scene, load, tmp_path):
    load(FIRST)
    bpy.ops.blindaug.estimate()
    assert bpy.ops.blindaug.report(filepath=str(tmp_path / "report.html")) == {"FINISHED"}
    page = (tmp_path / "report.html").read_text()
    assert "<html" in page and "0.69" in page


class Manager:
    """Stands for a window manager."""

    def __init__(self):
        self.timers, self.progress, self.modal, self.windows = 0, [], 0, []

    def event_timer_add(self, seconds, window):
        self.timers += 1
        return "timer"

    def event_timer_remove(self, timer):
        self.timers -= 1

    def progress_begin(self, low, high):
        self.progress.append((low, high))

    def progress_update(self, done):
        self.progress.append(done)

    def progress_end(self):
        self.progress.append("end")

    def modal_handler_add(self, operator):
        self.modal += 1


def in_background(installed, context, meanwhile):
    """Runs the estimate as the clip editor does, and calls `meanwhile` between two looks at the clock."""
    operators = installed.operators
    said = []
    operator = SimpleNamespace(report=lambda kind, text: said.append((kind, text)))
    cls = operators.BLINDAUG_OT_estimate
    operator.finish = lambda *args: cls.finish(operator, *args)
    operator.tidy = lambda *args: cls.tidy(operator, *args)
    footage = operators.footage.footage_of(installed.state.clip_of(context), context.scene)
    operator.clip, operator.job, operator.timer = installed.state.clip_of(context).name, operators.Job(footage), "timer"
    operators.RUNNING.append(operator.job)
    context.window_manager.timers = 1
    operator.job.start()
    for _ in range(600):
        meanwhile(operator, cls)
        result = cls.modal(operator, context, SimpleNamespace(type="TIMER", value="NOTHING"))
        if result & {"FINISHED", "CANCELLED"}:
            return result, said
        time.sleep(0.1)
    raise AssertionError("the estimate does not end")


def test_the_background_gives_the_same_and_can_be_cancelled(installed, scene, load):
    clip = load(FIRST)
    bpy.ops.blindaug.estimate()
    wanted = clip.blindaug.estimated
    clip.blindaug.estimated = ""
    texts = []
    context = SimpleNamespace(scene=scene, window_manager=Manager(), workspace=SimpleNamespace(status_text_set=texts.append))
    drawn = []
    result, said = in_background(installed, context, lambda operator, cls: drawn.extend(panel()))
    assert any("of 5 frames; Esc stops it" in text for text in drawn)
    assert result == {"FINISHED"} and clip.blindaug.estimated == wanted
    assert context.window_manager.timers == 0 and texts[-1] is None and any("of 5 frames" in t for t in texts if t)
    assert not installed.operators.RUNNING
    # Esc stops it, and nothing has changed.
    clip.blindaug.estimated = ""
    escape = SimpleNamespace(type="ESC", value="PRESS")
    result, said = in_background(installed, context, lambda operator, cls: cls.modal(operator, context, escape))
    assert result == {"CANCELLED"} and clip.blindaug.estimated == "" and "stopped" in said[-1][1]
    assert context.window_manager.timers == 0 and not installed.operators.RUNNING
    # A file that goes away meanwhile is an error.
    clip.filepath = str(ROOT / "README.md")
    result, said = in_background(installed, context, lambda operator, cls: None)
    assert result == {"CANCELLED"} and said[-1][0] == {"ERROR"} and "README.md" in said[-1][1]
