"""Tables of many clips, without a cluster. python/check-archive.sh kills workers, machines and drivers of Ray."""

import csv
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from conftest import CLIP, ROOT
from PIL import Image

import blindaug as ba

pytest.importorskip("pyarrow", reason="tables need pyarrow: pip install pyarrow")
from blindaug import archive  # noqa: E402


def read(table: Path) -> list[dict]:
    import pyarrow.parquet

    return pyarrow.parquet.read_table(table).to_pylist()


def repeated(rows: list[dict]) -> list[dict]:
    return [{k: v for k, v in row.items() if k not in archive.NOT_REPEATED} for row in rows]


@pytest.fixture(scope="module")
def clips(tmp_path_factory) -> Path:
    """Four clips: two good ones, one with a cut, one that is broken."""
    folder = tmp_path_factory.mktemp("clips")
    for name, frames in (("a", (1, 2, 3)), ("b", (2, 3, 4))):
        (folder / name).mkdir()
        for n in frames:
            shutil.copy(CLIP / f"frames/{n:04}.png", folder / name)
    (folder / "cut").mkdir()
    for n in (1, 2, 3):
        shutil.copy(CLIP / f"frames/{n:04}.png", folder / "cut")
        # Another picture: the same, upside down.
        picture = np.asarray(Image.open(CLIP / f"frames/{n:04}.png"))
        Image.fromarray(np.ascontiguousarray(picture[::-1])).save(folder / f"cut/{n + 3:04}.png")
    (folder / "broken.mp4").write_bytes(b"no video" * 100)
    return folder


@pytest.fixture(scope="module")
def whole(clips, tmp_path_factory) -> list[dict]:
    """The rows of an archive that nothing disturbed."""
    table = tmp_path_factory.mktemp("whole") / "t.parquet"
    told = []
    result = archive.archive(clips, table, workers=2, progress=lambda *numbers: told.append(numbers))
    assert (result.clips, result.looked_at, result.failed, result.rows) == (4, 4, 1, 5)
    assert told[0] == (0, 4, 0) and told[-1] == (4, 4, 1)
    assert [p.name for p in table.parent.iterdir()] == ["t.parquet"]
    return read(table)


def test_a_row_holds_the_numbers_of_its_shot(clips, whole) -> None:
    rows = {(Path(row["id"]).name, row["shot"]): row for row in whole}
    assert list(rows) == [("a", 1), ("b", 1), ("broken.mp4", None), ("cut", 1), ("cut", 2)]
    for (name, shot), frames in {("a", 1): None, ("cut", 1): (1, 3), ("cut", 2): (4, 6)}.items():
        row, camera = rows[name, shot], ba.estimate(clips / name, frames=frames)
        assert ba.Camera.from_json(row["camera"]) == camera
        assert (row["exposure"], row["exposure_reason"]) == (camera.exposure.value, camera.exposure.reason)
        assert (row["exposure_low"], row["exposure_high"]) == (camera.exposure.interval or (None, None))
        assert row["noise_5_g"] == camera.noise.std(0.5)[1]
        assert row["defocus_infinity_px"] == camera.defocus.sigma_px_at_infinity
        assert row["sharpening_code"] == camera.sharpening.reason_code
        assert (row["frames"], row["width"], row["error"], row["version"]) == (3, 272, None, ba.__version__)
        # A number or a reason.
        for part in ("exposure", "defocus"):
            value = row["exposure" if part == "exposure" else "defocus_infinity_px"]
            assert (value is None) != (row[f"{part}_reason"] is None)
    assert [rows["cut", n]["shots"] for n in (1, 2)] == [2, 2]
    assert (rows["cut", 2]["first_frame"], rows["cut", 2]["last_frame"]) == (4, 6)
    assert rows["broken.mp4", None]["error"].startswith(str(clips / "broken.mp4"))
    assert "\n" not in rows["broken.mp4", None]["error"]
    # Negative control: the clips are not the same.
    assert rows["a", 1]["camera"] != rows["b", 1]["camera"]


def test_the_rows_do_not_depend_on_workers_or_on_how_clips_are_named(clips, whole, tmp_path) -> None:
    names = sorted({row["id"] for row in whole})
    with (tmp_path / "table.csv").open("w", newline="") as file:
        table = csv.writer(file)
        table.writerow(["note", "path", "id"])
        table.writerows(("", os.path.relpath(name, tmp_path), name) for name in reversed(names))
    archive.archive(tmp_path / "table.csv", tmp_path / "t.parquet", workers=1)
    rows = repeated(read(tmp_path / "t.parquet"))
    for row, other in zip(rows, repeated(whole), strict=True):
        # Only the paths are written in another way.
        error = (row.pop("error"), other.pop("error"))
        assert (error[0] is None) == (error[1] is None)
        assert os.path.samefile(row.pop("path"), other.pop("path")) and row == other
    assert [c for c, _ in archive.clips_of([clips / "*"])] == names


def test_what_is_done_is_not_done_again_but_errors_are(clips, whole, tmp_path) -> None:
    table = tmp_path / "t.parquet"
    archive.archive(clips / "a", tmp_path / "t.parquet")
    first = read(table)
    result = archive.archive(clips, table)
    assert (result.looked_at, result.rows) == (3, 5)
    rows = read(table)
    assert rows[0] == first[0]
    assert repeated(rows) == repeated(whole)
    # Only the broken one is tried again, and rows of other clips stay.
    result = archive.archive(clips / "broken.mp4", table)
    assert (result.looked_at, result.failed, result.rows) == (1, 1, 5)
    assert repeated(read(table)) == repeated(whole)


def test_a_killed_worker_costs_no_row(clips, whole, tmp_path, monkeypatch) -> None:
    killed = []
    running = archive.Worker._running

    def kill_once(worker):
        process = running(worker)
        if not killed:
            killed.append(process.pid)
            os.kill(process.pid, signal.SIGKILL if hasattr(signal, "SIGKILL") else signal.SIGTERM)
        return process

    monkeypatch.setattr(archive.Worker, "_running", kill_once)
    archive.archive(clips, tmp_path / "t.parquet", workers=2)
    assert len(killed) == 1
    assert repeated(read(tmp_path / "t.parquet")) == repeated(whole)


def test_a_clip_that_ends_its_process_or_takes_too_long_is_a_row(clips, tmp_path, monkeypatch) -> None:
    running = archive.Worker._running

    def kill(worker):
        process = running(worker)
        process.kill()
        return process

    monkeypatch.setattr(archive.Worker, "_running", kill)
    archive.archive(clips / "a", tmp_path / "t.parquet")
    (row,) = read(tmp_path / "t.parquet")
    assert "ended" in row["error"] and "twice" in row["error"] and row["exposure"] is None
    monkeypatch.undo()
    archive.archive(clips / "a", tmp_path / "late.parquet", timeout=0.01)
    (row,) = read(tmp_path / "late.parquet")
    assert "longer than 0.01 s" in row["error"]


def test_memory_that_does_not_suffice_is_a_row(clips, tmp_path) -> None:
    archive.archive(clips / "a", tmp_path / "t.parquet", memory=4_000_000)
    (row,) = read(tmp_path / "t.parquet")
    assert "memory" in row["error"]


def command(*arguments: object) -> subprocess.Popen:
    return subprocess.Popen(
        [sys.executable, "-m", "blindaug.archive", *map(str, arguments)], stderr=subprocess.PIPE, text=True
    )


def wait_for_rows(table: Path, process: subprocess.Popen, number: int) -> None:
    """Waits until so many clips are kept beside the table."""
    partial, until = table.with_name(table.name + ".partial"), time.monotonic() + 120
    while sum(p.read_bytes().count(b"\n") for p in partial.glob("*.jsonl")) < number:
        assert process.poll() is None and time.monotonic() < until
        time.sleep(0.02)


@pytest.mark.skipif(os.name == "nt", reason="Windows has no such signals")
@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGKILL"])
def test_a_stopped_archive_goes_on_where_it_was(clips, whole, tmp_path, name, interruptible) -> None:
    table = tmp_path / "t.parquet"
    process = command(clips, "-o", table, "--workers", 1)
    wait_for_rows(table, process, 2)
    number = getattr(signal, name)
    process.send_signal(number)
    said = process.communicate(timeout=60)[1]
    assert not table.exists()
    if name == "SIGKILL":
        # The line that was being written is cut.
        journal = next(table.with_name("t.parquet.partial").glob("*.jsonl"))
        with journal.open("ab") as file:
            file.write(b'{"id": "cu')
    else:
        assert process.returncode == 128 + number and "to go on" in said
    again = command(clips, "-o", table, "--workers", 1)
    said = again.communicate(timeout=120)[1]
    assert again.returncode == 0, said
    # At least the first two were kept; the broken one is tried again.
    looked_at = int(said.split("rows; ")[1].split(" of 4")[0])
    assert looked_at <= 3, said
    assert repeated(read(table)) == repeated(whole)
    assert [p.name for p in tmp_path.iterdir()] == ["t.parquet"]


@pytest.mark.skipif(os.name == "nt", reason="there is no lock on Windows")
def test_two_at_one_table_do_not_disturb_each_other(clips, tmp_path) -> None:
    first = command(clips, "-o", tmp_path / "t.parquet", "--workers", 1)
    wait_for_rows(tmp_path / "t.parquet", first, 1)
    second = command(clips, "-o", tmp_path / "t.parquet")
    said = second.communicate(timeout=60)[1]
    assert second.returncode == 1 and "another process" in said
    assert first.wait(timeout=120) == 0
    first.communicate()


def test_files_in_an_object_store_are_copied_for_a_while(clips, whole) -> None:
    (row,) = archive.rows_of("x", (clips / "broken.mp4").as_uri())
    assert row["error"].startswith("file://") and "blindaug-" not in row["error"]
    picture = clips / "a/0001.png"
    (here,), (copied,) = (archive.rows_of("x", path) for path in (str(picture), picture.as_uri()))
    assert here["noise_5_g"] is not None
    different = {k for k in here if here[k] != copied[k]}
    assert different <= {"path", "seconds"}
    assert (here["path"], copied["path"]) == (str(picture), picture.as_uri())


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("id,file\n1,a\n", "must name the columns id and path"),
        ("id,path\n1,a\n1,b\n", "1: two clips have this id"),
        ("id,path\n1,\n", "line 2 has no id or no path"),
    ],
)
def test_tables_that_cannot_be_used_are_said(tmp_path, text, sentence) -> None:
    (tmp_path / "t.csv").write_text(text)
    with pytest.raises(ba.Error, match=sentence):
        archive.archive(tmp_path / "t.csv", tmp_path / "t.parquet")
    assert [p.name for p in tmp_path.iterdir()] == ["t.csv"]


def test_inputs_and_outputs_that_cannot_be_used_are_said(clips, tmp_path) -> None:
    (tmp_path / "empty").mkdir()
    other = tmp_path / "other.parquet"
    other.write_bytes(b"no table")
    for arguments, sentence in [
        ((tmp_path / "nothing", tmp_path / "t.parquet"), "there is no such file"),
        ((tmp_path / "empty", tmp_path / "t.parquet"), "has no videos"),
        ((clips / "*.mov", tmp_path / "t.parquet"), "no video and no folder"),
        ((clips, other), "is no table of blindaug"),
    ]:
        with pytest.raises(ba.Error, match=sentence):
            archive.archive(*arguments)
    assert other.read_bytes() == b"no table"
    process = command(tmp_path / "nothing", "-o", tmp_path / "t.parquet")
    said = process.communicate()[1]
    assert process.returncode == 1 and said.count("\n") == 1 and said.startswith("blindaug archive: ")


def test_columns_are_explained() -> None:
    page = (ROOT / "docs/archive.md").read_text(encoding="utf-8")
    for name, *_ in archive.COLUMNS:
        stem = name if not name.startswith("noise_") or name[6:7] not in "159" else "noise_1_r"
        assert f"`{stem}`" in page, name
