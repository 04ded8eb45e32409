"""Blender with the extension installed from its archive, as users install it, and the command line as the reference.

EXTENSION: the archive that build.sh made. BLINDAUG: the program. BLENDER_USER_RESOURCES: an empty folder, in which Blender installs.
"""

import importlib
import json
import os
import subprocess
from pathlib import Path

import bpy
import pytest

ROOT = Path(__file__).resolve().parents[3]
DEMO = ROOT / "apps/cli/assets/demo"
MODULE = "bl_ext.user_default.blindaug"


@pytest.fixture(scope="session")
def archive() -> Path:
    return Path(os.environ["EXTENSION"])


@pytest.fixture(scope="session")
def installed(archive):
    """The add-on's package."""
    assert not list(Path(os.environ["BLENDER_USER_RESOURCES"]).iterdir()), "the folder of installed extensions is not empty"
    bpy.ops.preferences.addon_enable(module="bl_pkg")
    done = bpy.ops.extensions.package_install_files(filepath=str(archive), repo="user_default", enable_on_install=True)
    assert done == {"FINISHED"}
    assert MODULE in bpy.context.preferences.addons
    return importlib.import_module(MODULE)


def start_scene(size=(272, 272)):
    """An empty scene with a camera."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    scene = bpy.context.scene
    bpy.ops.object.camera_add()
    scene.camera = bpy.context.object
    scene.render.resolution_x, scene.render.resolution_y = size
    scene.frame_end = 250
    return scene


@pytest.fixture
def scene(installed):
    return start_scene()


@pytest.fixture
def load(scene):
    """Loads a clip as the scene's."""

    def clip(path):
        scene.active_clip = bpy.data.movieclips.load(str(path))
        return scene.active_clip

    return clip


@pytest.fixture(scope="session")
def blindaug():
    """Runs the command line."""

    def run(*arguments):
        command = [os.environ["BLINDAUG"], *map(str, arguments)]
        return subprocess.run(command, check=True, capture_output=True, text=True, encoding="utf-8").stdout

    return run


@pytest.fixture(scope="session")
def facts(blindaug):
    """What the command line says of a camera, with all intervals."""
    return lambda path: json.loads(blindaug("inspect", path, "--json"))


@pytest.hookimpl(trylast=True)
def pytest_sessionfinish(session, exitstatus):
    session.config.status = int(exitstatus)


@pytest.hookimpl(trylast=True)
def pytest_unconfigure(config):
    # Blender's module can hang while it shuts down.
    os._exit(getattr(config, "status", 1))
