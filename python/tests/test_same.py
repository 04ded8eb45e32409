"""What Python computes is what the command line computes, bit by bit."""

import json
import warnings

import numpy as np
import OpenEXR
import pytest
from PIL import Image

import blindaug as ba
from conftest import CLIP, NUMBERS, exr, picture

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


def layer_files(clip, folder, names):
    """Layers of these channels as files."""
    folder.mkdir()
    for i, number in enumerate(NUMBERS):
        arrays = dict(RGBA=clip.layers[i], Z=clip.layer_depth[i])
        header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
        channels = {name: np.ascontiguousarray(arrays[name]).astype(np.float32) for name in names}
        with OpenEXR.File(header, channels) as file:
            file.write(str(folder / f"{number:04}.exr"))


def test_what_the_footage_says_of_a_bare_layer_is_that_of_the_command_line(blindaug, clip, camera, tmp_path):
    file, layers = tmp_path / "camera.json", tmp_path / "layers"
    camera.write(file)
    layer_files(clip, layers, ["RGBA"])
    plate = ["--layer-depth", "plate", "--layer-motion", "plate", "--depth", SCENE, "--flow", SCENE, "--with", CLIP / "with"]
    given = ["--virtual", layers, "--camera", file, *plate, "--without", CLIP / "without"]
    blindaug("composite", FRAMES, *given, "-o", tmp_path / "out")
    i = 2
    scene = dict(depth=clip.depth[i], flow=clip.flow[i], with_=clip.with_[i], without=clip.without[i], number=3)

    def made(**more):
        return ba.composite(clip.frames[i], clip.layers[i], camera, **scene, **more)

    wanted = picture(tmp_path / "out/0003.png")
    assert np.array_equal(made(layer_depth="plate", layer_motion="plate"), wanted)
    # Negative control: another depth and motion.
    assert not np.array_equal(made(layer_depth=1.0, layer_motion="plate"), wanted)
    assert not np.array_equal(made(layer_depth="plate", layer_motion=(9.0, 0.0)), wanted)


def test_a_blur_matched_at_a_place_and_mattes_are_those_of_the_command_line(blindaug, clip, tmp_path):
    relative = ba.estimate(clip.frames)
    file, mattes = tmp_path / "camera.json", tmp_path / "mattes"
    relative.write(file)
    matte = np.zeros((272, 272), np.uint8)
    matte[:, 100:150] = 200
    mattes.mkdir()
    for number in NUMBERS:
        Image.fromarray(matte).save(mattes / f"{number:04}.png")
    place = next(p for p in [(136, y) for y in range(20, 260, 8)] if matches(clip, relative, p))
    at = ["--match-at", f"{place[0]},{place[1]}", "--holdout", mattes]
    blindaug("composite", FRAMES, "--virtual", CLIP / "virtual", "--camera", file, *at, "-o", tmp_path / "out")
    i = 1
    layer = dict(layer_depth=clip.layer_depth[i], layer_motion=clip.layer_motion[i], number=2, match_at=place)
    wanted = picture(tmp_path / "out/0002.png")
    for same in [matte, matte.astype(np.float32) / 255]:
        assert np.array_equal(ba.composite(clip.frames[i], clip.layers[i], relative, **layer, holdout=same), wanted)
    assert not np.array_equal(ba.composite(clip.frames[i], clip.layers[i], relative, **layer), wanted)
    with pytest.raises(ba.Error, match="match_at"):
        ba.composite(clip.frames[i], clip.layers[i], relative)


def matches(clip, camera, place) -> bool:
    try:
        ba.composite(clip.frames[0], clip.layers[0], camera, match_at=place)
    except ba.Error:
        return False
    return True


def test_parts_set_by_hand_are_those_of_the_command_line(blindaug, clip, camera, tmp_path):
    file = tmp_path / "camera.json"
    camera.write(file)
    for n, (options, by_hand) in enumerate(
        [
            (["--shutter", 180, "--shutter-phase", -45], dict(shutter=180, shutter_phase=-45)),
            (["--focus", 2, "--blur", 4, "--bokeh", "polygon:6,0.5,15"], dict(focus=2, blur=4, bokeh="polygon:6,0.5,15")),
            (["--bokeh", "disk", "--squeeze", 2, "--cats-eye", 0.5], dict(bokeh="disk", squeeze=2, cats_eye=0.5)),
            (["--grain", "x2"], dict(grain=2)),
        ]
    ):
        out, own = tmp_path / f"out{n}", tmp_path / f"own{n}.json"
        given = ["--virtual", CLIP / "virtual", "--frames", "4..4", "--depth", SCENE]
        blindaug("composite", FRAMES, *given, "--camera", file, *options, "-o", out)
        set_by_hand = camera.replace(**by_hand)
        layer = dict(layer_depth=clip.layer_depth[3], layer_motion=clip.layer_motion[3], depth=clip.depth[3], number=4)
        made, wanted = ba.composite(clip.frames[3], clip.layers[3], set_by_hand, **layer), picture(out / "0004.png")
        # A camera has six digits, so that a product, as of grain, may round to the other side.
        assert np.abs(made.astype(int) - wanted).max() <= 1 and (made != wanted).mean() < 1e-4, options
        set_by_hand.write(own)
        blindaug("composite", FRAMES, *given, "--camera", own, "-o", tmp_path / f"same{n}")
        assert np.array_equal(made, picture(tmp_path / f"same{n}/0004.png"))
        plain = ba.composite(clip.frames[3], clip.layers[3], camera, **layer)
        assert (np.abs(plain.astype(int) - made) > 1).mean() > 1e-3, options
    assert camera.replace() == camera


def test_the_middle_of_the_exposures_that_fit_is_that_of_the_command_line(blindaug, clip, camera, tmp_path):
    model = json.loads(camera.to_json())
    model["motion_blur"] = {"unknown": "little moves", "reason": "no_motion", "fits": [0.25, 0.75]}
    unknown = ba.Camera.from_json(json.dumps(model, indent=1))
    assert unknown.exposure.value is None and unknown.exposure.fits == (0.25, 0.75)
    file = tmp_path / "camera.json"
    unknown.write(file)
    given = ["--camera", file, "--depth", SCENE, "--flow", SCENE, "--unknown", "middle"]
    blindaug("apply", CLIP / "without", *given, "-o", tmp_path / "out")
    given = dict(depth=clip.depth[0], flow=clip.flow[0], number=1)
    wanted = picture(tmp_path / "out/0001.png")
    assert np.array_equal(ba.apply(clip.without[0], unknown, unknown="middle", **given), wanted)
    assert not np.array_equal(ba.apply(clip.without[0], unknown, **given), wanted)


def test_a_layer_apart_is_that_of_the_command_line(blindaug, clip, camera, tmp_path):
    file, out = tmp_path / "camera.json", tmp_path / "out"
    camera.write(file)
    given = ["--virtual", CLIP / "virtual", "--camera", file, "--depth", SCENE, "--layer", "--bits", 32]
    blindaug("composite", FRAMES, *given, "--frames", "2..2", "-o", out)
    layer = dict(layer_depth=clip.layer_depth[1], layer_motion=clip.layer_motion[1], depth=clip.depth[1], number=2)
    made = ba.composite(clip.frames[1], clip.layers[1], camera, product="layer", **layer)
    wanted = out / "0002.exr"
    assert np.array_equal(made["layer"], exr(wanted, "R", "G", "B", "A")) and made["layer"][..., 3].max() > 0.9
    assert np.array_equal(made["noise"], exr(wanted, "noise.R", "noise.G", "noise.B")) and made["noise"].any()
    assert np.array_equal(made["holdout"], exr(wanted, "holdout.A")[..., 0])
    assert np.array_equal(made["motion"], exr(wanted, "forward.u", "forward.v")) and made["motion"].any()
    z = exr(wanted, "Z")[..., 0]
    there = np.isfinite(made["depth"])
    assert there.any() and np.array_equal(made["depth"][there], z[there]) and z[~there].min() > 1e6
    other = ba.composite(clip.frames[1], clip.layers[1], camera, product="layer", seed=1, **layer)
    assert np.array_equal(other["layer"], made["layer"]) and not np.array_equal(other["noise"], made["noise"])


def test_an_object_that_is_pasted_on_is_that_of_the_command_line(blindaug, clip, tmp_path):
    blindaug("composite", FRAMES, "--virtual", CLIP / "virtual", "--naive", "--depth", SCENE, "-o", tmp_path / "out")
    layer = dict(layer_depth=clip.layer_depth[2], depth=clip.depth[2])
    pasted = ba.composite(clip.frames[2], clip.layers[2], None, **layer)
    assert np.array_equal(pasted, picture(tmp_path / "out/0003.png"))
    assert (pasted == clip.frames[2]).all(axis=-1).mean() > 0.5 and not np.array_equal(pasted, clip.frames[2])


@pytest.mark.parametrize(
    ("options", "named"),
    [
        (["--curve", "quadratic"], dict(curve="quadratic")),
        (["--blur-in", "encoded", "--noise-model", "lines"], dict(blur_in="encoded", noise_model="lines")),
        (["--method", "removal"], dict(method="removal")),
        (["--method", "removal", "--network", "none"], dict(method="removal", networks=["none"])),
        (["--method", "removal", "--clean", CLIP / "without"], dict(method="removal", clean=CLIP / "without")),
    ],
    ids=str,
)
def test_how_it_is_estimated_is_as_in_the_command_line(blindaug, clip, options, named):
    wanted = blindaug("estimate", FRAMES, "--frames", "1..2", "--depth", SCENE, *options, "--json")
    frames, depth = clip.frames[:2], clip.depth[:2]
    assert ba.estimate(frames, depth=depth, **named).to_json() == wanted
    assert ba.estimate(frames, depth=depth).to_json() != wanted


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
    """Models without their noise: that of a clip is a mean over the frames around each, a Tracker gives what it knows."""
    return [{name: part for name, part in json.loads(line).items() if name != "noise"} for line in lines]


def test_a_track_is_that_of_the_command_line(blindaug, clip):
    wanted = blindaug("estimate", FRAMES, "--track", "--json").splitlines()
    assert len(wanted) == 5
    for given in (FRAMES, clip.frames):
        assert [cam.to_json() for cam in ba.track(given)] == wanted
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
        assert [cam.to_json() for cam in track] == wanted
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
