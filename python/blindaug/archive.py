"""The cameras of many clips as one table: a row for each shot, in a Parquet file.

    python -m blindaug.archive clips/ -o cameras.parquet
    python -m blindaug.archive table.csv -o cameras.parquet --ray

Each clip is estimated in a process of its own, so that a clip that cannot be used, or even ends its process, is a row with an error. What is done is
kept beside the table until it is complete, and the same call goes on from there. docs/archive.md has the columns and what was measured.
Needs ``pip install blindaug[archive]`` (pyarrow), or ``blindaug[ray]`` for clusters.
"""

from __future__ import annotations

import argparse
import contextlib
import csv
import glob
import importlib
import json
import logging
import os
import queue
import signal
import subprocess
import sys
import tempfile
import threading
import time
import warnings
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, TypeAlias

import blindaug as ba

Row: TypeAlias = dict[str, Any]
# A clip's id and its path.
Clip: TypeAlias = tuple[str, str]
# The ids and rows of clips, as they are done.
_Looks: TypeAlias = Generator[tuple[str, list[Row]], None, None]

# The columns of the table: their names, their types in Arrow, and what they mean.
COLUMNS: list[tuple[str, str, str]] = [
    ("id", "string", "the clip's id; ids are in order"),
    ("path", "string", "the clip's path as it was given"),
    ("shot", "int32", "the number of the shot in the clip, from 1 on; null if the clip could not be read"),
    ("shots", "int32", "the number of shots in the clip"),
    ("first_frame", "int64", "the number of the shot's first frame"),
    ("last_frame", "int64", "the number of the shot's last frame"),
    ("frames", "int32", "the frames from the first to the last one"),
    ("width", "int32", "px"),
    ("height", "int32", "px"),
    ("fps", "float64", "frames per second, where the clip says it"),
    ("exposure", "float64", "the exposure fraction, in [0, 1]; null if unknown"),
    ("exposure_low", "float64", "its 95 % interval"),
    ("exposure_high", "float64", ""),
    ("exposure_seconds", "float64", "the exposure time, s, where the frame rate is known"),
    ("exposure_fits_low", "float64", "of an unknown exposure: the fractions that fit, where the shot tells that much"),
    ("exposure_fits_high", "float64", ""),
    ("exposure_code", "string", "why the exposure is unknown, for programs: no_motion, .."),
    ("exposure_reason", "string", "why the exposure is unknown, in words"),
    *(
        (f"noise_{light}_{channel}", "float64", f"the std of {channel.upper()} as encoded values over a grey of luminance 0.{light}")
        for light in (1, 5, 9)
        for channel in "rgb"
    ),
    ("noise_clip", "float64", "the encoded value from which on the sensor clips"),
    ("noise_temporal_correlation", "float64", "of a frame's noise with that of the frame before it"),
    ("noise_code", "string", "why the noise is unknown"),
    ("noise_reason", "string", ""),
    ("defocus_infinity_px", "float64", "the std of the blur at infinity, px"),
    ("defocus_infinity_low", "float64", "its 95 % interval, px"),
    ("defocus_infinity_high", "float64", ""),
    ("focus_inverse_depth", "float64", "the inverse depth in focus, in the unit of depth_kind"),
    ("focus_low", "float64", "its 95 % interval"),
    ("focus_high", "float64", ""),
    ("focus_outside", "string", "nearer or beyond, if the focus lies outside of what was seen"),
    ("depth_kind", "string", "relative: inverse depth has a unit of its own in each shot; metric: 1/m"),
    ("defocus_code", "string", "why the lens is unknown"),
    ("defocus_reason", "string", ""),
    ("sharpening", "float64", "the amount of the unsharp mask"),
    ("sharpening_low", "float64", "its 95 % interval"),
    ("sharpening_high", "float64", ""),
    ("sharpening_radius_px", "float64", "px"),
    ("sharpening_code", "string", "why the sharpening is unknown"),
    ("sharpening_reason", "string", ""),
    ("warnings", "list", "what makes the numbers less sure than their intervals say"),
    ("camera", "string", "the text of camera.json, for blindaug.Camera.from_json and every command"),
    ("error", "string", "why the clip or the shot could not be used; null if it could"),
    ("version", "string", "the version of blindaug"),
    ("seconds", "float64", "how long it took, s; the search for cuts counts in the first shot"),
]
# What is not the same each time.
NOT_REPEATED = ("seconds",)

VIDEOS = {"." + name for name in "mp4 mov m4v mkv webm avi mpg mpeg ts mts m2ts mxf wmv flv ogv 3gp y4m".split()}
IMAGES = {"." + name for name in "png jpg jpeg tif tiff bmp ppm exr".split()}
# The most blocks of clips that are handed to Ray: each costs its driver some kilobytes.
BLOCKS = 10_000
# The rows of a group of the table, which are in memory at once.
GROUP = 1024


@dataclass(frozen=True)
class Settings:
    """How a clip is looked at."""

    # The memory that a worker may take, bytes; 0: half of what the machine has.
    memory: int = 0
    # The time after which a clip is given up, s.
    timeout: float = 3600.0
    # The threads of a worker.
    threads: int = 1


# ---- A clip's rows ----


def rows_of(name: str, path: str) -> list[Row]:
    """The rows of a clip, one for each shot. What cannot be used is a row with an error."""
    begun = time.monotonic()
    file = ""
    try:
        with _local(path) as file, _said() as said:
            rows = []
            for number, shots, shot, seen in _shots(file, said):
                own = (
                    {"error": _sentence(seen, file, path)}
                    if isinstance(seen, ba.Error)
                    else _numbers(seen) | {"warnings": list(dict.fromkeys([*seen.warnings, *said]))}
                )
                place = {"shot": number, "shots": shots, "first_frame": shot[0], "last_frame": shot[1]}
                now = time.monotonic()
                rows.append(_row(name, path, now - begun, place | {"frames": shot[1] - shot[0] + 1} | own))
                begun = now
            return rows
    except Exception as e:  # Whatever is wrong with one clip is said in its row.
        return [_row(name, path, time.monotonic() - begun, {"error": _sentence(e, file, path)})]


def _shots(file: str, said: list[str]) -> Iterator[tuple[int, int, tuple[int, int], ba.Camera | ba.Error]]:
    """The shots of a clip: the number of each, how many there are, its first and last frame, and its camera."""
    whole = ba.estimate(file)
    if len(whole.shots) == 1:
        yield 1, 1, whole.shots[0], whole
        return
    for number, shot in enumerate(whole.shots, 1):
        # What was said of the whole clip, or of the shot before, is not said of this one.
        said.clear()
        try:
            seen: ba.Camera | ba.Error = ba.estimate(file, frames=shot)
        except ba.Error as e:
            seen = e
        yield number, len(whole.shots), shot, seen


def _row(name: str, path: str, seconds: float, values: Row) -> Row:
    known = {"id": name, "path": path, "version": ba.__version__, "seconds": seconds, **values}
    return {column: known.get(column) for column, *_ in COLUMNS}


def _low_high(interval: tuple[float, float] | None) -> tuple[float | None, float | None]:
    return interval or (None, None)


def _numbers(camera: ba.Camera) -> Row:
    exposure, noise, defocus, sharpening = camera.exposure, camera.noise, camera.defocus, camera.sharpening
    row: Row = {"width": camera.width, "height": camera.height, "fps": camera.fps, "camera": camera.to_json()}
    for name, part in (("exposure", exposure), ("noise", noise), ("defocus", defocus), ("sharpening", sharpening)):
        row[f"{name}_code"], row[f"{name}_reason"] = part.reason_code, part.reason
    row["exposure"], row["exposure_seconds"] = exposure.value, exposure.seconds
    row["exposure_low"], row["exposure_high"] = _low_high(exposure.interval)
    row["exposure_fits_low"], row["exposure_fits_high"] = _low_high(exposure.fits)
    if noise.known:
        for light in (1, 5, 9):
            for channel, std in zip("rgb", noise.std(light / 10).tolist()):
                row[f"noise_{light}_{channel}"] = std
    row["noise_clip"], row["noise_temporal_correlation"] = noise.clip, noise.temporal_correlation
    row["defocus_infinity_px"] = defocus.sigma_px_at_infinity
    row["defocus_infinity_low"], row["defocus_infinity_high"] = _low_high(defocus.sigma_px_at_infinity_interval)
    row["focus_inverse_depth"], row["focus_outside"] = defocus.focus_inverse_depth, defocus.focus_outside
    row["focus_low"], row["focus_high"] = _low_high(defocus.focus_inverse_depth_interval)
    row["depth_kind"] = defocus.depth_kind
    row["sharpening"], row["sharpening_radius_px"] = sharpening.value, sharpening.radius_px
    row["sharpening_low"], row["sharpening_high"] = _low_high(sharpening.interval)
    return row


def _sentence(error: Exception, file: str, path: str) -> str:
    text = " ".join(str(error).split()) or "no reason was given"
    text = text if isinstance(error, ba.Error) else f"{path}: {type(error).__name__}: {text}"
    return text.replace(file, path) if file else text


@contextlib.contextmanager
def _said() -> Iterator[list[str]]:
    """Collects Python's warnings."""
    said: list[str] = []
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        warnings.showwarning = lambda message, *_args, **_named: said.append(str(message))
        yield said


@contextlib.contextmanager
def _local(path: str) -> Iterator[str]:
    """The clip as a local file: one in an object store (s3://.., gs://..) is copied for as long as it is looked at."""
    if "://" not in path:
        yield path
        return
    from pyarrow import fs

    system, inside = fs.FileSystem.from_uri(path)
    with tempfile.TemporaryDirectory(prefix="blindaug-") as folder:
        file = str(Path(folder, Path(inside).name))
        fs.copy_files(inside, file, source_filesystem=system, destination_filesystem=fs.LocalFileSystem())
        yield file


# ---- The process that looks at clips ----


def _serve() -> None:
    """Answers lines of JSON, [id, path], by the rows of that clip."""
    settings = Settings(**json.loads(sys.argv[1]))
    ba.set_memory_budget(settings.memory)
    # What else writes to standard output would disturb the answers.
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    for line in sys.stdin:
        answers.write(json.dumps(rows_of(*json.loads(line))) + "\n")
        answers.flush()


class Worker:
    """A process that looks at one clip after another, and is started again when it ends or takes too long."""

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        self.process: subprocess.Popen[str] | None = None
        self.errors: BinaryIO | None = None
        self.closed = False

    def rows(self, name: str, path: str) -> list[Row]:
        """The rows of a clip. If the process ends, it is tried once more."""
        begun = time.monotonic()
        why = ""
        for _ in range(2):
            answer, why = self._ask(name, path)
            if answer:
                rows: list[Row] = json.loads(answer)
                return rows
            if self.closed or "longer" in why:
                break
        return [_row(name, path, time.monotonic() - begun, {"error": f"{path}: {why}"})]

    def _ask(self, name: str, path: str) -> tuple[str, str]:
        process = self._running()
        assert process.stdin and process.stdout
        late = threading.Event()

        def stop() -> None:
            late.set()
            process.kill()

        timer = threading.Timer(self.settings.timeout, stop)
        timer.daemon = True
        timer.start()
        answer = ""
        with contextlib.suppress(OSError, ValueError):
            process.stdin.write(json.dumps([name, path]) + "\n")
            process.stdin.flush()
            answer = process.stdout.readline()
        timer.cancel()
        if answer.endswith("\n"):
            return answer, ""
        code = process.wait()
        self._end()
        if late.is_set():
            return "", f"it took longer than {self.settings.timeout:g} s, and was given up; raise timeout, or give a part of it"
        return "", f"the process that looked at it ended {_how(code)}, twice{self._last_words()}"

    def _running(self) -> subprocess.Popen[str]:
        if self.process is None or self.process.poll() is not None:
            self._end()
            self.errors = tempfile.TemporaryFile()
            environment = os.environ | {"RAYON_NUM_THREADS": str(self.settings.threads)}
            self.process = subprocess.Popen(
                [sys.executable, "-c", "from blindaug.archive import _serve; _serve()", json.dumps(vars(self.settings))],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=self.errors,
                env=environment,
                encoding="utf-8",
                # Ctrl-C is for the process that waits for this one.
                start_new_session=True,
            )
        return self.process

    def _last_words(self) -> str:
        if self.errors is None:
            return ""
        self.errors.seek(0)
        lines = self.errors.read().decode(errors="replace").strip().splitlines()
        return f" ({' '.join(lines[-1].split())})" if lines else ""

    def _end(self) -> None:
        if self.process:
            self.process.kill()
            self.process.wait()
            for pipe in (self.process.stdin, self.process.stdout):
                with contextlib.suppress(OSError):
                    pipe.close()  # type: ignore[union-attr]
            self.process = None

    def close(self) -> None:
        """Ends the process at once."""
        self.closed = True
        if self.process:
            self.process.kill()


def _how(code: int) -> str:
    if code >= 0:
        return f"with status {code}"
    with contextlib.suppress(ValueError):
        return f"by {signal.Signals(-code).name}"
    return f"by signal {-code}"


# ---- Where the clips are looked at ----


def _here(clips: Sequence[Clip], workers: int, settings: Settings) -> _Looks:
    """Looks at clips by processes of this machine."""
    waiting, lock = iter(clips), threading.Lock()
    done: queue.SimpleQueue[tuple[str, list[Row]] | BaseException | None] = queue.SimpleQueue()
    own = [Worker(settings) for _ in range(min(workers, len(clips)))]

    def work(worker: Worker) -> None:
        try:
            while not worker.closed:
                with lock:
                    clip = next(waiting, None)
                if clip is None:
                    break
                rows = worker.rows(*clip)
                if not worker.closed:
                    done.put((clip[0], rows))
            done.put(None)
        except BaseException as e:
            done.put(e)

    try:
        for worker in own:
            threading.Thread(target=work, args=(worker,), daemon=True).start()
        running = len(own)
        while running:
            try:
                # A wait without an end would not hear Ctrl-C on Windows.
                item = done.get(timeout=1.0)
            except queue.Empty:
                continue
            if isinstance(item, BaseException):
                raise item
            if item is None:
                running -= 1
            else:
                yield item
    finally:
        for worker in own:
            worker.close()


# The worker of a process of Ray's, which runs one task after another.
_of_this_process: dict[Settings, Worker] = {}


def _task(clip: dict[str, str], settings: Settings) -> dict[str, str]:
    """A task on a cluster: the rows of a clip as text, which is of one type whatever is null in them."""
    worker = _of_this_process.setdefault(settings, Worker(settings))
    return {"id": clip["id"], "rows": json.dumps(worker.rows(clip["id"], clip["path"]))}


def _on_ray(
    clips: Sequence[Clip], workers: int | None, settings: Settings, address: str
) -> _Looks:
    """Looks at clips by Ray Data: Ray hands them out, and hands out again what a dead process or machine had."""
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    if address == "local":
        # Ray listens at 127.0.0.1 alone, as it does where it cannot have other machines; this is read when Ray is imported.
        os.environ.setdefault("RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER", "0")
    try:
        import ray
        import ray.data
    except ImportError as e:
        raise ba.Error("ray: is not installed here: pip install blindaug[ray]") from e
    begun_here = not ray.is_initialized()
    if begun_here:
        options: dict[str, Any] = {"log_to_driver": False, "logging_level": "ERROR"}
        if address == "local":
            options |= {"num_cpus": workers, "include_dashboard": False}
        try:
            ray.init(address=address, **options)
        except Exception as e:  # Ray has no kind of exception for this.
            raise ba.Error(f"ray: cannot be started, or reached at {address} ({' '.join(str(e).split())})") from e
    try:
        context = ray.data.DataContext.get_current()
        context.enable_progress_bars = False
        # The rows of a clip are handed on when they are there, not with those of the clips after it, and no room is kept for more.
        context.target_max_block_size = 1 << 14
        logging.getLogger("ray.data").setLevel(logging.ERROR)
        items = [{"id": name, "path": path} for name, path in clips]
        # Ray Data gives a task out again as often as its process or its machine dies.
        rows = ray.data.from_items(items, override_num_blocks=min(len(items), BLOCKS)).map(
            _task,
            fn_args=(settings,),
            compute=ray.data.TaskPoolStrategy(size=workers),
            num_cpus=settings.threads,
            memory=settings.memory,
        )
        for row in rows.iter_rows():
            yield row["id"], json.loads(row["rows"])
    finally:
        if begun_here:
            ray.shutdown()


# ---- The clips ----


def clips_of(inputs: Iterable[str | os.PathLike[str]]) -> list[Clip]:
    """The clips of folders, patterns, tables (CSV or Parquet with the columns id and path) and single clips.

    The id of a clip is its path, but for those of tables. In a folder, at any depth, videos are clips, and folders that hold images.
    """
    clips: list[Clip] = []
    for one in inputs:
        text = os.fspath(one)
        path = Path(text)
        if path.is_dir():
            found = _in_folder(path)
            if not found:
                raise ba.Error(f"{text}: has no videos and no folders of images; give a folder, a pattern or a table with clips")
            clips += [(p.as_posix(), str(p)) for p in found]
        elif path.is_file():
            table = {".csv": _from_csv, ".parquet": _from_parquet}.get(path.suffix.lower())
            clips += table(path) if table else [(path.as_posix(), text)]
        elif glob.has_magic(text):
            found = [p for p in map(Path, sorted(glob.glob(text, recursive=True))) if _is_clip(p)]
            if not found:
                raise ba.Error(f"{text}: no video and no folder of images is of this pattern")
            clips += [(p.as_posix(), str(p)) for p in found]
        else:
            raise ba.Error(f"{text}: there is no such file, folder or pattern")
    seen: set[str] = set()
    for name, _ in clips:
        if name in seen:
            raise ba.Error(f"{name}: two clips have this id; each must have its own")
        seen.add(name)
    return clips


def _is_clip(path: Path) -> bool:
    if path.name.startswith("."):
        return False
    return path.is_dir() and _has_images(path) or path.suffix.lower() in VIDEOS and path.is_file()


def _has_images(folder: Path) -> bool:
    with os.scandir(folder) as entries:
        return any(Path(e.name).suffix.lower() in IMAGES and not e.name.startswith(".") for e in entries)


def _in_folder(folder: Path) -> list[Path]:
    found = []
    for at, folders, files in os.walk(folder):
        folders.sort()
        found += [Path(at, f) for f in files if _is_clip(Path(at, f))]
        if any(Path(f).suffix.lower() in IMAGES and not f.startswith(".") for f in files):
            found.append(Path(at))
    return sorted(found)


def _from_csv(table: Path) -> list[Clip]:
    with table.open(newline="", encoding="utf-8-sig") as file:
        reader = csv.DictReader(file)
        if not {"id", "path"} <= set(reader.fieldnames or []):
            raise ba.Error(f"{table}: its first line must name the columns id and path")
        return [_clip(table, row["id"], row["path"], f"line {reader.line_num}") for row in reader]


def _from_parquet(table: Path) -> list[Clip]:
    parquet = _pyarrow()[1]
    try:
        read = parquet.read_table(table, columns=["id", "path"]).to_pydict()
        return [_clip(table, *both, f"row {n}") for n, both in enumerate(zip(read["id"], read["path"]), 1)]
    except (OSError, KeyError, _pyarrow()[0].ArrowException) as e:
        raise ba.Error(f"{table}: cannot be read as a table with the columns id and path ({' '.join(str(e).split())})") from e


def _clip(table: Path, name: object, path: object, where: str) -> Clip:
    if name in (None, "") or path in (None, ""):
        raise ba.Error(f"{table}: {where} has no id or no path")
    # A path in a table is seen from the table.
    text = str(path)
    return str(name), text if "://" in text else str(table.parent / text)


# ---- The table, and what is done of it ----


def _pyarrow() -> tuple[Any, Any]:
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError as e:
        raise ba.Error("pyarrow: is not installed here: pip install blindaug[archive]") from e
    return pyarrow, pyarrow.parquet


def schema() -> Any:
    """The table's schema (a pyarrow.Schema), with what each column means in its metadata."""
    pa = _pyarrow()[0]
    types = {"list": pa.list_(pa.string()), "string": pa.string()}
    fields = [
        pa.field(name, types.get(kind) or getattr(pa, kind)(), metadata={"description": meaning} if meaning else None)
        for name, kind, meaning in COLUMNS
    ]
    return pa.schema(fields)


class _Kept:
    """The rows so far, in a folder beside the table: a line for each clip, in a file of each run."""

    def __init__(self, output: Path) -> None:
        self.output, self.folder = output, output.with_name(output.name + ".partial")
        # Where the rows of an id are: the file and the place in it.
        self.places: dict[str, tuple[Path, int]] = {}
        self.failed: set[str] = set()
        # The ids that the table has, and whether they have an error.
        self.table: dict[str, bool] = {}
        self.file: BinaryIO | None = None
        self.lock: Any = None

    def open(self) -> None:
        self._read_table()
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            self._take_lock()
        except OSError as e:
            raise ba.Error(f"{self.folder}: cannot be made or written to ({e.strerror})") from e
        for path in sorted(self.folder.glob("*.jsonl")):
            with path.open("rb") as file:
                while line := file.readline():
                    # The last line of a run that was killed may be cut.
                    with contextlib.suppress(ValueError, KeyError, TypeError):
                        read = json.loads(line)
                        self._note(read["id"], read["rows"], (path, file.tell() - len(line)))
        number = 1 + max((int(p.stem) for p in self.folder.glob("*.jsonl")), default=0)
        self.path = self.folder / f"{number:06}.jsonl"
        self.file = self.path.open("xb")

    def _read_table(self) -> None:
        pa, parquet = _pyarrow()
        if not self.output.exists():
            return
        try:
            with parquet.ParquetFile(self.output) as table:
                if not table.schema_arrow.equals(schema()):
                    raise ba.Error(f"{self.output}: is no table of this version of blindaug; choose another name")
                for batch in table.iter_batches(columns=["id", "error"]):
                    for row in batch.to_pylist():
                        self.table[row["id"]] = self.table.get(row["id"], False) or row["error"] is not None
        except (OSError, pa.ArrowException) as e:
            raise ba.Error(f"{self.output}: is no table of blindaug; choose another name") from e

    def _take_lock(self) -> None:
        try:
            import fcntl
        except ImportError:
            # Windows has no such lock.
            return
        self.lock = (self.folder / "lock").open("w")
        try:
            fcntl.flock(self.lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as e:
            raise ba.Error(f"{self.output}: another process is at work on this table; wait for it, or stop it") from e

    def _note(self, name: str, rows: list[Row], place: tuple[Path, int]) -> None:
        self.places[name] = place
        (self.failed.add if any(row["error"] is not None for row in rows) else self.failed.discard)(name)

    def is_done(self, name: str) -> bool:
        """Whether an id needs no work; one with an error is tried again."""
        if name in self.places:
            return name not in self.failed
        return self.table.get(name) is False

    def add(self, name: str, rows: list[Row]) -> None:
        """Keeps the rows of a clip; from then on they are safe."""
        assert self.file
        place = (self.path, self.file.tell())
        self.file.write(json.dumps({"id": name, "rows": rows}).encode() + b"\n")
        self.file.flush()
        os.fsync(self.file.fileno())
        self._note(name, rows, place)

    def _rows(self, name: str) -> list[Row]:
        path, place = self.places[name]
        with path.open("rb") as file:
            file.seek(place)
            rows: list[Row] = json.loads(file.readline())["rows"]
        return rows

    def _merged(self) -> Iterator[Row]:
        """The rows of the table as it was and of what was done since, in the order of their ids."""
        parquet = _pyarrow()[1]
        new = iter(sorted(self.places))
        name = next(new, None)
        if self.table:
            with parquet.ParquetFile(self.output) as table:
                for batch in table.iter_batches(batch_size=GROUP):
                    for row in batch.to_pylist():
                        while name is not None and name < row["id"]:
                            yield from self._rows(name)
                            name = next(new, None)
                        if row["id"] not in self.places:
                            yield row
        while name is not None:
            yield from self._rows(name)
            name = next(new, None)

    def finish(self) -> int:
        """Writes the table, removes what was kept beside it, and gives the number of rows."""
        pa, parquet = _pyarrow()
        count = 0
        partial = self.folder / "table.parquet"
        columns = schema()
        with parquet.ParquetWriter(partial, columns, compression="zstd") as writer:
            rows: list[Row] = []
            for row in self._merged():
                rows.append(row)
                if len(rows) == GROUP:
                    writer.write_table(pa.Table.from_pylist(rows, schema=columns))
                    count, rows = count + len(rows), []
            if rows:
                writer.write_table(pa.Table.from_pylist(rows, schema=columns))
                count += len(rows)
        os.replace(partial, self.output)
        self.places.clear()
        return count

    def close(self) -> None:
        """Closes the files. What is done stays; if nothing is kept, nothing is left."""
        if self.file is None:
            return
        self.file.close()
        self.file = None
        if not self.places:
            for path in self.folder.iterdir():
                path.unlink()
            self.folder.rmdir()
        if self.lock:
            self.lock.close()


# ---- The whole ----


@dataclass(frozen=True)
class Result:
    """What became of a call of `archive`."""

    # The clips that were given, those that were looked at now, and those of these with an error.
    clips: int
    looked_at: int
    failed: int
    # The rows of the table.
    rows: int


def archive(
    inputs: str | os.PathLike[str] | Iterable[str | os.PathLike[str]],
    output: str | os.PathLike[str],
    *,
    workers: int | None = None,
    memory: int | None = None,
    timeout: float = 3600.0,
    ray: str | None = None,
    progress: Callable[[int, int, int], object] | None = None,
) -> Result:
    """Estimates the cameras of clips and writes them to a Parquet table, a row for each shot (COLUMNS).

    inputs: folders, patterns, tables with the columns id and path, or clips. Clips that the table at `output` has without an error are not looked
        at again; other rows of it stay.
    workers: the clips that are looked at at once; by default as many as there are processors, on a cluster as many as it has room for.
    memory: bytes for each worker; by default a share of half of this machine's memory, on a cluster 2 GB.
    timeout: the time after which a clip is given up, s.
    ray: "local" starts Ray on this machine, an address (or "auto") uses a cluster, whose nodes see the clips by the same paths; a Ray that was
        initialised before is used as it is.
    progress: is called with the numbers of clips that are done, of all clips, and of those with an error.

    Raises Error if the clips or the table cannot be used. What is done when it is interrupted is kept, and the next call goes on from there.
    """
    given = [inputs] if isinstance(inputs, (str, os.PathLike)) else list(inputs)
    if workers is not None and workers < 1:
        raise ba.Error("workers: must be at least 1")
    _pyarrow()
    clips = clips_of(given)
    kept = _Kept(Path(output))
    kept.open()
    try:
        todo = [clip for clip in clips if not kept.is_done(clip[0])]
        done, failed = len(clips) - len(todo), 0
        if ray is None:
            workers = workers or _processors()
            settings = Settings(_half_of_memory() // workers if memory is None else memory, timeout)
            looked_at = _here(todo, workers, settings)
        else:
            looked_at = _on_ray(todo, workers, Settings(2_000_000_000 if memory is None else memory, timeout), ray)
        if progress:
            progress(done, len(clips), failed)
        if todo:
            with contextlib.closing(looked_at):
                waiting = {name for name, _ in todo}
                for name, rows in looked_at:
                    if name not in waiting:
                        continue
                    waiting.discard(name)
                    kept.add(name, rows)
                    done, failed = done + 1, failed + any(row["error"] is not None for row in rows)
                    if progress:
                        progress(done, len(clips), failed)
            if waiting:
                raise ba.Error(f"{sorted(waiting)[0]}: the cluster gave no rows of it; run the same again")
        return Result(len(clips), len(todo), failed, kept.finish())
    finally:
        kept.close()


def _processors() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _half_of_memory() -> int:
    if hasattr(os, "sysconf"):
        with contextlib.suppress(OSError, ValueError):
            return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") // 2
    return 4_000_000_000


# ---- The command ----


class _Stopped(KeyboardInterrupt):
    """A signal that asks for an end."""

    def __init__(self, number: int) -> None:
        self.number = number


def _size(text: str) -> int:
    units = {"M": 10**6, "G": 10**9}
    try:
        size = int(float(text[:-1]) * units[text[-1:].upper()])
    except (KeyError, ValueError):
        size = 0
    if size < 64 * 10**6:
        raise argparse.ArgumentTypeError("give a number with M or G, from 64M on")
    return size


class _Console:
    """Tells on standard error how far it is: on a terminal in place, else every ten seconds."""

    def __init__(self) -> None:
        self.begun: tuple[float, int] | None = None
        self.last = 0.0
        self.in_place = sys.stderr.isatty()

    def __call__(self, done: int, total: int, failed: int) -> None:
        now = time.monotonic()
        self.begun = self.begun or (now, done)
        if done < total and now - self.last < (0.2 if self.in_place else 10.0):
            return
        self.last = now
        seconds, made = now - self.begun[0], done - self.begun[1]
        text = f"{done} of {total} clips" + (f", {failed} with an error" if failed else "")
        if made and done < total:
            left = seconds / made * (total - done)
            text += f", {60 * made / seconds:.1f} a minute, about {left / 60:.0f} min left"
        print(f"\r{text}\x1b[K" if self.in_place else text, end="" if self.in_place else "\n", file=sys.stderr, flush=True)

    def end(self) -> None:
        if self.in_place:
            print(file=sys.stderr)


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; gives the exit status."""
    parser = argparse.ArgumentParser(
        prog="python -m blindaug.archive", description="The cameras of many clips as one table, a row for each shot."
    )
    parser.add_argument("inputs", nargs="+", metavar="CLIPS", help="folders, patterns, clips, or tables (CSV, Parquet) with the columns id and path")
    parser.add_argument("-o", "--output", required=True, metavar="TABLE.parquet", help="the table; what it has is not done again")
    parser.add_argument("--workers", type=int, metavar="N", help="clips at once [default: as many as there are processors]")
    parser.add_argument("--memory", type=_size, metavar="SIZE", help="memory of each worker, such as 2G [default: a share of half of the machine's; on Ray 2G]")
    parser.add_argument("--timeout", type=float, default=3600.0, metavar="SECONDS", help="after which a clip is given up [default: 3600]")
    parser.add_argument("--ray", nargs="?", const="local", metavar="ADDRESS", help="by Ray: on this machine, or on the cluster at this address (auto: the one around)")
    args = parser.parse_args(arguments)
    console = _Console()

    def stop(number: int, _frame: object) -> None:
        raise _Stopped(number)

    for name in ("SIGINT", "SIGTERM", "SIGHUP"):
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), stop)
    try:
        result = archive(
            args.inputs, args.output, workers=args.workers, memory=args.memory, timeout=args.timeout, ray=args.ray, progress=console
        )
    except KeyboardInterrupt as e:
        console.end()
        print("stopped; run the same command again to go on", file=sys.stderr)
        return 128 + getattr(e, "number", signal.SIGINT)
    except (ba.Error, OSError) as e:
        console.end()
        print(f"blindaug archive: {' '.join(str(e).split())}", file=sys.stderr)
        return 1
    console.end()
    errors = f", {result.failed} of them with an error (column error)" if result.failed else ""
    print(f"written: {args.output}, {result.rows} rows; {result.looked_at} of {result.clips} clips were looked at{errors}", file=sys.stderr)
    return 0


if __name__ == "__main__":
    # The module that other processes import, rather than this one under another name.
    sys.exit(importlib.import_module("blindaug.archive").main())
