"""What is seen: clouds, grids and solids, and what operators make of them.

Every object is a node of a scene as ``docs/scene.md`` has them. Objects never change; what looks like a change is another object.
"""

from __future__ import annotations

import copy
import weakref
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from . import _arguments, _native
from ._parts import Material, Preset, TransferFunction, curve

T = TypeVar("T", bound="Object")

#: Names of things in the node of an object that is yet to be given a look.
_LOOK = ("transferFunction", "interpolation", "kernel", "normalised", "radiusScale")


class Object:
    """Something that can be seen, moved, and combined by ``|`` (union), ``&`` (intersection), ``-`` (difference) and ``+`` (blend)."""

    _node: dict[str, Any]

    def __init__(self, node: Mapping[str, Any], data: Mapping[str, Cloud | Grid] | None = None) -> None:
        self._node = dict(node)
        self._held = dict(data or {})

    @property
    def _data(self) -> dict[str, Cloud | Grid]:
        """What the node refers to, by the names of its files."""
        return self._held

    def to_json(self) -> dict[str, Any]:
        """The node, as a scene has it."""
        return copy.deepcopy(self._node)

    def __repr__(self) -> str:
        return f"<rayset.{type(self).__name__} {self._node.get('type', 'ref')}>"

    def _like(self, **changes: Any) -> Object:
        return Object({**self._node, **changes}, self._data)

    def __or__(self, other: Object) -> Object:
        return _combined("union", self, other)

    def __and__(self, other: Object) -> Object:
        return _combined("intersection", self, other)

    def __sub__(self, other: Object) -> Object:
        return _combined("difference", self, other)

    def __add__(self, other: Object) -> Object:
        return _combined("blend", self, other)

    def __radd__(self, other: object) -> Object:
        # So that sum() works, which begins with 0.
        return self if other == 0 else NotImplemented

    def moved(self, translate: _arguments.Vector) -> Object:
        """The same, somewhere else."""
        return self._moved({"translate": _arguments.vector(translate, "translate")})

    def rotated(self, axis: _arguments.Vector | str, degrees: float) -> Object:
        """The same, turned about an axis through the origin."""
        named = {"x": (1, 0, 0), "y": (0, 1, 0), "z": (0, 0, 1)}
        about = named.get(axis, axis) if isinstance(axis, str) else axis
        turn = {"axis": _arguments.direction(about, "axis"), "degrees": _arguments.number(degrees, "degrees")}
        return self._moved({"rotate": turn})

    def scaled(self, factor: float | _arguments.Vector) -> Object:
        """The same, larger or smaller about the origin, by one factor or one for each axis."""
        scale = _arguments.number(factor, "factor") if np.ndim(factor) == 0 else _arguments.vector(factor, "factor")
        return self._moved({"scale": scale})

    def transformed(self, matrix: Any) -> Object:
        """The same, under an affine map: three rows of four numbers, or four of four."""
        rows = np.asarray(matrix, dtype=float)
        if rows.shape == (4, 4):
            rows = rows[:3]
        if rows.shape != (3, 4):
            raise ValueError(f"matrix: expected three rows of four numbers, and got the shape {rows.shape}")
        return self._moved({"matrix": [[float(v) for v in row] for row in rows]})

    def _moved(self, move: dict[str, Any]) -> Object:
        moves = self._node.get("transform", [])
        moves = moves if isinstance(moves, list) else [moves]
        return self._like(transform=[*moves, move])

    def with_material(self, material: Material | Mapping[str, Any] | None = None, **values: float) -> Object:
        """The same, of a :class:`Material`, which lights see."""
        if material is None:
            material = Material(**values)
        return self._like(material=material.to_json() if isinstance(material, Material) else dict(material))

    def with_transfer(
        self, input: str, *, opacity: Any = None, color: Any = None, value_range: tuple[float, float] | None = None
    ) -> Object:
        """The same, with a transfer function over what it makes: of ``"opacity"``, ``"red"``, ``"green"``, ``"blue"``, or an attribute
        of any object in it."""
        made: dict[str, Any] = {"input": input}
        if opacity is not None:
            made["opacity"] = curve(opacity, "opacity")
        if color is not None:
            made["color"] = color if isinstance(color, (str, dict)) else [list(stop) for stop in color]
        if value_range is not None:
            made["valueRange"] = [float(v) for v in value_range]
        return self._like(transfers=[*self._node.get("transfers", []), made])

    def with_cap(self, color: _arguments.Color) -> Object:
        """The same difference, whose first object is filled with a colour before it is cut."""
        if self._node.get("type") != "difference":
            raise ValueError("with_cap is for differences, as in (scan - box).with_cap(\"#806040\")")
        return self._like(cap=_arguments.color(color, "color"))

    def named(self, name: str) -> Object:
        """The same, with a name for the people who read the scene."""
        return self._like(id=str(name))


def _combined(operator: str, first: Object, second: Object) -> Object:
    if not isinstance(second, Object):
        signs = {"union": "|", "intersection": "&", "difference": "-", "blend": "+"}
        raise TypeError(f"{first!r} {signs[operator]} {second!r}: expected a cloud, a grid or a solid on both sides")
    # Chains of one operator are one operator: a | b | c has three children, and nests no deeper than two.
    children: list[dict[str, Any]] = []
    plain = first._node.get("type") == operator and set(first._node) <= {"type", "children"}
    children += first._node["children"] if plain else [first._node]
    children.append(second._node)
    return Object({"type": operator, "children": children}, {**first._data, **second._data})


@dataclass(frozen=True)
class Attribute:
    """A column of a cloud."""

    name: str
    type: str
    unit: str
    is_class: bool
    range: tuple[float, float]


#: What is in memory, by the names that scenes have for it, as long as somebody has it.
_in_memory: weakref.WeakValueDictionary[str, Cloud | Grid] = weakref.WeakValueDictionary()


def held_in_memory(name: str) -> Cloud | Grid:
    """A cloud or grid in memory by its name in a scene."""
    held = _in_memory.get(name)
    if held is None:
        raise ValueError(f"{name!r} is the name of a cloud or grid in memory that is no more; keep it while its scenes are used, or save them")
    return held


class _Data(Object):
    """What clouds and grids have in common."""

    _file: _native.CloudFile | _native.GridFile

    def __init__(self, file: Any, kind: str, keep: object = None) -> None:
        self._file = file
        #: Lives as long as this does.
        self._keep = keep
        name = file.address
        super().__init__({"type": kind, "file": name})
        if file.is_in_memory:
            _in_memory[name] = self  # type: ignore[assignment]
        self._header: dict[str, Any] = file.header()

    @property
    def _data(self) -> dict[str, Cloud | Grid]:
        # Not kept: in a circle of references, memory would be given back late.
        return {self._node["file"]: self}  # type: ignore[dict-item]

    @property
    def path(self) -> str | None:
        """The file; ``None`` in memory."""
        return None if self._file.is_in_memory else self._file.path

    @property
    def in_memory(self) -> bool:
        """Whether all of it is in memory."""
        return bool(self._file.is_in_memory)

    @property
    def file_bytes(self) -> int:
        """Size of the file, or of what is in memory."""
        return int(self._header["file_bytes"])

    @property
    def identity(self) -> str:
        """What distinguishes it from others: the same for the same content and options."""
        return str(self._header["identity"])

    @property
    def up(self) -> tuple[float, float, float] | None:
        """What is up by the word of the file; ``None`` if it says nothing."""
        return self._header["up"]  # type: ignore[no-any-return]

    @property
    def sources(self) -> list[str]:
        """What it was built of."""
        return list(self._header["sources"])

    def save(self, path: _arguments.PathLike) -> None:
        """Writes the file of it, which :func:`open` and the program open."""
        self._file.save(_arguments.file(path, "path"))

    def styled(self, transfer_function: TransferFunction | Mapping[str, Any] | None = None, **style: Any) -> Object:
        """The same, with a :class:`TransferFunction` of its own instead of a look: ``opacity``, ``color``, ``input``, ``value_range``,
        ``preset``; of clouds also ``kernel``, ``normalised`` and ``radius_scale``, of grids ``interpolation`` (``linear``, or ``label``, which
        mixes no values)."""
        keys = {"kernel": "kernel", "normalised": "normalised", "radius_scale": "radiusScale", "interpolation": "interpolation"}
        node = {keys[name]: style.pop(name) for name in keys if name in style}
        is_grid = isinstance(self, Grid)
        if any((name == "interpolation") != is_grid for name in node):
            raise TypeError("kernel, normalised and radius_scale are for points, interpolation is for the voxels of grids")
        if transfer_function is None:
            transfer_function = TransferFunction(**style)
        elif style:
            raise TypeError(f"styled: {', '.join(style)} stand beside a transfer function, which has them")
        made = transfer_function.to_json() if isinstance(transfer_function, TransferFunction) else dict(transfer_function)
        return self._like(transferFunction=made, **node)

    def __reduce__(self) -> Any:
        if self._file.is_in_memory or self._keep is not None:
            raise TypeError("a cloud or grid in memory cannot be pickled; save it, and open the file in the other process")
        from ._open import open as opened

        return opened, (self._file.address,)

    def _repr_png_(self) -> bytes:
        from ._render import render

        picture = render(self, size=(480, 360))
        return picture._repr_png_()


class Cloud(_Data):
    """A cloud of points. Made by :func:`build` and :func:`open`."""

    _file: _native.CloudFile

    def __init__(self, file: _native.CloudFile, keep: object = None) -> None:
        super().__init__(file, "cloud", keep)

    @property
    def points(self) -> int:
        """Number of points."""
        return int(self._header["points"])

    def __len__(self) -> int:
        return self.points

    @property
    def copies(self) -> int:
        """Number of points of the input that were equal to others in everything, and became one
        with them, of the sum of their weights."""
        return int(self._header["copies"])

    @property
    def skipped(self) -> int:
        """Number of points of the input that were left out."""
        return int(self._header["skipped"])

    @property
    def bounds(self) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
        """The smallest and the largest coordinates of positions."""
        return self._header["bounds"]  # type: ignore[no-any-return]

    @property
    def radius(self) -> tuple[float, float]:
        """The smallest and the largest radius."""
        return self._header["radius"]  # type: ignore[no-any-return]

    @property
    def has_color(self) -> bool:
        """Whether points have colours."""
        return bool(self._header["has_color"])

    @property
    def attributes(self) -> dict[str, Attribute]:
        """The columns by name."""
        found = (Attribute(**one) for one in self._header["attributes"])
        return {one.name: one for one in found}

    @property
    def crs(self) -> str:
        """The coordinate reference system, as the file gives it; empty if it gives none."""
        return str(self._header["crs"])

    def sample(self, most: int = 16384) -> tuple[NDArray[np.float64], dict[str, NDArray[np.float64]]]:
        """About `most` points, evenly spread over the file: their positions, and their columns by name."""
        positions, columns = self._file.sample(_arguments.whole(most, "most", 1, 1 << 28))
        return positions, dict(columns)

    def __repr__(self) -> str:
        where = "in memory" if self.in_memory else self.path
        names = ", ".join(self.attributes)
        return f"<rayset.Cloud {self.points:,} points{', ' + names if names else ''}, {where}>"


class Grid(_Data):
    """A grid of voxels. Made by :func:`build_grid` and :func:`open`."""

    _file: _native.GridFile

    def __init__(self, file: _native.GridFile, keep: object = None) -> None:
        super().__init__(file, "grid", keep)

    @property
    def shape(self) -> tuple[int, int, int]:
        """Numbers of voxels along z, y and x, as of an array ``[z, y, x]``."""
        x, y, z = self._header["size"]
        return z, y, x

    @property
    def range(self) -> tuple[float, float]:
        """The smallest and the largest value."""
        return self._header["range"]  # type: ignore[no-any-return]

    @property
    def matrix(self) -> NDArray[np.float64]:
        """Three rows of four, from indices of voxels (x, y, z) to the space of the grid."""
        return np.array(self._header["matrix"])

    @property
    def bounds(self) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
        """The smallest and the largest coordinates of the centres of voxels."""
        x, y, z = (size - 1 for size in self._header["size"])
        corners = np.array([[i, j, k, 1] for i in (0, x) for j in (0, y) for k in (0, z)]) @ self.matrix.T
        low, high = corners.min(axis=0).tolist(), corners.max(axis=0).tolist()
        return tuple(low), tuple(high)

    def to_numpy(self) -> NDArray[np.float32]:
        """All values, as an array ``[z, y, x]`` in memory."""
        voxels, scale, offset = self._file.voxels()
        values = voxels.reshape(self.shape)
        return values if (scale, offset) == (1.0, 0.0) else (values * scale + offset).astype(np.float32)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        return self.to_numpy() if dtype is None else self.to_numpy().astype(dtype)

    def __repr__(self) -> str:
        where = "in memory" if self.in_memory else self.path
        return f"<rayset.Grid {' x '.join(map(str, self.shape))} voxels, {where}>"


def _solid(kind: str, style: dict[str, Any], center: Any = None, **values: Any) -> Object:
    known = ("color", "opacity", "edge")
    for name in style:
        if name not in known:
            raise TypeError(f"{kind}: unknown {name!r}; a solid has {', '.join(known)}")
    node: dict[str, Any] = {"type": kind, **values}
    if style.get("color") is not None:
        own = style["color"]
        node["color"] = own if isinstance(own, dict) else _arguments.color(own, "color")
    for name in ("opacity", "edge"):
        if style.get(name) is not None:
            node[name] = _arguments.number(style[name], name, 0.0)
    if center is not None:
        place = _arguments.vector(center, "center")
        if any(place):
            node["transform"] = [{"translate": place}]
    return Object(node)


def Box(low: _arguments.Vector, high: _arguments.Vector, **style: Any) -> Object:
    """A box from its smallest corner to its largest. All solids have ``color``, ``opacity`` 1 and ``edge`` 0, the width over which they
    fall off."""
    a, b = _arguments.vector(low, "low"), _arguments.vector(high, "high")
    if not all(a[k] < b[k] for k in range(3)):
        raise ValueError(f"a box from {tuple(a)} to {tuple(b)} is empty; the first corner has the smaller coordinates")
    middle = [0.5 * (a[k] + b[k]) for k in range(3)]
    return _solid("box", style, middle, size=[b[k] - a[k] for k in range(3)])


def Sphere(center: _arguments.Vector, radius: float, **style: Any) -> Object:
    """A ball."""
    return _solid("sphere", style, center, radius=_arguments.number(radius, "radius", 1e-18))


def Ellipsoid(center: _arguments.Vector, radii: _arguments.Vector, **style: Any) -> Object:
    """An ellipsoid along the axes."""
    return _solid("ellipsoid", style, center, radii=_arguments.vector(radii, "radii"))


def Cylinder(center: _arguments.Vector, radius: float, height: float, *, axis: _arguments.Vector | str = "y", **style: Any) -> Object:
    """A cylinder about its centre, along an axis."""
    return _along("cylinder", center, radius, height, axis, style)


def Cone(center: _arguments.Vector, radius: float, height: float, *, axis: _arguments.Vector | str = "y", **style: Any) -> Object:
    """A cone about the middle of its height, along an axis."""
    return _along("cone", center, radius, height, axis, style)


def _along(kind: str, center: Any, radius: Any, height: Any, axis: Any, style: dict[str, Any]) -> Object:
    made = _solid(
        kind, style, radius=_arguments.number(radius, "radius", 1e-18), height=_arguments.number(height, "height", 1e-18)
    )
    return _turned_from_y(made, axis).moved(center)


def Torus(center: _arguments.Vector, major: float, minor: float, *, axis: _arguments.Vector | str = "y", **style: Any) -> Object:
    """A ring: `major` is the radius of its middle line, `minor` half its thickness."""
    made = _solid(
        "torus", style, majorRadius=_arguments.number(major, "major", 1e-18), minorRadius=_arguments.number(minor, "minor", 1e-18)
    )
    return _turned_from_y(made, axis).moved(center)


def _turned_from_y(made: Object, axis: Any) -> Object:
    named = {"x": (1, 0, 0), "y": (0, 1, 0), "z": (0, 0, 1)}
    to = np.array(_arguments.direction(named.get(axis, axis) if isinstance(axis, str) else axis, "axis"))
    to = to / np.linalg.norm(to)
    about = np.cross((0.0, 1.0, 0.0), to)
    if not np.any(np.abs(about) > 1e-12):
        return made if to[1] > 0 else made.rotated("x", 180.0)
    return made.rotated(about.tolist(), float(np.degrees(np.arccos(np.clip(to[1], -1.0, 1.0)))))


def HalfSpace(normal: _arguments.Vector, offset: float = 0.0, **style: Any) -> Object:
    """All places x with ``normal · x <= offset``, for a `normal` of length one; to be cut off by an intersection, or taken away."""
    return _solid("halfSpace", style, normal=_arguments.direction(normal, "normal"), offset=_arguments.number(offset, "offset"))


def Noise(center: _arguments.Vector, radii: _arguments.Vector, scale: float, **style: Any) -> Object:
    """A cloud of fractal noise that fills an ellipsoid; ``octaves``, ``roughness``, ``opacity``, ``cover``, ``seed``, ``color``."""
    own = {name: style.pop(name) for name in ("octaves", "roughness", "cover", "seed") if name in style}
    return _solid(
        "noise", style, center, radii=_arguments.vector(radii, "radii"), scale=_arguments.number(scale, "scale", 1e-18), **own
    )


def union(objects: Sequence[Object]) -> Object:
    """All objects together, as ``|`` makes them."""
    return _all("union", objects)


def intersection(objects: Sequence[Object]) -> Object:
    """What is in all objects, as ``&`` makes it."""
    return _all("intersection", objects)


def blend(objects: Sequence[Object]) -> Object:
    """All objects, mixed where they meet, as ``+`` makes them."""
    return _all("blend", objects)


def _all(operator: str, objects: Sequence[Object]) -> Object:
    found = list(objects)
    for one in found:
        if not isinstance(one, Object):
            raise TypeError(f"{operator}: expected objects, and got {one!r}")
    if not found:
        raise ValueError(f"{operator}: no objects")
    if len(found) == 1:
        return found[0]
    data = {name: held for one in found for name, held in one._data.items()}
    return Object({"type": operator, "children": [one._node for one in found]}, data)


__all__ = [
    "Attribute", "Box", "Cloud", "Cone", "Cylinder", "Ellipsoid", "Grid", "HalfSpace", "Noise", "Object", "Preset", "Sphere", "Torus",
    "blend", "intersection", "union",
]
