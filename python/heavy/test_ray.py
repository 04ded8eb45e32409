"""Archives on Ray while workers, machines and drivers are killed: every clip must be in the table once, with the numbers of one machine."""

import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import duckdb
import numpy as np
import pandas
import psutil
import pyarrow.parquet
import pytest
import ray
from PIL import Image
from ray.cluster_utils import Cluster

import blindaug as ba
from blindaug import archive

FRAMES = Path(__file__).resolve().parents[2] / "apps/cli/assets/demo/frames"
STORE = 80 * 1024 * 1024


def read(table: Path) -> list[dict]:
    rows = pyarrow.parquet.read_table(table).to_pylist()
    return [{k: v for k, v in row.items() if k not in archive.NOT_REPEATED} for row in rows]


@pytest.fixture(scope="session")
def clips(tmp_path_factory) -> Path:
    """12 clips of 3 to 5 frames, all different, and a broken one."""
    folder = tmp_path_factory.mktemp("clips")
    for first, last in [(1, 3), (2, 4), (3, 5), (1, 4), (2, 5), (1, 5)]:
        for mirrored in range(2):
            clip = folder / f"{first}{last}{mirrored}"
            clip.mkdir()
            for n in range(first, last + 1):
                picture = np.asarray(Image.open(FRAMES / f"{n:04}.png"))
                picture = picture[:, :: -1 if mirrored else 1]
                Image.fromarray(np.ascontiguousarray(picture)).save(clip / f"{n:04}.png")
    (folder / "broken.mp4").write_bytes(b"no video" * 100)
    return folder


@pytest.fixture(scope="session")
def alone(clips, tmp_path_factory) -> list[dict]:
    """The rows of one machine, by one worker."""
    table = tmp_path_factory.mktemp("alone") / "t.parquet"
    begun = time.monotonic()
    archive.archive(clips, table, workers=1)
    one = time.monotonic() - begun
    begun = time.monotonic()
    archive.archive(clips, table.with_name("two.parquet"), workers=2)
    two = time.monotonic() - begun
    print(f"\none worker: {one:.1f} s, two: {two:.1f} s, {one / two:.2f} times as fast")
    rows = read(table)
    assert len(rows) == 13 and sum(row["error"] is not None for row in rows) == 1
    assert len({row["camera"] for row in rows}) == 13
    assert read(table.with_name("two.parquet")) == rows
    return rows


@pytest.fixture()
def cluster():
    """A head without processors, and two machines with one each."""
    own = Cluster(
        initialize_head=True,
        head_node_args={"num_cpus": 0, "object_store_memory": STORE, "include_dashboard": False},
    )
    nodes = [own.add_node(num_cpus=1, object_store_memory=STORE) for _ in range(2)]
    ray.init(address=own.address, logging_level="ERROR", log_to_driver=False)
    assert {node["NodeManagerAddress"] for node in ray.nodes()} == {"127.0.0.1"}
    yield own, nodes
    ray.shutdown()
    own.shutdown()


def later(when: int, act):
    """A progress function that calls `act` once, in a thread of its own, when so many clips are done."""
    acted = []

    def progress(done: int, total: int, failed: int) -> None:
        if done >= when and not acted:
            acted.append(threading.Thread(target=act))
            acted[0].start()

    return progress, acted


def test_ray_gives_the_rows_of_one_machine(clips, alone, tmp_path) -> None:
    times = []
    for workers in (1, 2):
        begun = time.monotonic()
        archive.archive(clips, tmp_path / f"{workers}.parquet", ray="local", workers=workers)
        times.append(time.monotonic() - begun)
        assert read(tmp_path / f"{workers}.parquet") == alone
        assert not ray.is_initialized()
    print(f"\nRay, one worker: {times[0]:.1f} s, two: {times[1]:.1f} s")


def test_a_killed_worker_of_ray_costs_no_row(clips, alone, cluster, tmp_path, monkeypatch) -> None:
    # Three or four clips in a task, so that some rows of the killed one have been handed on.
    monkeypatch.setattr(archive, "BLOCKS", 4)
    killed = []

    def kill() -> None:
        for process in psutil.process_iter(["cmdline"]):
            words = " ".join(process.info["cmdline"] or [])
            if words.startswith("ray::") and "_task" in words and process.ppid() != 1:
                killed.append(process.pid)
                os.kill(process.pid, signal.SIGKILL)
                return

    progress, acted = later(4, kill)
    archive.archive(clips, tmp_path / "t.parquet", ray="auto", progress=progress)
    acted[0].join()
    assert len(killed) == 1
    assert read(tmp_path / "t.parquet") == alone


def test_a_killed_machine_costs_no_row(clips, alone, cluster, tmp_path) -> None:
    own, nodes = cluster
    progress, acted = later(4, lambda: own.remove_node(nodes[1], allow_graceful=False))
    archive.archive(clips, tmp_path / "t.parquet", ray="auto", progress=progress)
    acted[0].join()
    assert sum(node["Alive"] for node in ray.nodes()) == 2
    assert read(tmp_path / "t.parquet") == alone


def test_a_killed_driver_is_followed_by_one_that_goes_on(clips, alone, tmp_path) -> None:
    table = tmp_path / "t.parquet"
    command = [sys.executable, "-m", "blindaug.archive", str(clips), "-o", str(table), "--ray", "--workers", "2"]
    driver = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    partial = tmp_path / "t.parquet.partial"
    kept = lambda: sum(p.read_bytes().count(b"\n") for p in partial.glob("*.jsonl"))  # noqa: E731
    while kept() < 5:
        assert driver.poll() is None
        time.sleep(0.1)
    driver.kill()
    driver.communicate()
    before = kept()
    assert not table.exists()
    again = subprocess.run(command, stderr=subprocess.PIPE, text=True)
    assert again.returncode == 0, again.stderr
    looked_at = int(again.stderr.split("rows; ")[1].split(" of 13")[0])
    # The broken clip, if it was done, is tried again.
    assert looked_at in (13 - before, 13 - before + 1), again.stderr
    assert read(table) == alone
    # Nothing of the killed driver goes on.
    time.sleep(5)
    left = [p for p in psutil.process_iter(["cmdline"]) if "raylet" in " ".join(p.info["cmdline"] or []) and p.is_running()]
    assert not left


def test_the_memory_of_a_worker_is_bounded(clips, tmp_path) -> None:
    """A clip that does not fit into a worker's memory is a row; what the others take is printed."""
    most = [0]
    done = threading.Event()

    def watch() -> None:
        while not done.wait(0.05):
            for process in psutil.Process().children(recursive=True):
                try:
                    most[0] = max(most[0], process.memory_info().rss)
                except psutil.Error:
                    pass

    watcher = threading.Thread(target=watch)
    watcher.start()
    archive.archive(clips, tmp_path / "t.parquet", workers=2, memory=500_000_000)
    done.set()
    watcher.join()
    print(f"\nthe largest worker: {most[0] / 1e6:.0f} MB of 500 MB")
    assert 20e6 < most[0] < 500e6
    large = tmp_path / "large"
    large.mkdir()
    for n in (1, 2):
        Image.new("RGB", (5000, 4000), (90, 90, 90)).save(large / f"{n}.png")
    archive.archive(large, tmp_path / "large.parquet", ray="local", workers=1, memory=500_000_000)
    (row,) = read(tmp_path / "large.parquet")
    assert "memory" in row["error"]


def test_tables_are_asked_by_duckdb_and_pandas(clips, tmp_path) -> None:
    table = tmp_path / "t.parquet"
    archive.archive(clips, table, workers=2)
    query = f"select id, exposure, exposure_low, exposure_high from '{table}' where exposure > 0.4 order by id"
    rows = duckdb.sql(query).fetchall()
    frame = pandas.read_parquet(table)
    known = frame[frame.exposure > 0.4].sort_values("id")
    assert [row[0] for row in rows] == list(known.id) and 0 < len(rows) < 13
    assert all(low <= value <= high for _, value, low, high in rows)
    camera = ba.Camera.from_json(known.camera.iloc[0])
    assert camera.exposure.value == rows[0][1]
