"""Clouds that are built by workers: the steps of `rayset build --part`, each in as many parts as there are threads, and the merge."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from .. import _native
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
) -> tuple[_native.CloudFile, tuple[int, int, int], list[str]]:
    """Builds a cloud of files to a file, both of which all workers see. Returns it with what was skipped, and what there is to say."""
    output = Path(os.path.abspath(options["path"]))
    points = {**points, "files": [os.path.abspath(name) for name in points["files"]]}
    with WorkFolder(output) as folder:
        pool = Pool(executor, timeout, _looking(points["files"], str(folder.path)))
        parts = min(_MOST, pool.threads)
        with Tasks(pool, memory) as tasks:
            of_engine = {"folder": str(folder.path), "parts": parts, "request": tasks.terms.run}
            job = worker.Build(of_engine, points, {**options, "path": None, "temp_dir": None})
            remarks = _steps(tasks, job, told)
            tasks.submit(None, "the merge", worker.merge, job, str(output))
            _, merged = tasks.next()
            _tell(told, "merge", 1, 1)
    built, _ = _native.open_files([str(output)], None, True, None, None, 1 << 30, None, None)
    if not isinstance(built, _native.CloudFile):
        raise InputError(f"{output}: another process has put something else in the place of the cloud")
    return built, merged.value, remarks


def _steps(tasks: Tasks, job: worker.Build, told: Told | None) -> list[str]:
    """Does all steps but the merge: all parts of one before any of the next."""
    parts, remarks = job.parts["parts"], list[str]()
    step = _native.next_step(job.parts)
    while step is not None:
        for part in range(1, parts + 1):
            tasks.submit(part, f"step {step} of part {part} of {parts}", worker.build_step, job, step, part)
        done = 0
        while len(tasks):
            _, outcome = tasks.next()
            remarks += [one for one in outcome.remarks if one not in remarks]
            done += 1
            _tell(told, step, done, parts)
        step = _native.next_step(job.parts)
    return remarks


def _looking(files: Sequence[str], folder: str) -> Callable[[], Sequence[str]]:
    """What opens the files on a worker."""

    def look() -> Sequence[str]:
        if not os.path.isdir(folder):
            raise InputError(
                f"{os.path.dirname(folder)}: what the process that began writes there is not seen; path= has to be in a folder that all workers see"
            )
        _native.expand(files, None)
        return files

    return look


def _tell(told: Told | None, doing: str, done: int, total: int) -> None:
    if told is not None:
        told(doing, done, total)
