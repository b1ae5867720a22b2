"""Clouds and grids of arrays."""

from __future__ import annotations

import os
import warnings
import weakref
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from . import _arguments, _arrays, _native, _points
from ._errors import RaysetWarning
from ._objects import Cloud, Grid
from ._progress import Progress, Told

#: Bytes of a slab of voxels.
_SLAB = 8 << 20


def build(
    positions: Any,
    *,
    radius: Any = None,
    weight: Any = None,
    color: Any = None,
    attributes: Mapping[str, Any] | Sequence[str] | None = None,
    classes: Sequence[str] = (),
    path: _arguments.PathLike | None = None,
    memory: int | str | None = None,
    threads: int | None = None,
    progress: Progress = False,
    invalid: str = "skip",
    precision: float | str | None = None,
    shape: Any = "auto",
    normals: Any = None,
    radius_scale: float = 1.0,
    length_scale: float = 1.0,
    temp_dir: _arguments.PathLike | None = None,
    columns: Sequence[str] | None = None,
    lod: bool | None = None,
    executor: Any = None,
    timeout: float = 60,
) -> Cloud:
    """Builds a cloud of points.

    Parameters
    ----------
    positions
        N rows of three coordinates, in any real type and layout; a table (pandas, polars, pyarrow, astropy, a structured array, a
        dictionary) with columns ``x``, ``y``, ``z`` whose other columns become radii, weights, colours and attributes by their
        names; or an *iterator* of such arrays and tables, which is built a chunk at a time and may hold more than memory does. It is
        asked from another thread.
        Or *files* of points of any kind that the program reads: a path, a pattern, a folder, or a list of these.
        Arrays of ``float32`` and ``float64`` are read where they lie; do not change them meanwhile.
    radius
        Radius of influence: a number, an array, or ``"auto"`` (the default): 0.85 times the distance of each point's eighth neighbour,
        for a ball; see `shape`.
        Quantities (astropy, unyt) are converted to the unit of the positions. Of files, a number or the name of a column.
    weight
        A number or an array; 1 by default. Of files, a number or the name of a column.
    color
        N rows of red, green and blue: bytes, ``uint16``, or floating-point numbers from 0 to 1, as screens show them.
    attributes
        Arrays by name, of whole or floating-point numbers; units of quantities are kept. Of files, names of the columns that are kept; by
        default those that the program keeps.
    classes
        Names of attributes that are labels, which are never averaged. Those of booleans are.
    path
        The file to build; it appears under its name when it is complete. In memory if ``None``.
    memory
        Most bytes that the build allocates, as ``"8GiB"``; 1 GiB by default. Aggregates (`lod`) need at least 24 MiB. What does not fit goes through temporary files in
        ``temp_dir``, or beside the output. Arrays, and a cloud in memory, are not counted.
    progress
        ``True`` for a bar, or a callable of what is being done, how much of it is done, and how much there is.
    invalid
        ``"skip"``: points whose position, radius or weight is not a usable number are left out, with a warning; those too large to be
        stored are an error. ``"skip-all"`` leaves these out, too; ``"raise"`` makes an error of the first.
    shape
        ``"auto"``: where radii are measured, points are discs on surfaces, rods along wires and small balls where they are scattered, or
        discs across their normals, if they have any; and columns ``semi_axis_1`` to ``semi_axis_3`` and ``rotation_x`` to ``rotation_w``
        make ellipsoids. ``"fluid"``: particles of a liquid, whose radii are measured, are flat along its surface, after Yu & Turk (2013).
        ``"round"``: all points are balls.
        Or ellipsoids, of arrays: N matrices of 3 × 3, each of which takes the unit ball to its ellipsoid (of a covariance, its square
        root); or a pair of N × 3 semi-axes and N × 4 quaternions ``x, y, z, w``. Their longest semi-axis is the `radius`, unless that is given.
    normals
        N rows of three numbers, of arrays: which way the surface faces at each point. They are not kept.
    radius_scale, length_scale
        Factors of all radii; of all coordinates and radii.
    precision
        How exactly positions are stored: a fraction of the radius (1/4096), or ``"exact"``.
    columns
        Names of the columns of text files and of arrays in files, as in ``["x", "y", "z", "-", "intensity"]``; ``"-"`` leaves one out.
    lod
        Whether the file at `path` gets aggregates, which stand for its points from afar: pictures of it take a part of the time. By
        default, clouds of 200 000 points and more that are shown as gas get them. They are added when the cloud is built: who stops then,
        or gives too little memory, has a cloud without them. A cloud in memory has none. See ``docs/lod.md``.
    executor
        A client of ``dask.distributed``: its workers build the cloud of files or arrays, the very same, to a `path`; all of them see it and the
        files, and arrays are put beside it meanwhile. `memory` is then for each worker; half of what it may use, by default. See ``docs/python.md``, "Many machines".
    timeout
        Seconds for which the scheduler, or all workers, may be gone before there is an :class:`ExecutorError`.

    Raises
    ------
    BuildError, MemoryBudgetError, ValueError, TypeError
    """
    if invalid not in ("skip", "skip-all", "raise"):
        raise ValueError(f"invalid={invalid!r}: expected \"skip\", \"skip-all\" or \"raise\"")
    if isinstance(shape, str) and shape not in ("auto", "fluid", "round"):
        raise ValueError(f"shape={shape!r}: expected \"auto\", \"fluid\", \"round\" or arrays")
    if isinstance(shape, str) and shape == "fluid" and radius is not None and not isinstance(radius, str):
        raise ValueError("shape=\"fluid\": radii are measured; give none, and radius_scale if need be")
    has_arrays = not isinstance(shape, str) or normals is not None
    if lod is not None and not isinstance(lod, (bool, np.bool_)):
        raise TypeError(f"lod={lod!r}: expected True, False or None")
    if lod and path is None:
        raise TypeError("lod: say path=, the file to build; a cloud in memory has no aggregates")
    if isinstance(classes, str):
        raise TypeError(f"classes={classes!r}: expected a list of names, as in [{classes!r}]")
    is_of_files = _points.are_files(positions)
    _points.refuse(executor, isinstance(positions, Iterator), path, threads, temp_dir)
    radii, weights = None, None
    if is_of_files:
        rule, constant = _points.rule(radius, "radius"), _points.rule(weight, "weight")
        if has_arrays:
            raise TypeError("shape and normals of arrays are for points of arrays; files bring columns")
    else:
        rule, radii = _rule(radius, "radius", _arrays.unit_of(positions))
        constant, weights = _rule(weight, "weight", None)
        if has_arrays and isinstance(positions, Iterator):
            raise TypeError("chunks bring their own shapes and normals: columns semi_axis_1 to rotation_w, or nx, ny and nz")
        if columns is not None:
            raise TypeError("columns: for files; arrays have the names by which they are given")
    options = {
        "path": None if path is None else _arguments.file(path, "path"),
        "radius": rule,
        "weight": constant,
        "shape": shape if isinstance(shape, str) else "auto",
        "radius_scale": _arguments.number(radius_scale, "radius_scale", 1e-18),
        "length_scale": _arguments.number(length_scale, "length_scale", 1e-300, 1e300),
        "invalid": invalid,
        "precision": _precision(precision),
        "memory": _arguments.memory_bytes(memory),
        "threads": _arguments.thread_count(threads),
        "temp_dir": None if temp_dir is None else str(_arguments.path(temp_dir, "temp_dir")),
        "lod": None if lod is None else bool(lod),
    }
    names = tuple(classes)
    with Told(progress) as told:
        if is_of_files:
            points = _points.described(positions, columns, attributes, options["path"], {"color": color, "classes": classes})
            built = _points.built(points, options | {"attributes": []}, executor, timeout, told)
        elif isinstance(positions, Iterator):
            if radii is not None or weights is not None or color is not None or attributes:
                raise TypeError("chunks bring their own columns: yield {\"positions\": ..., \"radius\": ..., \"T\": ...} instead of arrays")
            built = _from_chunks(positions, names, options, told)
        else:
            gathered = _gathered(positions, radii, weights, color, attributes, names)
            given: tuple[str, ...] = () if isinstance(shape, str) else _arrays.SEMI_AXES + _arrays.ROTATION
            given += () if normals is None else _arrays.NORMAL
            _refuse_twice(given, attributes)
            gathered.columns = [one for one in gathered.columns if one.name not in given]
            if not isinstance(shape, str):
                of_shape, longest = _arrays.shapes(shape, len(gathered.positions), _arrays.unit_of(positions))
                has_radius = rule is not None or any(one.name == "radius" for one in gathered.columns)
                gathered.columns += of_shape + ([] if has_radius else [_arrays.Column("radius", longest)])
            if normals is not None:
                gathered.columns += _arrays.normals(normals, len(gathered.positions))
            options["attributes"] = [one.name for one in gathered.columns if one.is_attribute and one.name not in _arrays.OWN]
            if executor is not None:
                from ._executor import builds

                built = builds.build_arrays(executor, gathered, options, options["memory"], _arguments.seconds(timeout), told)
            else:
                arrays = [(one.named(), one.values) for one in gathered.columns]
                built = _native.build_arrays(gathered.positions, arrays, options, told)
    cloud, skipped, warned = built
    _warn_of(skipped, warned)
    return Cloud(cloud)


def _refuse_twice(given: tuple[str, ...], attributes: Any) -> None:
    """Columns that arguments give are no attributes, too."""
    for name in given:
        if name in (attributes or ()):
            argument = "normals" if name in _arrays.NORMAL else "shape"
            raise ValueError(f"attributes: {name!r} is given by {argument}=")


def _gathered(
    where: Any, radius: Any, weight: Any, color: Any, attributes: Any, classes: tuple[str, ...]
) -> _arrays.Points:
    is_plain = isinstance(where, np.ndarray) and not where.dtype.names
    table = None if is_plain or isinstance(where, (list, tuple)) else _arrays.table(where)
    if table is None:
        return _arrays.gather(where, radius, weight, color, attributes, classes)
    own = {"radius": radius, "weight": weight, "color": color}
    table |= {name: value for name, value in own.items() if value is not None}
    table |= attributes or {}
    points = _arrays.from_table(table, classes)
    if points is None:
        raise TypeError(f"positions: expected an array, a table or an iterator, and got {type(where).__name__}")
    return points


def _from_chunks(
    chunks: Iterator[Any], classes: tuple[str, ...], options: dict[str, Any], told: Any
) -> _native.Built:
    for number, chunk in enumerate(chunks, start=1):
        first = _arrays.of_chunk(chunk, classes, number)
        if len(first.positions):
            break
    else:
        raise ValueError("the iterator of chunks yields no points; an iterator can be used only once")
    options["attributes"] = [one.name for one in first.columns if one.is_attribute and one.name not in _arrays.OWN]
    names = [one.named() for one in first.columns]
    example = (first.positions[:0], [one.values[:0] for one in first.columns])
    return _native.build_chunks(example, names, _arrays.chunks(first, chunks, classes), options, told)


def _rule(value: Any, name: str, unit: Any) -> tuple[Any, Any]:
    """A rule for all points, or an array of a value for each."""
    if value is None:
        return None, None
    if isinstance(value, str):
        if name == "radius":
            return value, None
        raise TypeError(f"{name}={value!r}: expected a number or an array")
    if np.ndim(value) == 0 and _arrays.unit_of(value) is not None and unit is not None:
        value = float(_arrays.plain(value, name, unit))
    if np.ndim(value) == 0 and _arrays.unit_of(value) is None:
        return _arguments.number(value, name, 1e-18 if name == "radius" else -1e18), None
    if np.ndim(value) == 0:
        raise TypeError(f"{name}={value!r}: a quantity beside positions without a unit; give a plain number, or positions with a unit")
    return None, value


def _precision(value: float | str | None) -> float | None:
    if value is None:
        return 1 / 4096
    if value == "exact":
        return None
    if isinstance(value, str):
        raise ValueError(f"precision={value!r}: expected a fraction of the radius, as in 0.001, or \"exact\"")
    return _arguments.number(value, "precision", 1e-12, 1.0)


def _warn_of(skipped: Sequence[int], warned: Sequence[str]) -> None:
    reasons = ("no usable position", "no positive radius", "no finite weight")
    found = [f"{count} have {reason}" for count, reason in zip(skipped, reasons) if count]
    if found:
        warnings.warn(f"skipped {sum(skipped)} points: {', '.join(found)}", RaysetWarning, stacklevel=3)
    for text in warned:
        warnings.warn(text, RaysetWarning, stacklevel=3)


def build_grid(
    voxels: Any,
    *,
    spacing: float | Sequence[float] = 1.0,
    origin: Sequence[float] = (0.0, 0.0, 0.0),
    matrix: Any = None,
    path: _arguments.PathLike | None = None,
    memory: int | str | None = None,
    progress: Progress = False,
) -> Grid:
    """Builds a grid of voxels.

    Parameters
    ----------
    voxels
        An array of three axes, indexed ``[z, y, x]``, of any real type: whole numbers of up to 16 bits are kept, others become
        ``float32``, and what is not finite 0. Arrays that are read by slicing (zarr, h5py, dask, xarray) are read a slab at a time.
    spacing, origin
        Distances between voxels, and the centre of the first, along x, y and z.
    matrix
        In place of both: three rows of four, from indices of voxels (x, y, z) to the space of the grid.
    path
        The file to build; by default a temporary one, which goes with the grid.
    memory
        Most bytes that the build allocates; 256 MiB by default.
    """
    shape = tuple(getattr(voxels, "shape", np.shape(voxels)))
    if len(shape) != 3:
        raise ValueError(f"voxels: expected an array of three axes, [z, y, x], and got the shape {shape}")
    kind = np.dtype(getattr(voxels, "dtype", np.float64))
    if kind.kind not in "buif":
        raise TypeError(f"voxels: an array of {kind} where numbers were expected")
    # Whole numbers of up to 16 bits are kept.
    names = {"b1": "u8", "u1": "u8", "i1": "i16", "i2": "i16", "u2": "u16"}
    stored = names.get(f"{kind.kind}{kind.itemsize}", "f32")
    if not hasattr(voxels, "__getitem__") or isinstance(voxels, (list, tuple)):
        voxels = np.asarray(voxels)
    size, rows = [shape[2], shape[1], shape[0]], _matrix(spacing, origin, matrix)
    budget = _arguments.memory_bytes(memory)
    # Goes with the grid, or with what is raised.
    kept = TemporaryFile() if path is None else None
    where = _arguments.file(path, "path") if kept is None else kept.name
    with Told(progress) as told:
        made = _native.build_grid(_slabs(voxels, shape, stored), size, stored, rows, where, budget, told)
    return Grid(made, kept)


class TemporaryFile:
    """The name of a file that is removed when nobody has this any more."""

    def __init__(self, suffix: str = ".rset") -> None:
        # In a folder of its own: if this process is killed, the next one that makes such a folder removes it.
        folder = _native.TemporaryFolder()
        self.name = os.path.join(folder.path, f"file{suffix}")
        weakref.finalize(self, folder.close)


def _slabs(voxels: Any, shape: tuple[int, ...], stored: str) -> Iterator[bytes]:
    """The bytes of slabs of voxels, x fastest, little-endian."""
    rows = max(1, _SLAB // max(1, shape[1] * shape[2] * 8))
    little = np.dtype({"u8": "<u1", "i16": "<i2", "u16": "<u2", "f32": "<f4"}[stored])
    for at in range(0, shape[0], rows):
        slab = np.asarray(voxels[at : at + rows])
        if little.kind == "f":
            with np.errstate(over="ignore"):
                slab = np.nan_to_num(slab.astype(np.float32, copy=False), nan=0.0, posinf=0.0, neginf=0.0)
        yield np.ascontiguousarray(slab, dtype=little).tobytes()


def _matrix(spacing: Any, origin: Any, matrix: Any) -> list[list[float]]:
    if matrix is not None:
        rows = np.asarray(matrix, dtype=float)
        if rows.shape == (4, 4):
            rows = rows[:3]
        if rows.shape != (3, 4):
            raise ValueError(f"matrix: expected three rows of four numbers, and got the shape {rows.shape}")
        return [[float(v) for v in row] for row in rows]
    steps = [_arguments.number(spacing, "spacing")] * 3 if np.ndim(spacing) == 0 else _arguments.vector(spacing, "spacing")
    start = _arguments.vector(origin, "origin")
    return [[steps[k] if j == k else 0.0 for j in range(3)] + [start[k]] for k in range(3)]
