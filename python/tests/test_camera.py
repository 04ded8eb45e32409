"""A camera and its parts."""

import json
import logging
import pickle

import numpy as np
import pytest

import blindaug as ba
from conftest import CLIP


def test_what_is_known_has_a_value_and_an_interval(camera):
    exposure = camera.exposure
    low, high = exposure.interval
    assert exposure.known and low <= exposure.value <= high and exposure.reason is None and exposure.reason_code is None
    # The truth lies within the interval.
    assert low <= 0.6 <= high and low > 0.3
    assert exposure.shutter_angle == pytest.approx(360 * exposure.value, rel=1e-5)
    assert exposure.seconds == pytest.approx(exposure.value / 30)
    assert exposure.method == "spectral" and exposure.samples > 0
    file = json.loads(camera.to_json())
    assert exposure.value == file["motion_blur"]["exposure"] and [low, high] == file["motion_blur"]["interval"]
    assert camera.width == camera.height == 272 and camera.fps == 30 and camera.frames_used == 5


def test_what_is_unknown_says_why(clip):
    still = ba.estimate(np.stack([clip.frames[0]] * 3))
    exposure = still.exposure
    assert exposure.value is None and exposure.interval is None and exposure.shutter_angle is None and not exposure.known
    assert exposure.reason and exposure.reason_code in {"no_motion", "not_estimated", "too_short"}
    assert not still.defocus.known and still.defocus.focus_m is None
    with pytest.raises(ba.UnknownError, match="defocus is unknown: "):
        still.defocus.sigma_px(2.0)
    assert "unknown" in repr(exposure) and exposure.reason in still._repr_html_()


def test_noise_maps_luminances_to_stds(camera):
    noise = camera.noise
    one = noise.std(0.5)
    assert one.shape == (3,) and one.dtype == np.float32 and (one > 0).all()
    assert np.array_equal(noise.std(), one) and np.array_equal(noise.std(luminance=0.5), one)
    several = noise.std(np.array([[0.1, 0.5], [0.9, 0.5]]))
    assert several.shape == (2, 2, 3) and np.array_equal(several[0, 1], one) and not np.array_equal(several[0, 0], one)
    lines = json.loads(camera.to_json())["noise"]["levels"]
    for level in range(4):
        wanted = np.array(lines[level]["slope"]) * 0.25 + np.array(lines[level]["intercept"])
        assert noise.std(0.25, level=level) == pytest.approx(wanted.clip(0), rel=1e-5)
    with pytest.raises(ba.Error, match="level: "):
        noise.std(0.5, level=4)
    with pytest.raises(ba.Error, match="luminance: "):
        noise.std("bright")


def test_facts_are_those_of_the_command_line(camera, blindaug, tmp_path):
    camera.write(tmp_path / "camera.json")
    facts = camera.facts()
    assert facts == json.loads(blindaug("inspect", tmp_path / "camera.json", "--json"))
    middle = facts["noise"]["std_of_encoded_rgb"][1]
    assert middle["std"] == pytest.approx(camera.noise.std(middle["luminance"]), rel=1e-5)
    assert all(low < std < high for (low, high), std in zip(middle["interval"], middle["std"]))
    # Another camera has others.
    other = camera.to_json().replace('"method": "spectral"', '"method": "given"')
    assert ba.Camera.from_json(other).facts() != facts


def test_defocus_maps_depths_to_stds(camera):
    lens = camera.defocus
    assert lens.depth_kind == "metric" and lens.focus_m == pytest.approx(1 / lens.focus_inverse_depth, rel=1e-5)
    assert isinstance(lens.sigma_px(2.0), float)
    depths = np.array([[0.5, lens.focus_m], [np.inf, 0.0]])
    sigma = lens.sigma_px(depths)
    infinity, focus = lens.sigma_px_at_infinity, lens.focus_m
    assert sigma.shape == (2, 2) and sigma.dtype == np.float32
    assert sigma[0, 0] == pytest.approx(infinity * abs(1 - focus / 0.5), rel=1e-4)
    assert sigma[0, 1] == pytest.approx(0, abs=1e-4) and sigma[1, 0] == pytest.approx(infinity) and np.isnan(sigma[1, 1])
    assert lens.sigma_px(inverse_depth=0.5) == pytest.approx(lens.sigma_px(2.0))
    for wrong in [{}, {"depth_m": 1.0, "inverse_depth": 1.0}]:
        with pytest.raises(ba.Error, match="depth_m: "):
            lens.sigma_px(**wrong)


def test_a_relative_lens_is_brought_to_metres(clip):
    relative = ba.estimate(clip.frames)
    assert relative.defocus.depth_kind == "relative" and relative.defocus.focus_m is None
    with pytest.raises(ba.Error, match="to_metric"):
        relative.defocus.sigma_px(2.0)
    with pytest.raises(ba.Error, match="to_metric"):
        ba.composite(clip.frames[0], clip.layers[0], relative, layer_depth=2.0)
    scaled = relative.to_metric(0.8, 0.05)
    assert scaled.defocus.sigma_px(2.0) == pytest.approx(relative.defocus.sigma_px(inverse_depth=0.8 / 2 + 0.05), rel=1e-4)
    depth = json.loads(relative.to_json())["scene_depth"]
    assert depth
    placed = None
    for y in range(8, 272, 16):
        for x in range(8, 272, 16):
            try:
                placed = relative.to_metric(at=[(x, y, 3.0)])
            except ba.Error as e:
                assert str(e).startswith("at: ")
    assert placed is not None and placed.defocus.depth_kind == "metric"
    for wrong in [dict(), dict(scale=-1.0), dict(scale=1.0, at=[(1, 1, 1)]), dict(at=[(1, 1, 0)]), dict(at=[])]:
        with pytest.raises(ba.Error, match="^(scale|at): "):
            relative.to_metric(**wrong)


def test_cameras_are_written_read_compared_and_pickled(camera, clip, tmp_path):
    file = tmp_path / "camera.json"
    camera.write(file)
    assert file.read_text() == camera.to_json()
    for same in [ba.Camera.read(file), ba.Camera.from_json(camera.to_json()), pickle.loads(pickle.dumps(camera))]:
        assert same == camera and same.to_json() == camera.to_json() and same.frame is None
    assert camera != ba.estimate(clip.frames) and camera != 1
    tracked = list(ba.track(clip.frames))
    again = pickle.loads(pickle.dumps(tracked))
    assert again == tracked and again[4].frame == 5 and again[3] != again[4]
    lines = tmp_path / "track.jsonl"
    ba.write_track(lines, tracked)
    assert ba.read_track(lines) == tracked and ba.read_track(file) == [camera]
    with pytest.raises(ba.FileError, match="track.jsonl: holds 5 cameras"):
        ba.Camera.read(lines)
    with pytest.raises(ba.Error, match="cameras: "):
        ba.write_track(lines, [camera])
    with pytest.raises(ba.Error, match="cameras: "):
        ba.write_track(lines, tracked[::-1])
    assert ba.read_track(lines) == tracked


def test_words_tables_and_reports(clip, camera, tmp_path):
    assert "Exposure" in str(camera) and "shutter angle" in str(camera)
    html = camera._repr_html_()
    assert html.startswith("<table>") and html.count("<tr>") >= 4 and "exposure" in html
    page = tmp_path / "page.html"
    with pytest.raises(ba.Error, match="samples=True"):
        camera.report(page)
    assert not page.exists()
    kept = ba.estimate(CLIP / "frames", samples=True)
    kept.report(page)
    text = page.read_text()
    assert "The camera of frames" in text and "data:image/png" in text and text.rstrip().endswith("</html>")
    with pytest.raises(ba.FileError):
        kept.report(tmp_path / "no" / "page.html")


def test_progress_notes_and_warnings(clip, caplog):
    told = []
    with caplog.at_level(logging.INFO, logger="blindaug"):
        cam = ba.estimate(clip.frames, depth=[clip.depth[0], None, None, None, clip.depth[4]], progress=lambda *a: told.append(a))
    assert told == [(n, 5) for n in range(1, 6)]
    assert any("2 of 5 frames have it" in r.getMessage() for r in caplog.records)
    told.clear()
    ba.estimate(iter(clip.frames), progress=lambda *a: told.append(a))
    assert told == [(n, None) for n in range(1, 6)]
    assert cam.notes == [] or all(isinstance(n, str) for n in cam.notes)
    with pytest.warns(UserWarning, match=r"layer_motion gives it one"):
        ba.composite(clip.frames[0], clip.layers[0], cam, layer_depth=2.0)
    with pytest.warns(UserWarning, match="without depth nothing is defocused"):
        ba.apply(clip.without[0], cam)


def test_the_kind_of_values_stays(clip, camera):
    given = dict(layer_depth=clip.layer_depth[2], layer_motion=clip.layer_motion[2], depth=clip.depth[2], number=3)
    eight = clip.frames[2]
    wanted = ba.composite(eight, clip.layers[2], camera, **given)
    kinds = {
        np.uint8: (eight, 0.0),
        np.uint16: (eight.astype(np.uint16) * 257, 0.6),
        np.float16: ((eight / 255).astype(np.float16), 1.2),
        np.float32: ((eight / 255).astype(np.float32), 0.51),
        np.float64: (eight / 255, 0.51),
    }
    for kind, (frame, tolerance) in kinds.items():
        made = ba.composite(frame, clip.layers[2], camera, **given)
        scale = 255 / np.iinfo(kind).max if np.issubdtype(kind, np.integer) else 255
        assert made.dtype == kind and made.shape == eight.shape
        assert np.abs(made.astype(float) * scale - wanted).max() <= tolerance, kind
    # Light comes back as light, and above white too.
    light = (eight / 255.0) ** 2.2 * 3
    made = ba.composite(light, clip.layers[2], camera, colour_space="linear-srgb", **given)
    same = np.isclose(made, light, rtol=1e-3, atol=1e-5).all(axis=-1).mean()
    assert made.max() > 1.5 and 0.7 < same < 1
