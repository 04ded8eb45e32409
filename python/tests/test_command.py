"""The command that the package installs is the program `blindaug`."""

import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from conftest import CLIP

FRAMES, SCENE = CLIP / "frames", CLIP / "scene"
SCRIPT = Path(sys.executable).with_name("blindaug")
COMMANDS = [[sys.executable, "-m", "blindaug"]] + ([[str(SCRIPT)]] if SCRIPT.is_file() else [])


def ran(command, arguments, folder):
    """The exit status, what is printed but for the progress of slow machines, and the files that are written."""
    folder.mkdir()
    result = subprocess.run([*command, *map(str, arguments)], capture_output=True, cwd=folder)
    said = re.sub(rb"(?m)^[a-z]+: \d+ of \d+ frames.*\n", b"", result.stderr)
    files = {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}
    return result.returncode, result.stdout, said, files


@pytest.mark.parametrize("command", COMMANDS, ids=["module", "script"][: len(COMMANDS)])
@pytest.mark.parametrize(
    ("arguments", "status", "files"),
    [
        (["estimate", FRAMES, "--depth", SCENE, "--frames", "1..3", "-o", "camera.json"], 0, 1),
        (["composite", FRAMES, "--virtual", CLIP / "virtual", "--naive", "-o", "out"], 0, 5),
        (["inspect", "no-such-camera.json"], 1, 0),
        (["estimate", CLIP / "virtual" / "no", "-o", "camera.json"], 1, 0),
        (["estimate"], 2, 0),
        (["composite", FRAMES, "--virtual"], 2, 0),
        ([], 2, 0),
        (["--help"], 0, 0),
        (["help", "apply"], 0, 0),
        (["--version"], 0, 0),
        (["export", "--list"], 0, 0),
        (["models", "list"], 0, 0),
        (["completions", "bash"], 0, 0),
        (["man", "-o", "man"], 0, 19),
    ],
    ids=lambda value: " ".join(map(str, value))[:40] if isinstance(value, list) else None,
)
def test_it_prints_and_writes_what_the_program_does(program, tmp_path, command, arguments, status, files):
    theirs, ours = ran([program], arguments, tmp_path / "theirs"), ran(command, arguments, tmp_path / "ours")
    assert ours == theirs
    assert ours[0] == status and len(ours[3]) >= files and ours[1] + ours[2] != b""
    # Negative control: other arguments, another result.
    assert ran(command, ["--no-such-option", *arguments], tmp_path / "other") != ours


def test_a_report_names_the_command(tmp_path):
    arguments = ["estimate", FRAMES, "--frames", "1..3", "-o", "camera.json", "--report", "page.html"]
    status, _, _, files = ran(COMMANDS[0], arguments, tmp_path / "out")
    page = files["page.html"].decode()
    assert status == 0 and f"blindaug {' '.join(map(str, arguments))}" in page and "-m blindaug" not in page


@pytest.mark.skipif(os.name != "posix", reason="signals are sent")
def test_ctrl_c_stops_it_after_a_frame(program, tmp_path, interruptible):
    folder = tmp_path / "many"
    folder.mkdir()
    for i in range(2000):
        (folder / f"{i:04}.png").symlink_to(FRAMES / f"{1 + i % 5:04}.png")
    track = ["estimate", folder, "--track", "--json"]
    for command in [[program], *COMMANDS]:
        process = subprocess.Popen([*command, *map(str, track)], stdout=subprocess.PIPE, stderr=subprocess.PIPE)
        # The first line says that it is at work.
        assert process.stdout.readline().startswith(b"{")
        process.send_signal(signal.SIGINT)
        began = time.monotonic()
        _, said = process.communicate(timeout=60)
        assert process.returncode == 130 and time.monotonic() - began < 20, said
        assert b"stopping after this frame" in said and b"Traceback" not in said and b"KeyboardInterrupt" not in said
