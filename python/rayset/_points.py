"""Files of points that are built to one cloud, here or by the workers of an executor."""

from __future__ import annotations

import logging
import os
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from . import _arguments, _native

_log = logging.getLogger("rayset")


def are_files(positions: Any) -> bool:
    """Whether positions are given as the path of a file or as several."""
    if isinstance(positions, (str, os.PathLike)):
        return True
    return isinstance(positions, (list, tuple)) and len(positions) > 0 and all(isinstance(one, (str, os.PathLike)) for one in positions)


def rule(value: Any, name: str) -> Any:
    """Where the radii or the weights of files come from: a number, or the name of a column."""
    if value is None or isinstance(value, str):
        return value
    if np.ndim(value):
        raise TypeError(f"{name}: an array beside files; their points have what their columns have: {name}=\"mass\", or a number")
    return _arguments.number(value, name, 1e-18 if name == "radius" else -1e18)


def described(positions: Any, columns: Sequence[str] | None, attributes: Any, output: str | None, others: Mapping[str, Any]) -> dict[str, Any]:
    """Files of points as the engine takes them."""
    given = next((name for name, value in others.items() if value is not None and len(value)), None)
    if given is not None:
        raise TypeError(f"{given}: for arrays; the points of files have what their columns have")
    if isinstance(columns, str) or isinstance(attributes, (str, Mapping)):
        raise TypeError("files: expected columns and attributes as lists of names, as in [\"intensity\"]")
    paths = [positions] if isinstance(positions, (str, os.PathLike)) else positions
    files, by_name = _native.expand([_arguments.file(one, "positions") for one in paths], output)
    return {
        "files": files,
        "by_name": by_name,
        "columns": None if columns is None else [str(name) for name in columns],
        "attributes": None if attributes is None else [str(name) for name in attributes],
    }


def built(
    points: dict[str, Any], options: dict[str, Any], executor: Any, timeout: float, told: Any
) -> _native.Built:
    """Builds the cloud."""
    if executor is None:
        made, remarks = _native.build_files(points, options, told)
    else:
        from ._executor import builds

        made, remarks = builds.build(executor, points, options, options["memory"], _arguments.seconds(timeout), told)
    for remark in remarks:
        _log.info("%s", remark)
    return made


def refuse(executor: Any, is_of_chunks: bool, path: Any, threads: Any, temp_dir: Any) -> None:
    """Refuses what workers cannot do."""
    if executor is None:
        return
    if is_of_chunks:
        raise TypeError(
            "executor: an iterator of chunks is in this process, where workers do not see it; build it here, or write the chunks to files that "
            "all workers see, and give the names of these: rs.build([\"a.npy\", \"b.npy\"], path=..., executor=client)"
        )
    if path is None:
        raise TypeError("executor: say path=, the file to build, in a folder that all workers see")
    if threads is not None or temp_dir is not None:
        name = "threads" if threads is not None else "temp_dir"
        raise TypeError(f"{name} is for this process; workers have their own threads, and write beside the output")
