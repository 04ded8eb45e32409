"""The lines of docs/python.md run."""

import doctest
import logging
import types

import av
import numpy as np
import pytest
from PIL import Image

import blindaug as ba
from conftest import CLIP, ROOT

logging.getLogger("blindaug").addHandler(logging.NullHandler())


@pytest.mark.filterwarnings("ignore")
def test_the_lines_of_the_page_run(clip, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "shot").symlink_to(CLIP / "frames")
    (tmp_path / "scene").symlink_to(CLIP / "scene")
    names = dict(
        frames=clip.frames,
        frame=clip.frames[2],
        rgb=clip.without[2],
        depths=clip.depth,
        z=clip.depth[2],
        uv=clip.flow[2],
        layer=clip.layers[2],
        object_z=clip.layer_depth[2],
        object_uv=clip.layer_motion[2],
        matte=np.zeros((272, 272), np.uint8),
    )
    Image.fromarray(clip.frames[2]).save(tmp_path / "frame.png")
    with av.open(str(tmp_path / "clip.mp4"), "w") as video:
        stream = video.add_stream("mpeg4", rate=30)
        stream.width, stream.height, stream.pix_fmt, stream.bit_rate = 272, 272, "yuv420p", 8_000_000
        for picture in [*clip.frames, None]:
            video.mux(stream.encode(None if picture is None else av.VideoFrame.from_ndarray(picture, format="rgb24")))
    text = (ROOT / "docs/python.md").read_text(encoding="utf-8")
    # The fences are no part of what is expected.
    text = "\n".join("" if line.startswith("```") else line for line in text.splitlines())
    test = doctest.DocTestParser().get_doctest(text, names, "python.md", "docs/python.md", 0)
    assert len(test.examples) > 25
    runner = doctest.DocTestRunner()
    runner.run(test)
    assert runner.failures == 0


def test_the_package_s_own_page_names_what_there_is():
    text = (ROOT / "python/README.md").read_text(encoding="utf-8")
    for name in ["estimate", "composite"]:
        assert f"ba.{name}(" in text and hasattr(ba, name)
    # Modules such as `blindaug.archive` are there once something has imported them.
    public = {n for n in dir(ba) if not n.startswith("_") and not isinstance(getattr(ba, n), types.ModuleType)}
    assert set(ba.__all__) == public | {"__version__"}
