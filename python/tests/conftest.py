"""The clip that `blindaug demo` uses, the camera that is estimated from it, and the command line as the reference."""

import os
import signal
import subprocess
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from PIL import Image

import blindaug as ba

ROOT = Path(__file__).resolve().parents[2]
CLIP = ROOT / "apps/cli/assets/demo"
NUMBERS = range(1, 6)


def picture(path: Path) -> np.ndarray:
    return np.asarray(Image.open(path))


def exr(path: Path, *names: str) -> np.ndarray:
    channels = OpenEXR.File(str(path), separate_channels=True).channels()
    return np.stack([channels[name].pixels for name in names], axis=-1)


class Clip:
    """The demo's clip as arrays, the frames first."""

    def __init__(self) -> None:
        def pictures(folder: str) -> np.ndarray:
            return np.stack([picture(CLIP / folder / f"{n:04}.png") for n in NUMBERS])

        def channels(folder: str, *names: str) -> np.ndarray:
            return np.stack([exr(CLIP / folder / f"{n:04}.exr", *names) for n in NUMBERS])

        self.frames = pictures("frames")
        self.with_, self.without = pictures("with"), pictures("without")
        self.depth = channels("scene", "Z")[..., 0]
        self.flow = channels("scene", "forward.u", "forward.v")
        self.layers = channels("virtual", "R", "G", "B", "A")
        self.layer_depth = channels("virtual", "Z")[..., 0]
        self.layer_motion = channels("virtual", "forward.u", "forward.v")


@pytest.fixture(scope="session")
def clip() -> Clip:
    return Clip()


@pytest.fixture(scope="session")
def camera(clip: Clip) -> ba.Camera:
    return ba.estimate(clip.frames, depth=clip.depth, flow=clip.flow, fps=30)


@pytest.fixture
def interruptible():
    """Ctrl-C is heard here and in new processes, also where the tests run in the background, which is deaf to it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.fixture(scope="session")
def program() -> str:
    """The program `blindaug` that was built from the same sources: BLINDAUG=PROGRAM, else the one in the target folder."""
    folder = Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target"))
    named = [Path(os.environ["BLINDAUG"])] if "BLINDAUG" in os.environ else []
    built = [p for p in [*named, folder / "release/blindaug", folder / "debug/blindaug"] if p.is_file()]
    if not built:
        pytest.skip("there is no command line to compare with: cargo build -p blindaug-cli")
    return str(built[0])


@pytest.fixture(scope="session")
def blindaug(program):
    """Runs the program, and gives what it prints."""

    def run(*arguments: object) -> str:
        command = [program, *map(str, arguments)]
        return subprocess.run(command, check=True, capture_output=True, text=True, encoding="utf-8").stdout

    return run
