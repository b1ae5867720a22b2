"""What runs on workers: shares of pictures, steps of builds, and what a worker says of itself.

Errors that would be the same on any other worker come back as values, so that they are not tried again. Everything else is raised, and
tried again elsewhere.
"""

from __future__ import annotations

import hashlib
import platform
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from distributed import Status, get_worker

from .. import _native
from .._errors import Cancelled, ExecutorError, RaysetError
from .._scene import Scene
from .._session import Session


@dataclass(frozen=True)
class Survey:
    """What a worker says of itself."""

    name: str
    version: str
    #: Distinguishes builds of one version on one kind of machine.
    build: str
    #: Whether vector instructions of the classes with and without fused multiply–add are there.
    classes: frozenset[bool]
    threads: int
    memory: int | None
    #: What is wrong with the files as this worker sees them.
    error: Exception | None
    #: Their sizes, and what tells objects that are remote from others at their addresses.
    files: tuple[tuple[str, int, str | None], ...] = ()


@dataclass(frozen=True)
class Terms:
    """What all tasks of a picture or a build are done by."""

    run: str
    version: str
    fused: bool
    #: Of the tasks of a worker that run at a time, together.
    memory: int
    #: Whether somebody wants to know how far each task is.
    tells: bool = False


@dataclass(frozen=True)
class Picture:
    """A picture of which shares are rendered."""

    scene: str
    folder: str
    crop: Any
    layers: bool


@dataclass(frozen=True)
class Build:
    """A build of which steps are done."""

    #: What the engine calls the parts: their folder, their number, and the build that they are of.
    parts: dict[str, Any]
    #: Files, their columns, and those that are kept; or what the columns of arrays are called.
    points: dict[str, Any]
    options: dict[str, Any]


@dataclass(frozen=True)
class Outcome:
    """What came of a task."""

    worker: str
    value: Any = None
    error: Exception | None = None
    remarks: list[str] = field(default_factory=list)


@cache
def build_identity() -> str:
    """A hash of the engine: two builds may have one version."""
    with open(_native.__file__, "rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()[:16]
    return f"{platform.system()} {platform.machine()} {digest}"


def classes() -> frozenset[bool]:
    """The classes of vector instructions of this processor."""
    return frozenset(fused for _, fused in _native.instructions())


def survey(look: Callable[[], Sequence[str]], worker: Any) -> Survey:
    """What this worker says of itself. `look` opens the files, and returns their names."""
    error, files = None, list[tuple[str, int, str | None]]()
    try:
        names = look()
        files = [(name, *version) for name, version in zip(names, _native.versions(names), strict=True)]
    except (RaysetError, OSError, ValueError) as found:
        error = found
    limit = worker.memory_manager.memory_limit
    return Survey(
        name=str(worker.name),
        version=_native.__version__,
        build=build_identity(),
        classes=classes(),
        threads=worker.state.nthreads,
        memory=None if limit is None else int(limit),
        error=error,
        files=tuple(files),
    )


_lock = threading.Lock()
#: Tasks that are under way in this process, by their runs.
_running: Counter[str] = Counter()
#: A session of each worker in this process, and what it was made with. It stays between tasks, with its pages.
_sessions: dict[str, tuple[tuple[Any, ...], Session]] = {}


def is_busy(run: str) -> bool:
    """Whether tasks of a run are under way in this process."""
    with _lock:
        return _running[run] > 0


@contextmanager
def _counted(run: str) -> Iterator[None]:
    with _lock:
        _running[run] += 1
    try:
        yield
    finally:
        with _lock:
            _running[run] -= 1
            if not _running[run]:
                del _running[run]


#: Under this topic tasks say how far they are, and how often each of them does, in seconds.
TOPIC, _TELLING = "rayset-progress", 1.0


def _watch(worker: Any, terms: Terms) -> Callable[[str, int, int], None]:
    """Ends the task from within once nobody waits for it, since threads cannot be ended from without, and says how far it is."""
    key, when = worker.get_current_task(), time.monotonic()

    def told(doing: str, done: int, total: int) -> None:
        nonlocal when
        if terms.tells and total > 0 and time.monotonic() >= when + _TELLING:
            when = time.monotonic()
            worker.log_event(TOPIC, [terms.run, str(key), done / total])
        task = worker.state.tasks.get(key)
        if worker.status not in (Status.running, Status.paused) or task is None or task.state not in ("executing", "long-running"):
            raise Cancelled(f"{doing}: nobody waits for this task any more")

    return told


def _done(terms: Terms, work: Callable[[Any, Callable[[str, int, int], None]], tuple[Any, list[str]]]) -> Outcome:
    """Does a task, with what it may use checked: workers that came later have not been asked."""
    worker = get_worker()
    name = str(worker.name)
    with _counted(terms.run):
        try:
            if terms.version != _native.__version__:
                own = _native.__version__
                raise ExecutorError(f"this worker has rayset {own}, and the task is of {terms.version}; install one version everywhere")
            if terms.fused not in classes():
                raise ExecutorError("this worker came later, and has none of the vector instructions that the others agreed on; begin again")
            value, remarks = work(worker, _watch(worker, terms))
        except Cancelled:
            raise
        except (RaysetError, ValueError, TypeError, FileNotFoundError) as error:
            return Outcome(name, error=error)
    return Outcome(name, value, remarks=remarks)


def _session(worker: Any, terms: Terms) -> Session:
    """The session of a worker, whose threads all its tasks share."""
    simd = next(name for name, fused in _native.instructions() if fused == terms.fused)
    key = (terms.memory, worker.state.nthreads, simd)
    with _lock:
        kept = _sessions.get(worker.address)
        if kept is None or kept[0] != key:
            # What the other one renders goes on to its end.
            kept = _sessions[worker.address] = (key, Session(memory=terms.memory, threads=worker.state.nthreads, _simd=simd))
        return kept[1]


def render_share(terms: Terms, picture: Picture, share: tuple[int, int], edge: int = 1) -> Outcome:
    """Renders a share of a picture, or of a coarse one of squares with this edge; the value is the bytes of the part."""

    def work(worker: Any, told: Any) -> tuple[Any, list[str]]:
        job = Scene.from_json(picture.scene, picture.folder)._job(picture.crop, picture.layers)
        session = _session(worker, terms)._native
        return _native.render_part(session, job, share, told, edge), session.remarks()

    return _done(terms, work)


def build_step(terms: Terms, build: Build, step: str, part: int) -> Outcome:
    """Does a step of a part of a build."""

    def work(worker: Any, told: Any) -> tuple[Any, list[str]]:
        options = _shared_out(build, worker, terms)
        if step == "read" and "named" in build.points:
            folder, named = Path(build.parts["folder"]), build.points["named"]
            positions, *columns = (np.load(rows_file(folder, part, number), mmap_mode="r") for number in range(1 + len(named)))
            _native.read_arrays_part(build.parts, part, positions, list(zip(named, columns, strict=True)), options, told)
            return None, []
        if step == "read":
            return None, _native.read_part(build.parts, part, build.points, options, told)
        _native.run_step(build.parts, step, part, options, told)
        return None, []

    return _done(terms, work)


def rows_file(folder: Path, part: int, number: int) -> Path:
    """Where the rows of an array are that a part reads: positions have the number 0, columns those that follow."""
    return folder / f"rows-{part}-{number}.npy"


def merge(terms: Terms, build: Build, path: str) -> Outcome:
    """Merges the parts of a build; the value is how many records were skipped, and why, and what there is to be warned of."""

    def work(worker: Any, told: Any) -> tuple[Any, list[str]]:
        # No other task of the build is left.
        whole = {**_shared_out(build, worker, terms), "threads": worker.state.nthreads, "memory": max(1, terms.memory)}
        return _native.merge_parts(build.parts, path, whole, told), []

    return _done(terms, work)


def _shared_out(build: Build, worker: Any, terms: Terms) -> dict[str, Any]:
    """The options of a task of a build, one of as many as the worker has threads."""
    if not (Path(build.parts["folder"]) / "lock").exists():
        raise Cancelled(f"{build.parts['folder']}: the folder of this build is gone")
    return {**build.options, "threads": 1, "memory": max(1, terms.memory // worker.state.nthreads)}
