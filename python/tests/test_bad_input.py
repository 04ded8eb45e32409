"""Whatever is handed in: an exception of a type that can be caught, with a sentence that names the argument."""

import os
import shutil
import signal
import threading
import time
from pathlib import Path

import numpy as np
import OpenEXR
import pytest

import blindaug as ba
from conftest import CLIP


def spoiled(frames: np.ndarray, value: float) -> np.ndarray:
    frames = frames.astype(np.float32) / 255
    frames[2, 10, 20, 1] = value
    return frames


BAD = {
    "int32": (lambda f: f.astype(np.int32), "footage: frame 1: has values of type int32"),
    "bool": (lambda f: f > 99, "footage: frame 1: has values of type bool"),
    "complex": (lambda f: f.astype(complex), "complex128"),
    "objects": (lambda f: f.astype(object), "object"),
    "strings": (lambda f: f.astype("U3"), "<U3"),
    "channels first": (lambda f: f.transpose(0, 3, 1, 2), r"frame 1: .* its channels come first; .*moveaxis"),
    "alpha": (lambda f: np.concatenate([f, f[..., :1]], axis=-1), r"leave alpha out by a\[..., :3\]"),
    "grey": (lambda f: list(f[..., 0]), "repeat a grey one"),
    "two channels": (lambda f: f[..., :2], r"\(272, 272, 2\)"),
    "one frame": (lambda f: f[0], r"one frame; hand in a\[None\]"),
    "five axes": (lambda f: f[None], r"frames have \(T, H, W, 3\)"),
    "no frames": (lambda f: f[:0], "footage: there is no frame in it"),
    "no rows": (lambda f: f[:, :0], "at least one pixel"),
    "no columns": (lambda f: f[:, :, :0], "at least one pixel"),
    "an empty list": (lambda f: [], "there is no frame"),
    "an empty iterator": (lambda f: iter([]), "there is no frame"),
    "NaN": (lambda f: spoiled(f, np.nan), "footage: frame 3: holds values that are not finite"),
    "infinity": (lambda f: spoiled(f, np.inf), "frame 3: .*not finite"),
    "floats up to 255": (lambda f: f.astype(np.float32), r"must be in \[0, 1\]"),
    "sizes that differ": (lambda f: [f[0], f[1], f[2, :100]], "frame 3: has 272 x 100 pixels, but the first has 272 x 272"),
    "ragged": (lambda f: [[[1, 2], [3]]], "frame 1: cannot be taken as an array"),
    "None": (lambda f: None, "footage: must be a path, an array"),
    "a number": (lambda f: 5, "footage: must be a path, an array"),
    "a dict": (lambda f: {1: f[0]}, "footage: must be a path, an array"),
    "None within": (lambda f: [f[0], None], "frame 2: must be an array, and is of type NoneType"),
    "a name within": (lambda f: [f[0], "1.png"], "frame 2: must be an array, and is of type str"),
    "no file": (lambda f: "no-such-file.mp4", "no-such-file.mp4: there is no such file"),
}


@pytest.mark.parametrize("name", BAD)
@pytest.mark.parametrize("job", [ba.estimate, lambda footage: list(ba.track(footage))], ids=["estimate", "track"])
def test_bad_footage(clip, name, job):
    make, sentence = BAD[name]
    with pytest.raises(ba.Error, match=sentence) as caught:
        job(make(clip.frames))
    assert "\n" not in str(caught.value)
    assert isinstance(caught.value, ValueError)


def test_arrays_of_any_layout_are_the_same(clip):
    wanted = ba.estimate(clip.frames).to_json()
    wide = np.empty((5, 272, 272, 6), np.uint8)
    wide[..., ::2] = clip.frames
    backward = np.ascontiguousarray(clip.frames[:, ::-1, ::-1])[:, ::-1, ::-1]
    fixed = clip.frames.copy()
    fixed.setflags(write=False)
    fortran = np.asfortranarray(clip.frames)
    assert ba.estimate(wide[..., ::2]).to_json() == wanted
    assert min(backward.strides) < 0 and ba.estimate(backward).to_json() == wanted
    assert ba.estimate(fixed).to_json() == wanted and ba.estimate(fortran).to_json() == wanted
    # Channels from blue to red by a negative stride.
    bgr = np.ascontiguousarray(clip.frames[..., ::-1])
    assert ba.estimate(bgr[..., ::-1]).to_json() == wanted and ba.estimate(bgr).to_json() != wanted
    singles = clip.frames.astype(np.float32) / np.float32(255)
    assert ba.estimate(singles).to_json() == wanted
    assert ba.estimate(singles.astype(">f4")).to_json() == wanted
    packed = np.zeros(clip.frames.shape[:3], np.dtype([("head", "u1"), ("rgb", "f4", 3)]))
    packed["rgb"] = singles
    assert not packed["rgb"].flags.aligned and ba.estimate(packed["rgb"]).to_json() == wanted


def test_bad_arguments(clip):
    f = clip.frames
    wrong = [
        (dict(depth=clip.depth[:3]), "depth: is for 3 frames, but there are 5"),
        (dict(depth=clip.depth[:, :100]), "depth: frame 1: has 272 x 100 pixels, but the frame has 272 x 272"),
        (dict(depth=clip.depth[0].astype(np.uint16)), "depth: has values of type uint16, and must have floats"),
        (dict(depth=5), "depth: must be a path, an array"),
        (dict(depth=iter(clip.depth)), "depth: must be a path, an array"),
        (dict(depth=clip.depth[0, 0]), "depth: has 1 axes"),
        (dict(depth="no-such-folder"), "no-such-folder"),
        (dict(flow=clip.depth), "flow: .*shape|flow: frame 1"),
        (dict(flow=clip.flow.transpose(0, 3, 1, 2)), "its channels come first"),
        (dict(clean=clip.frames[:, :100]), "clean: frame 1"),
        (dict(fps=0), "fps: "),
        (dict(fps=float("nan")), "fps: "),
        (dict(colour_space="mauve"), "colour_space: "),
        (dict(depth_kind="deep"), "depth_kind: "),
        (dict(frames=(1, 3)), "frames: is for files"),
        (dict(progress=3), "progress: must be a function"),
    ]
    for arguments, sentence in wrong:
        with pytest.raises(ba.Error, match=sentence):
            ba.estimate(f, **arguments)
    with pytest.raises(ba.Error, match="frames: must be the first and the last"):
        ba.estimate(CLIP / "frames", frames=(3, 1))
    with pytest.raises(ba.FileError, match="no frame in 9"):
        ba.estimate(CLIP / "frames", frames=(9, None))
    assert ba.estimate(CLIP / "frames", frames=(None, 3)).frames_used == 3


def test_bad_arguments_of_apply_and_composite(clip, camera):
    frame, layer = clip.frames[0], clip.layers[0]
    wrong = [
        ((frame[:100], layer), {}, "layer: has 272 x 272 pixels, but the frame has 272 x 100"),
        ((frame, layer[..., :3]), {}, r"layer: .*a layer has \(H, W, 4\)"),
        ((frame, (layer * 255).astype(np.uint8)), {}, "layer: has values of type uint8"),
        ((frame, np.full_like(layer, np.nan)), {}, "layer: .*not finite"),
        ((frame[..., 0], layer), {}, "frame: .*grey"),
        ((frame, layer), dict(layer_depth=-1.0), "layer_depth: "),
        ((frame, layer), dict(layer_depth="far"), "layer_depth: "),
        ((frame, layer), dict(layer_motion=(np.nan, 0.0)), "layer_motion: "),
        ((frame, layer), dict(layer_motion="left"), "layer_motion: "),
        ((frame, layer), dict(depth=clip.depth), "depth: "),
        ((frame, layer), dict(with_=clip.with_[0]), "without: must be given too"),
        ((frame, layer), dict(without=clip.with_[0]), "with_: must be given too"),
        ((frame, layer), dict(with_=clip.with_[0], without=clip.with_[0, :9]), "without: has 272 x 9"),
        ((frame, layer), dict(colour_space=""), "colour_space: "),
        ((frame, layer), dict(layer_colour_space="srgb"), "layer_colour_space: "),
    ]
    for arguments, named, sentence in wrong:
        with pytest.raises(ba.Error, match=sentence):
            ba.composite(*arguments, camera, **named)
    with pytest.raises(ba.Error, match="rgb: .*not finite"):
        ba.apply(np.full((9, 9, 3), np.nan), camera)
    with pytest.raises(TypeError):
        ba.apply(frame, camera.to_json())
    with pytest.raises((TypeError, OverflowError)):
        ba.apply(frame, camera, seed=-1)
    with pytest.raises(ba.Error, match='target: "excel" is none of unity-urp'):
        camera.export("excel")
    with pytest.raises(ba.Error):
        camera.export("blender", fov=500)
    for text in ["", "{}", "[1]", "nonsense", camera.to_json()[:200]]:
        with pytest.raises(ba.Error, match="text: "):
            ba.Camera.from_json(text)


class Mine(Exception):
    pass


def failing(frames, after: int):
    yield from frames[:after]
    raise Mine("no more")


def test_what_python_code_raises_comes_out_as_it_is(clip):
    for after in [0, 1, 3]:
        with pytest.raises(Mine, match="no more"):
            ba.estimate(failing(clip.frames, after))
    track = ba.track(failing(clip.frames, 3))
    assert next(track).frame == 1 and next(track).frame == 2
    with pytest.raises(Mine):
        next(track)
    assert list(track) == []

    def progress(done, total):
        raise Mine(f"{done} of {total}")

    with pytest.raises(Mine, match="1 of 5"):
        ba.estimate(clip.frames, progress=progress)
    with pytest.raises(Mine, match="1 of 5"):
        list(ba.track(clip.frames, progress=progress))


def test_bad_depth_does_not_take_the_cameras_of_the_frames_before_it_along(clip):
    depth = list(clip.depth)
    depth[2] = depth[2][:100]
    track = ba.track(clip.frames, depth=depth)
    assert [next(track).frame, next(track).frame] == [1, 2]
    with pytest.raises(ba.Error, match="depth: frame 3: has 272 x 100 pixels"):
        next(track)
    assert list(track) == []


def test_a_generator_runs_in_the_caller_s_thread(clip):
    threads = set()

    def frames():
        for frame in clip.frames:
            threads.add(threading.get_ident())
            yield frame

    ba.estimate(frames())
    list(ba.track(frames()))
    assert threads == {threading.get_ident()}


def test_a_file_that_vanishes_is_named(tmp_path):
    folder = tmp_path / "frames"
    for job in [ba.estimate, lambda *a, **k: list(ba.track(*a, **k))]:
        shutil.copytree(CLIP / "frames", folder)
        with pytest.raises(ba.FileError, match="0005.png: there is no such file"):
            job(folder, progress=lambda *_: (folder / "0005.png").unlink(missing_ok=True))
        shutil.rmtree(folder)
    (tmp_path / "cut.png").write_bytes((CLIP / "frames/0001.png").read_bytes()[:5000])
    with pytest.raises(ba.FileError, match="cut.png: "):
        ba.estimate(tmp_path / "cut.png")


def test_two_threads_on_one_tracker(clip):
    tracker, failures = ba.Tracker(), []
    start = threading.Barrier(2)

    def push():
        start.wait()
        for _ in range(4):
            for frame in clip.frames:
                try:
                    tracker.push(frame)
                except Exception as e:
                    failures.append(e)

    threads = [threading.Thread(target=push) for _ in range(2)]
    [t.start() for t in threads]
    [t.join() for t in threads]
    assert failures and all(isinstance(e, ba.Error) and "another thread" in str(e) for e in failures)
    # It goes on afterwards.
    assert tracker.push(clip.frames[0]) is not None and tracker.finish() is not None and tracker.finish() is None


def test_a_tracker_goes_on_after_a_bad_frame(clip):
    tracker = ba.Tracker()
    assert tracker.push(clip.frames[0]) is None
    with pytest.raises(ba.Error, match="frame: "):
        tracker.push(clip.frames[0][..., 0])
    with pytest.raises(ba.Error, match="number: must rise"):
        tracker.push(clip.frames[1], number=1)
    assert tracker.push(clip.frames[1]).frame == 1
    with pytest.raises(ba.Error, match="frame: has 272 x 100 pixels, but the first has 272 x 272"):
        tracker.push(clip.frames[2, :100])
    with pytest.raises(ba.Error, match="depth: "):
        tracker.push(clip.frames[2], depth=clip.depth)
    assert tracker.push(clip.frames[2]).frame == 2 and tracker.finish().frame == 3


def test_other_threads_run_meanwhile(clip):
    ticks, done = 0, threading.Event()

    def tick():
        nonlocal ticks
        while not done.wait(0.001):
            ticks += 1

    thread = threading.Thread(target=tick)
    thread.start()
    before = ticks
    ba.estimate(clip.frames)
    meanwhile = ticks - before
    done.set()
    thread.join()
    assert meanwhile > 5


def many(folder: Path, count: int) -> Path:
    folder.mkdir()
    for i in range(count):
        (folder / f"{i:04}.png").symlink_to(CLIP / f"frames/{1 + i % 5:04}.png")
    return folder


@pytest.mark.parametrize("job", [ba.estimate, lambda footage: list(ba.track(footage))], ids=["estimate", "track"])
def test_ctrl_c_stops_it(tmp_path, job, interruptible):
    folder = many(tmp_path / "many", 1000)
    timer = threading.Timer(0.5, os.kill, (os.getpid(), signal.SIGINT))
    began = time.monotonic()
    timer.start()
    with pytest.raises(KeyboardInterrupt):
        job(folder)
    assert time.monotonic() - began < 20


@pytest.mark.skipif(not hasattr(os, "fork"), reason="there is no fork here")
def test_a_forked_process_is_told_rather_than_hung(clip, camera):
    ba.apply(clip.without[0], camera, depth=clip.depth[0])
    child = os.fork()
    if child == 0:
        try:
            ba.apply(clip.without[0], camera, depth=clip.depth[0])
        except ba.Error as e:
            os._exit(42 if "spawn" in str(e) else 1)
        os._exit(0)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 42


def test_the_memory_budget_is_kept(clip):
    ba.set_memory_budget(1_000_000)
    try:
        with pytest.raises(ba.Error, match="set_memory_budget"):
            ba.estimate(clip.frames)
    finally:
        ba.set_memory_budget(0)
    ba.estimate(clip.frames[:2])


class Lent:
    """An array of another library: its memory is lent by DLPack alone."""

    def __init__(self, array: np.ndarray, device: int = 1) -> None:
        self.array, self.device = array, device

    def __dlpack__(self, **options):
        return self.array.__dlpack__(**options)

    def __dlpack_device__(self):
        return self.device, 0


def test_arrays_of_other_libraries_are_taken_from_the_cpu_and_refused_from_a_gpu(clip, camera):
    wanted = ba.apply(clip.without[0], camera, depth=clip.depth[0], flow=clip.flow[0])
    lent = [Lent(a) for a in (clip.without[0], clip.depth[0], clip.flow[0])]
    assert np.array_equal(ba.apply(lent[0], camera, depth=lent[1], flow=lent[2]), wanted)
    with pytest.raises(ba.Error, match=r"^depth: lies in the memory of another device than the CPU: .*tensor\.cpu\(\)") as caught:
        ba.apply(lent[0], camera, depth=Lent(clip.depth[0], 2), flow=lent[2])
    assert "\n" not in str(caught.value)
    with pytest.raises(ba.Error, match="^footage: frame 1: lies in the memory"):
        ba.estimate([Lent(f, 10) for f in clip.frames])


def test_bad_names_and_numbers(clip, camera):
    frame, layer = clip.frames[0], clip.layers[0]
    for named, sentence in [
        (dict(unknown="ignore"), 'unknown: "ignore" is none of "leave", "middle"'),
        (dict(product="mask"), 'product: "mask" is none of "composite", "layer"'),
        (dict(match_at=(np.nan, 3)), "match_at: must be a place"),
        (dict(match_at=(1e6, 3)), "outside|no depth|picture|frame"),
        (dict(holdout=layer), "holdout: has the shape"),
        (dict(holdout=np.zeros((9, 9))), "holdout: has 9 x 9 pixels"),
        (dict(layer_depth="plate"), "layer_depth: needs the depth of the frame"),
    ]:
        with pytest.raises(ba.Error, match=sentence):
            ba.composite(frame, layer, camera, **named)
    for named, sentence in [
        (dict(shutter=361), "shutter: must be a number from 0 to 360"),
        (dict(shutter_phase=-181), "shutter_phase: must be"),
        (dict(focus=0), "focus: must be a positive distance"),
        (dict(blur=float("nan")), "blur: must be"),
        (dict(bokeh="square"), "bokeh: give gaussian, disk, or polygon"),
        (dict(squeeze=5), "squeeze: must be a number from 0.25 to 4"),
        (dict(cats_eye=0.5), "cam: a Gaussian has no edge"),
        (dict(grain=-1), "grain: must be"),
    ]:
        with pytest.raises(ba.Error, match=sentence):
            camera.replace(**named)
    for named, sentence in [
        (dict(method="magic"), 'method: "magic" is none of "auto", "spectral", "removal"'),
        (dict(curve="line"), "curve: "),
        (dict(blur_in="film"), "blur_in: "),
        (dict(noise_model="white"), "noise_model: "),
        (dict(networks=["no-such-network"]), "no-such-network"),
    ]:
        with pytest.raises(ba.Error, match=sentence):
            ba.estimate(clip.frames[:2], **named)


def test_a_pixel_that_is_no_number_is_warned_of(tmp_path):
    light = 0.2 + 0.1 * np.random.default_rng(1).random((3, 48, 64, 3), np.float32)
    light[1, 5, 7] = np.nan
    for number, frame in enumerate(light):
        header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
        with OpenEXR.File(header, {"RGB": frame}) as file:
            file.write(str(tmp_path / f"{number}.exr"))
    for look in (lambda: ba.estimate(tmp_path), lambda: list(ba.track(tmp_path))):
        with pytest.warns(UserWarning, match=r"1\.exr: 1 pixel holds no number"):
            look()
