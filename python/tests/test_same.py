"""What Python computes is what the command line computes, bit by bit."""

import json
import warnings

import numpy as np
import OpenEXR
import pytest

import blindaug as ba
from conftest import CLIP, NUMBERS, picture

FRAMES, SCENE = CLIP / "frames", CLIP / "scene"


def test_an_estimate_from_files_arrays_lists_and_generators_is_that_of_the_command_line(blindaug, clip):
    wanted = blindaug("estimate", FRAMES, "--json")
    assert ba.estimate(FRAMES).to_json() == wanted
    assert ba.estimate(str(FRAMES)).to_json() == wanted
    assert ba.estimate(clip.frames).to_json() == wanted
    assert ba.estimate(list(clip.frames)).to_json() == wanted
    assert ba.estimate(frame for frame in clip.frames).to_json() == wanted
    # Negative control: other frames give another camera.
    assert ba.estimate(clip.frames[:4]).to_json() != wanted


def test_given_evidence_is_taken_alike(blindaug, clip):
    given = ["--depth", SCENE, "--flow", SCENE, "--clean", CLIP / "without", "--fps", 30]
    wanted = blindaug("estimate", FRAMES, *given, "--json")
    files = ba.estimate(FRAMES, depth=SCENE, flow=SCENE, clean=CLIP / "without", fps=30)
    assert files.to_json() == wanted
    arrays = ba.estimate(clip.frames, depth=clip.depth, flow=clip.flow, clean=clip.without, fps=30)
    assert arrays.to_json() == wanted
    lists = ba.estimate(iter(clip.frames), depth=list(clip.depth), flow=list(clip.flow), clean=clip.without, fps=30)
    assert lists.to_json() == wanted
    # Negative controls: each of the three counts.
    assert ba.estimate(clip.frames, depth=clip.depth, flow=clip.flow, fps=30).to_json() != wanted
    some = [None, *clip.depth[1:]]
    assert ba.estimate(clip.frames, depth=some, flow=clip.flow, clean=clip.without, fps=30).to_json() != wanted


def test_light_is_taken_as_from_exr_files(blindaug, clip, tmp_path):
    def light(v: np.ndarray) -> np.ndarray:
        v = v / np.float32(255)
        return np.where(v <= 0.04045, v / 12.92, ((v + 0.055) / 1.055) ** 2.4).astype(np.float32)

    frames = light(clip.frames)
    for number, frame in zip(NUMBERS, frames):
        header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
        with OpenEXR.File(header, {"RGB": np.ascontiguousarray(frame)}) as file:
            file.write(str(tmp_path / f"{number}.exr"))
    wanted = blindaug("estimate", tmp_path, "--json")
    assert ba.estimate(tmp_path).to_json() == wanted
    assert ba.estimate(frames, colour_space="linear-srgb").to_json() == wanted
    assert ba.estimate(frames).to_json() != wanted


def test_a_composite_is_that_of_the_command_line(blindaug, clip, camera, tmp_path):
    file, out = tmp_path / "camera.json", tmp_path / "out"
    camera.write(file)
    scene = ["--depth", SCENE, "--flow", SCENE, "--with", CLIP / "with", "--without", CLIP / "without"]
    blindaug("composite", FRAMES, "--virtual", CLIP / "virtual", "--camera", file, *scene, "--seed", 7, "-o", out)
    read = ba.Camera.read(file)
    assert read == camera
    for i, number in enumerate(NUMBERS):

        def made(seed: int, number: int) -> np.ndarray:
            return ba.composite(
                clip.frames[i],
                clip.layers[i],
                read,
                layer_depth=clip.layer_depth[i],
                layer_motion=clip.layer_motion[i],
                depth=clip.depth[i],
                flow=clip.flow[i],
                with_=clip.with_[i],
                without=clip.without[i],
                number=number,
                seed=seed,
            )

        wanted = picture(out / f"{number:04}.png")
        same = made(7, number)
        assert same.dtype == np.uint8 and np.array_equal(same, wanted)
        assert (wanted != clip.frames[i]).any(axis=-1).mean() > 0.02
        # Negative controls: another seed, another number.
        assert not np.array_equal(made(8, number), wanted)
        assert not np.array_equal(made(7, number + 10), wanted)


def test_an_applied_frame_is_that_of_the_command_line(blindaug, clip, camera, tmp_path):
    file, out = tmp_path / "camera.json", tmp_path / "out"
    camera.write(file)
    blindaug("apply", CLIP / "without", "--camera", file, "--depth", SCENE, "--flow", SCENE, "-o", out)
    for i, number in enumerate(NUMBERS):
        wanted = picture(out / f"{number:04}.png")
        given = dict(depth=clip.depth[i], flow=clip.flow[i], number=number)
        assert np.array_equal(ba.apply(clip.without[i], camera, **given), wanted)
        assert not np.array_equal(ba.apply(clip.without[i], camera, **given, seed=1), wanted)


def without_noise(lines):
    """Models without their noise: the command line gives that of a shot's first frames once it has settled, a generator at once."""
    return [{name: part for name, part in json.loads(line).items() if name != "noise"} for line in lines]


def test_a_track_is_that_of_the_command_line(blindaug, clip):
    wanted = blindaug("estimate", FRAMES, "--track", "--json").splitlines()
    assert len(wanted) == 5
    for given in (FRAMES, clip.frames):
        found = [cam.to_json() for cam in ba.track(given)]
        assert without_noise(found) == without_noise(wanted) and found[-1] == wanted[-1]
    tracker = ba.Tracker()
    pushed = [tracker.push(frame) for frame in clip.frames] + [tracker.finish()]
    assert pushed[0] is None and without_noise(cam.to_json() for cam in pushed[1:]) == without_noise(wanted)
    assert pushed[-1].to_json() == wanted[-1]
    assert [cam.frame for cam in pushed[1:]] == list(NUMBERS)
    # Negative control: a gap in the numbers is one in time.
    tracker = ba.Tracker()
    apart = [tracker.push(frame, number=2 * n) for n, frame in enumerate(clip.frames, 1)] + [tracker.finish()]
    assert [json.loads(cam.to_json())["noise"] for cam in apart[1:]] != [json.loads(line)["noise"] for line in wanted]


def test_a_track_with_given_depth_and_flow_is_that_of_the_command_line(blindaug, clip):
    wanted = blindaug("estimate", FRAMES, "--track", "--json", "--depth", SCENE, "--flow", SCENE, "--fps", 30).splitlines()
    from_files = ba.track(FRAMES, depth=SCENE, flow=SCENE, fps=30)
    from_arrays = ba.track(iter(clip.frames), depth=clip.depth, flow=clip.flow, fps=30)
    for track in (from_files, from_arrays):
        found = [cam.to_json() for cam in track]
        assert without_noise(found) == without_noise(wanted) and found[-1] == wanted[-1]
    tracker = ba.Tracker(fps=30)
    pushed = [tracker.push(f, depth=d, flow=v) for f, d, v in zip(clip.frames, clip.depth, clip.flow)]
    pushed = [cam.to_json() for cam in [*pushed[1:], tracker.finish()]]
    assert without_noise(pushed) == without_noise(wanted) and pushed[-1] == wanted[-1]


@pytest.mark.parametrize("target", ba.EXPORT_TARGETS)
def test_an_export_is_that_of_the_command_line(blindaug, camera, tmp_path, target):
    file, folder = tmp_path / "camera.json", tmp_path / "theirs"
    camera.write(file)
    folder.mkdir()
    export = camera.export(target)
    blindaug("export", file, "--to", target, "-o", folder)
    paths = export.write(tmp_path / "ours")
    assert len(paths) == len(export.files) == len(list(folder.iterdir()))
    for path, (name, content) in zip(map(str, paths), export.files.items()):
        ours, theirs = (tmp_path / "ours" / name).read_bytes(), (folder / name).read_bytes()
        assert path.endswith(name) and ours == theirs
        if isinstance(content, str):
            assert content.encode() == theirs
        else:
            assert content.dtype == np.float32 and content.shape[2] == 4 and 0 <= content.min() <= content.max() <= 1
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert camera.export(target, fov=60, size=(1920, 1080)).files.keys() == export.files.keys()
