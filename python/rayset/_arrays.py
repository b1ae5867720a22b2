"""Arrays in the layouts that the engine reads, without a copy where theirs is one of them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import _native

#: Names of columns that mean something by themselves, and have arguments of their own.
OWN = ("radius", "weight", "red", "green", "blue")
#: Columns of the shapes of points.
SEMI_AXES = ("semi_axis_1", "semi_axis_2", "semi_axis_3")
ROTATION = ("rotation_x", "rotation_y", "rotation_z", "rotation_w")
#: The least semi-axis of an ellipsoid given by a matrix, as a part of its longest.
THINNEST = 1e-4
#: Columns of the normals of points.
NORMAL = ("nx", "ny", "nz")
#: Types of columns that are read as they are.
_READ = {np.dtype(name) for name in ("u1", "i1", "u2", "i2", "u4", "i4", "u8", "i8", "f4", "f8")}


@dataclass
class Column:
    """A column: its name, its numbers, its unit, whether they are labels of classes, and whether it may be kept as an attribute."""

    name: str
    values: NDArray[Any]
    unit: str = ""
    is_class: bool = False
    is_attribute: bool = True

    def named(self) -> dict[str, Any]:
        """What the engine is told of it besides its numbers."""
        return {"name": self.name, "unit": self.unit, "is_class": self.is_class}


@dataclass
class Points:
    """Positions, and all columns."""

    positions: NDArray[Any]
    columns: list[Column]
    unit: str = ""


def unit_of(value: Any) -> Any:
    """The unit of a quantity of astropy (``.unit``) or unyt (``.units``); ``None`` of plain numbers."""
    if not hasattr(value, "to_value"):
        return None
    return getattr(value, "unit", None) or getattr(value, "units", None)


def unit_name(unit: Any) -> str:
    """A unit as text; of pure numbers, whose unit unyt spells out, none."""
    return "" if unit is None or str(unit) == "dimensionless" else str(unit)


def plain(value: Any, name: str, unit: Any = None) -> NDArray[Any]:
    """The numbers of anything that has numbers, in `unit` if it is a quantity."""
    own = unit_of(value)
    if own is not None:
        try:
            value = value.to_value(unit) if unit is not None else getattr(value, "value", value)
        except Exception as error:
            raise ValueError(f"{name} is in {own}, which is not a length in {unit}: {error}") from error
    if hasattr(value, "filled") and hasattr(value, "mask"):  # of NumPy or astropy: what is masked is not a number
        value = value.astype(float).filled(np.nan) if np.any(value.mask) else value.filled(0)
    if isinstance(value, (str, bytes)) or hasattr(value, "__fspath__"):
        raise TypeError(f"{name}={_native.shown(repr(value))}: expected an array; rayset.open reads files")
    try:
        array = np.asarray(value)
    except ValueError:
        raise ValueError(f"{name}: the rows have different lengths, and are no array") from None
    if array.dtype == bool:
        array = array.view(np.uint8)
    elif array.dtype.kind == "f" and array.dtype.itemsize == 2:
        array = array.astype(np.float32)
    elif array.dtype.kind == "f" and array.dtype.itemsize > 8:
        array = array.astype(np.float64)
    if array.dtype.kind not in "uif":
        raise TypeError(f"{name}: an array of {array.dtype} where numbers were expected")
    if not array.dtype.isnative:
        array = array.astype(array.dtype.newbyteorder("="))
    return array if array.flags.aligned else array.copy()


def positions(value: Any) -> NDArray[Any]:
    """Rows of three coordinates, in single or double precision."""
    array = plain(value, "positions")
    if array.ndim != 2 or array.shape[1] != 3:
        advice = ""
        if array.ndim == 2 and array.shape[0] == 3:
            advice = "; transpose it: positions.T"
        elif array.ndim == 2 and array.shape[1] == 2:
            advice = "; give them a third coordinate: np.column_stack([positions, np.zeros(len(positions))])"
        elif array.ndim == 2 and array.shape[1] > 3:
            advice = "; positions[:, :3] are the first three columns, and others are radius=, color= or attributes="
        raise ValueError(f"positions: expected N rows of three numbers, and got the shape {array.shape}{advice}")
    return array if array.dtype.kind == "f" else array.astype(np.float64)


def column(value: Any, name: str, count: int, unit: Any = None) -> NDArray[Any]:
    """A number for each of `count` points."""
    array = plain(value, name, unit)
    if array.ndim == 2 and array.shape[1] == 1:
        array = array[:, 0]
    if array.ndim != 1:
        advice = ""
        if array.ndim == 2:
            advice = f"; give each of its columns a name: {{\"{name}_x\": {name}[:, 0], ...}}"
        raise ValueError(f"{name}: expected one number for each point, and got the shape {array.shape}{advice}")
    if len(array) != count:
        raise ValueError(f"{name} has {len(array)} values, where there are {count} positions")
    return array


def colors(value: Any, count: int) -> list[Column]:
    """The columns of colours: bytes as they are, and others as numbers of 0 to 1."""
    array = plain(value, "color")
    if array.ndim != 2 or array.shape[1] not in (3, 4) or len(array) != count:
        raise ValueError(f"color: expected {count} rows of red, green and blue, and got the shape {array.shape}")
    array = array[:, :3]
    if array.dtype.kind == "f":
        most = float(np.nanmax(array, initial=0.0))
        if most > 1.001:
            raise ValueError(f"color: floating-point colours are from 0 to 1, and the largest is {most:g}; divide them by 255")
        array = array.astype(np.float32, copy=False)
    elif array.dtype == np.uint16:
        array = array.astype(np.float32) / np.float32(65535)
    elif array.dtype != np.uint8:
        low, high = (int(array.min(initial=0)), int(array.max(initial=0)))
        if low < 0 or high > 255:
            raise ValueError(f"color: whole numbers are from 0 to 255, and these are from {low} to {high}; use uint16 for 0 to 65535")
        array = array.astype(np.uint8)
    return [Column(name, array[:, k]) for k, name in enumerate(("red", "green", "blue"))]


def shapes(shape: Any, count: int, unit: Any) -> tuple[list[Column], NDArray[Any]]:
    """Columns of the shapes of points, by matrices or by semi-axes and quaternions; and the longest semi-axis of each, in a unit."""
    if isinstance(shape, (tuple, list)) and len(shape) == 2 and np.ndim(shape[0]) == 2 and np.shape(shape[1])[-1:] == (4,):
        lengths, rotations = plain(shape[0], "shape", unit), plain(shape[1], "shape")
        if lengths.shape != (count, 3) or rotations.shape != (count, 4):
            found = f"{lengths.shape} and {rotations.shape}"
            raise ValueError(f"shape: expected {count} rows of three semi-axes, and {count} of quaternions (x, y, z, w), and got the shapes {found}")
    else:
        matrices = plain(shape, "shape", unit)
        if matrices.shape != (count, 3, 3):
            expected = f'"auto", "fluid", "round", an array of {count} matrices of 3 by 3, or a pair of N × 3 semi-axes and N × 4 quaternions'
            raise ValueError(f"shape: expected {expected}, and got the shape {matrices.shape}")
        lengths, rotations = _ellipsoids(matrices)
    names, values = SEMI_AXES + ROTATION, np.hstack([lengths, rotations]).astype(np.float64)
    return [Column(name, values[:, k], is_attribute=False) for k, name in enumerate(names)], lengths.max(axis=1).astype(np.float64)


def _ellipsoids(matrices: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
    """Semi-axes and quaternions of the ellipsoids to which matrices take the unit ball; NaN of what is none."""
    lengths = np.full((len(matrices), 3), np.nan)
    rotations = np.full((len(matrices), 4), np.nan)
    finite = np.isfinite(matrices).all(axis=(1, 2))
    if not finite.any():
        return lengths, rotations
    axes, found, _ = np.linalg.svd(matrices[finite].astype(np.float64))
    # What is flat, as the root of a covariance of points in a plane, is a thin disc: a length of 0 is rounding, or not.
    lengths[finite] = np.maximum(found, THINNEST * found[:, :1])
    axes[np.linalg.det(axes) < 0, :, 2] *= -1  # a rotation, not a reflection: either end of an axis is as good
    # The quaternion's largest component first, by which the others are divided.
    x, y, z = (axes[:, k, k] for k in range(3))
    squares = np.stack([1 + x - y - z, 1 - x + y - z, 1 - x - y + z, 1 + x + y + z], axis=1)
    sums = np.zeros((len(axes), 4, 4))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        sums[:, i, j] = sums[:, j, i] = axes[:, i, j] + axes[:, j, i]
        sums[:, 3, k] = sums[:, k, 3] = axes[:, j, i] - axes[:, i, j]
    sums[:, range(4), range(4)] = squares
    rows = np.take_along_axis(sums, squares.argmax(axis=1)[:, None, None], axis=1)[:, 0]
    rotations[finite] = rows / np.linalg.norm(rows, axis=1, keepdims=True)
    return lengths, rotations


def normals(values: Any, count: int) -> list[Column]:
    """Columns of the normals of points."""
    array = plain(values, "normals")
    if array.shape != (count, 3):
        raise ValueError(f"normals: expected {count} rows of three numbers, and got the shape {array.shape}")
    return [Column(name, column(array[:, k], "normals", count), is_attribute=False) for k, name in enumerate(NORMAL)]


def gather(
    where: Any,
    radius: Any,
    weight: Any,
    color: Any,
    attributes: Mapping[str, Any] | None,
    classes: tuple[str, ...],
    is_chunk: bool = False,
) -> Points:
    """Positions and columns of arrays; radius and weight are among them if they are arrays."""
    unit = unit_of(where)
    places = positions(where)
    count = len(places)
    if not count and not is_chunk:
        raise ValueError("positions: there are no points")
    columns: list[Column] = []
    if unit is None and unit_name(unit_of(radius)):
        raise ValueError(f"radius is in {unit_of(radius)}, and the positions have no unit; give them theirs, or the radius as plain numbers")
    for name, values in (("radius", radius), ("weight", weight)):
        if values is not None:
            own = column(values, name, count, unit if name == "radius" else None)
            columns.append(Column(name, own))
    if color is not None:
        columns += colors(color, count)
    if attributes is not None and not isinstance(attributes, Mapping):
        raise TypeError(f"attributes: expected a dictionary of names and arrays, and got {type(attributes).__name__}")
    for name, values in (attributes or {}).items():
        if not isinstance(name, str) or not name:
            raise TypeError(f"attributes: the name {name!r} is not a text")
        if name in OWN:
            own_name = name if name in ("radius", "weight") else "color"
            raise ValueError(f"attributes: {name!r} is given by {own_name}=")
        numbers = column(values, name, count)
        is_class = name in classes or np.asarray(values).dtype == bool
        columns.append(Column(name, numbers, unit_name(unit_of(values)), is_class))
    for name in classes:
        if name not in (attributes or {}):
            raise ValueError(f"classes: there is no attribute {name!r}; there are {', '.join(attributes or {}) or 'none'}")
    for one in columns:
        if one.is_class and one.values.dtype.kind == "f":
            raise ValueError(f"classes: {one.name!r} has floating-point numbers; labels are whole numbers")
        if one.values.dtype not in _READ:
            raise TypeError(f"{one.name}: an array of {one.values.dtype} cannot be stored")
    return Points(places, columns, unit_name(unit))


def table(value: Any) -> dict[str, Any] | None:
    """The columns of a table of pandas, polars, pyarrow, astropy or NumPy by name; ``None`` of anything else."""
    if isinstance(value, Mapping):
        return dict(value)
    if isinstance(value, np.ndarray) and value.dtype.names:
        return {name: value[name] for name in value.dtype.names}
    if hasattr(value, "to_pydict") and hasattr(value, "column_names"):  # pyarrow
        return {name: value.column(name).to_numpy(zero_copy_only=False) if not hasattr(value.column(name), "chunks")
                else value.column(name).to_numpy() for name in value.column_names}
    if hasattr(value, "to_pydict") and hasattr(value, "schema"):  # a record batch of pyarrow
        return {name: value.column(k).to_numpy(zero_copy_only=False) for k, name in enumerate(value.schema.names)}
    if hasattr(value, "colnames"):  # astropy
        from astropy.table import QTable

        # Columns of a plain Table have units, too, but are no quantities.
        value = QTable(value, copy=False)
        return {name: value[name] for name in value.colnames}
    if hasattr(value, "collect_schema") and hasattr(value, "collect"):  # a lazy frame of polars, or the like
        value = value.collect()
    if hasattr(value, "columns") and hasattr(value, "__getitem__"):  # pandas, polars
        return {str(name): value[name].to_numpy() for name in value.columns}
    return None


def from_table(value: Any, classes: tuple[str, ...] = (), is_chunk: bool = False) -> Points | None:
    """Points of a table with columns x, y and z, or positions; ``None`` if it is no table."""
    found = table(value)
    if found is None:
        return None
    names = {name.lower(): name for name in found}
    if "positions" in names:
        where = found.pop(names["positions"])
    elif all(axis in names for axis in "xyz"):
        axes = [found.pop(names[axis]) for axis in "xyz"]
        unit = unit_of(axes[0])
        where = np.column_stack([plain(axis, "xyz"[k], unit) for k, axis in enumerate(axes)])
        if unit is not None:
            where = where * unit
    else:
        raise ValueError(f"a table needs columns x, y and z, or positions; it has {', '.join(map(str, found)) or 'none'}")
    radius, weight, color = (found.pop(name, None) for name in ("radius", "weight", "color"))
    if color is None and all(name in found for name in ("red", "green", "blue")):
        color = np.column_stack([plain(found.pop(name), name) for name in ("red", "green", "blue")])
    more = found.pop("attributes", None)
    rest = {name: values for name, values in found.items() if _is_numeric(values)}
    points = gather(where, radius, weight, color, {**rest, **(more or {})}, classes, is_chunk)
    kinds: tuple[tuple[str, ...], ...] = (SEMI_AXES + ROTATION, NORMAL)
    for kind in kinds:
        # They say what shape points have, and are kept only if they are named as attributes, too.
        if all(name in rest for name in kind):
            for one in points.columns:
                one.is_attribute = one.is_attribute and (one.name not in kind or one.name in (more or {}))
    return points


def _is_numeric(values: Any) -> bool:
    """Columns of words and dates are left out."""
    return np.asarray(values).dtype.kind in "buif"


def chunks(first: Points, rest: Iterator[Any], classes: tuple[str, ...]) -> Iterator[tuple[NDArray[Any], list[NDArray[Any]]]]:
    """Chunks as the engine takes them, each with the columns of the first and in their types."""
    yield first.positions, [one.values for one in first.columns]
    for number, chunk in enumerate(rest, start=2):
        points = of_chunk(chunk, classes, number)
        if not len(points.positions):
            continue
        found = {one.name: one for one in points.columns}
        units = [("positions", points.unit, first.unit)]
        values = []
        for one in first.columns:
            if one.name not in found:
                raise ValueError(f"chunk {number} has no {one.name!r}, which the first has; it has {', '.join(found) or 'only positions'}")
            own = found[one.name].values
            units.append((one.name, found[one.name].unit, one.unit))
            if own.dtype != one.values.dtype:
                if not np.can_cast(own.dtype, one.values.dtype, "safe"):
                    raise ValueError(f"chunk {number}: {one.name!r} is of {own.dtype}, which does not fit into {one.values.dtype}, that of the first")
                own = own.astype(one.values.dtype)
            values.append(own)
        for name, unit, expected in units:
            if unit != expected:
                raise ValueError(f"chunk {number}: {name!r} is in {unit or 'no unit'}, in the first chunk in {expected or 'no unit'}; convert it")
        yield points.positions, values


def of_chunk(chunk: Any, classes: tuple[str, ...], number: int) -> Points:
    """The points of one chunk."""
    try:
        if hasattr(chunk, "__len__") and not len(chunk):
            return Points(np.zeros((0, 3)), [])
        points = None if isinstance(chunk, np.ndarray) and not chunk.dtype.names else from_table(chunk, classes, True)
        return points if points is not None else gather(chunk, None, None, None, None, (), True)
    except (TypeError, ValueError) as error:
        raise type(error)(f"chunk {number}: {error}") from error
