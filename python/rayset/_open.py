"""Files of any kind."""

from __future__ import annotations

import logging
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from . import _arguments, _native
from ._build import TemporaryFile
from ._objects import Cloud, Grid
from ._progress import Progress, Told
from ._scene import Scene

_log = logging.getLogger("rayset")
#: What a build of a raw file may allocate if nobody says otherwise.
_MEMORY = 1 << 30


def open(
    source: Any,
    *,
    cache: bool | _arguments.PathLike = True,
    columns: Sequence[str] | None = None,
    volume_index: int | None = None,
    memory: int | str | None = None,
    threads: int | None = None,
    progress: Progress = False,
    temp_dir: _arguments.PathLike | None = None,
) -> Any:
    """Opens a cloud, a grid or a scene; or files of points or voxels of any kind that the program reads, which are built first.

    Parameters
    ----------
    source
        A path, an address (``"s3://bucket/scan.rset"``), a pattern (``"tiles/*.laz"``), a folder, a list of files of points that are one
        cloud, or the bytes of a file.
    cache
        Where what is built is kept: ``True`` for the user's folder for caches, a folder, or ``False`` for a temporary file.
    columns
        Names of the columns of text files and of arrays, as in ``["x", "y", "z", "-", "intensity"]``; ``"-"`` leaves one out.
    volume_index
        Which volume is read of a file with a series of them, counted from 0, as arrays of four dimensions are; the first by default.
    memory, threads, temp_dir
        What a build may use; 1 GiB by default.

    Returns
    -------
    Cloud, Grid or Scene
    """
    if isinstance(source, (bytes, bytearray, memoryview)):
        return _of_bytes(bytes(source), columns, volume_index, memory, threads, progress, temp_dir)
    files = [source] if isinstance(source, (str, os.PathLike)) else source
    if not isinstance(files, Sequence):
        raise TypeError(f"open: expected a path, a list of paths or bytes, and got {type(source).__name__}")
    if not files:
        raise ValueError("open: the list of files is empty")
    paths = [_arguments.file(one, "source") for one in files]
    keeps = cache is not False
    folder = None if isinstance(cache, bool) else str(_arguments.path(cache, "cache"))
    budget = _arguments.memory_bytes(memory) or _MEMORY
    folder_of_others = None if temp_dir is None else str(_arguments.path(temp_dir, "temp_dir"))
    if isinstance(columns, str):
        raise TypeError(f"columns={columns!r}: expected a list of names, as in [\"x\", \"y\", \"z\"]")
    names = None if columns is None else [str(name) for name in columns]
    index = None if volume_index is None else _arguments.whole(volume_index, "volume_index", 0, 2**63 - 1)
    number = _arguments.thread_count(threads)
    with Told(progress) as told:
        found, remarks = _native.open_files(paths, folder, keeps, names, index, folder_of_others, budget, number, told)
    for remark in remarks:
        _log.info("%s", remark)
    if isinstance(found, _native.CloudFile):
        return Cloud(found, None if keeps or _is_built(paths, found) else found)
    if isinstance(found, _native.GridFile):
        return Grid(found, None if keeps or _is_built(paths, found) else found)
    return Scene.load(found)


def _is_built(paths: list[str], found: Any) -> bool:
    """Whether the file is one that was given, and not one that goes with the object."""
    return paths == [found.address]


def _of_bytes(data: bytes, columns: Any, volume_index: Any, memory: Any, threads: Any, progress: Progress, temp_dir: Any) -> Any:
    found = _native.open_bytes(data)
    if isinstance(found, _native.CloudFile):
        return Cloud(found)
    if isinstance(found, _native.GridFile):
        return Grid(found)
    # Readers take files: this one is gone when the cloud or grid is built.
    raw = TemporaryFile(".raw")
    Path(raw.name).write_bytes(data)
    return open(
        raw.name,
        cache=False,
        columns=columns,
        volume_index=volume_index,
        memory=memory,
        threads=threads,
        progress=progress,
        temp_dir=temp_dir,
    )

