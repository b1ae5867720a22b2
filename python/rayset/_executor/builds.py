"""Clouds that are built by workers: the steps of `rayset build --part`, each in as many parts as there are threads, and the merge."""

from __future__ import annotations

import contextlib
import os
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from .. import _arguments, _arrays, _native
from .._errors import InputError
from . import worker
from .folder import WorkFolder
from .pool import Pool
from .tasks import Tasks

#: Most parts of a build.
_MOST = 512

Told = Callable[[str, int, int], Any]


def build(
    executor: Any, points: dict[str, Any], options: dict[str, Any], memory: int | None, timeout: float, told: Told | None
) -> tuple[_native.Built, list[str]]:
    """Builds a cloud of files to a file, both of which all workers see. Returns it with what there is to say."""
    files = [_arguments.absolute(name) for name in points["files"]]
    return _built(executor, files, lambda *_: {**points, "files": files}, options, memory, timeout, told)


def build_arrays(
    executor: Any, points: _arrays.Points, options: dict[str, Any], memory: int | None, timeout: float, told: Told | None
) -> _native.Built:
    """Builds a cloud of arrays in the same way: each part has its rows as files in the folder in which parts meet, and reads them there."""

    def scatter(folder: Path, parts: int) -> dict[str, Any]:
        every = [points.positions, *(column.values for column in points.columns)]
        count = len(points.positions)
        for part in range(1, parts + 1):
            rows = slice(count * (part - 1) // parts, count * part // parts)
            for number, values in enumerate(every):
                np.save(worker.rows_file(folder, part, number), np.asarray(values[rows]), allow_pickle=False)
            _tell(told, "scatter", part, parts)
        return {"named": [column.named() for column in points.columns]}

    built, _ = _built(executor, [], scatter, options, memory, timeout, told)
    return built


def _built(
    executor: Any,
    files: list[str],
    points: Callable[[Path, int], dict[str, Any]],
    options: dict[str, Any],
    memory: int | None,
    timeout: float,
    told: Told | None,
) -> tuple[_native.Built, list[str]]:
    """Builds a cloud of what `points` says to workers, given the folder in which parts meet and their number."""
    if _arguments.is_address(options["path"]):
        raise ValueError(
            f"path={options['path']!r}: workers write their shares beside the output, which has to be in a folder that all of them see; "
            "an address is none"
        )
    output = Path(os.path.abspath(options["path"]))
    with WorkFolder(output) as folder:
        pool = Pool(executor, timeout, _looking(files, str(folder.path)))
        parts = min(_MOST, pool.threads)
        with Tasks(pool, memory) as tasks:
            of_engine = {"folder": str(folder.path), "parts": parts, "request": tasks.terms.run}
            job = worker.Build(of_engine, points(folder.path, parts), {**options, "path": None, "temp_dir": None})
            remarks = _steps(tasks, job, told)
            tasks.submit(None, "the merge", worker.merge, job, str(output))
            _, merged = tasks.next()
            _tell(told, "merge", 1, 1)
    built, _ = _native.open_files([str(output)], None, True, None, None, None, 1 << 30, None, None)
    if not isinstance(built, _native.CloudFile):
        raise InputError(f"{output}: another process has put something else in the place of the cloud")
    return (built, *merged.value), remarks


def _steps(tasks: Tasks, job: worker.Build, told: Told | None) -> list[str]:
    """Does all steps but the merge: all parts of one before any of the next."""
    parts, remarks = job.parts["parts"], list[str]()
    step = _native.next_step(job.parts)
    while step is not None:
        for part in _heaviest_first(Path(job.parts["folder"]), parts):
            tasks.submit(part, f"step {step} of part {part} of {parts}", worker.build_step, job, step, part)
        done = 0
        while len(tasks):
            _, outcome = tasks.next()
            remarks += [one for one in outcome.remarks if one not in remarks]
            done += 1
            _tell(told, step, done, parts)
        for rows in Path(job.parts["folder"]).glob("*.npy"):
            # They have been read.
            rows.unlink(missing_ok=True)
        step = _native.next_step(job.parts)
    return remarks


def _heaviest_first(folder: Path, parts: int) -> list[int]:
    """The parts in the order in which they are begun: those that have written the most, and so have the most before them, come first. They all
    begin at once, but where there are fewer threads by now than parts.
    """
    written = Counter[int]()
    for file in folder.glob(f"*-of-{parts}.data"):
        number = file.name.split("-of-")[0].rpartition("-")[2]
        with contextlib.suppress(OSError):
            written[int(number) if number.isdigit() else 0] += file.stat().st_size
    return sorted(range(1, parts + 1), key=lambda part: -written[part])


def _looking(files: Sequence[str], folder: str) -> Callable[[], Sequence[str]]:
    """What opens the files on a worker."""

    def look() -> Sequence[str]:
        if not os.path.isdir(folder):
            raise InputError(
                f"{os.path.dirname(folder)}: what the process that began writes there is not seen; path= has to be in a folder that all workers see"
            )
        if files:
            _native.expand(files, None)
        return files

    return look


def _tell(told: Told | None, doing: str, done: int, total: int) -> None:
    if told is not None:
        told(doing, done, total)
