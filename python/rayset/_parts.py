"""Parts of scenes: transfer functions, materials, lights, cameras. Each is a few values that ``to_json`` gives as scenes have them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from . import _arguments


def curve(value: Any, name: str) -> list[list[float]]:
    """A curve: pairs of a value and an opacity."""
    try:
        pairs = [[float(x), float(y)] for x, y in value]
    except (TypeError, ValueError):
        raise TypeError(f"{name}={value!r}: expected pairs, as in [(0, 0), (1, 0.5)]") from None
    return pairs


@dataclass(frozen=True)
class Preset:
    """A colour map as ParaView's editor exports it: a file, and a name in it."""

    file: str
    name: str | None = None

    def to_json(self) -> dict[str, Any]:
        """As scenes have it."""
        return {"file": self.file} | ({} if self.name is None else {"name": self.name})


@dataclass(frozen=True)
class TransferFunction:
    """From densities (values, of voxels) to what is seen.

    Parameters
    ----------
    opacity
        ``"clamp"``, a number κ (extinction), or a curve: ``[(0, 0), (1, 0.5)]``.
    color
        A colour, ``"points"``, the name of a map, or stops ``[(0, "#000000"), (1, "#ffffff")]``.
    input
        What a map shows: ``"density"``, an attribute, or ``"x"``, ``"y"``, ``"z"``.
    value_range
        Over which the map goes.
    """

    opacity: Any = None
    color: Any = None
    input: str | None = None
    value_range: tuple[float, float] | None = None
    preset: Preset | None = None

    def to_json(self) -> dict[str, Any]:
        """As scenes have it."""
        made: dict[str, Any] = {}
        if isinstance(self.opacity, (int, float)) and not isinstance(self.opacity, bool):
            made["opacity"] = {"extinction": _arguments.number(self.opacity, "opacity", 0.0)}
        elif isinstance(self.opacity, (str, Mapping)):
            made["opacity"] = self.opacity
        elif self.opacity is not None:
            made["opacity"] = curve(self.opacity, "opacity")
        if self.color is not None:
            made["color"] = self.color if isinstance(self.color, str) else _stops(self.color)
        if self.input is not None:
            made["input"] = self.input
        if self.value_range is not None:
            low, high = self.value_range
            made["valueRange"] = [float(low), float(high)]
        if self.preset is not None:
            made["preset"] = self.preset.to_json()
        return made


def _stops(color: Any) -> Any:
    """Three numbers of linear light, or stops of a map."""
    found = list(color)
    return _arguments.vector(found, "color") if all(isinstance(v, (int, float, np.number)) for v in found) else [[at, _shown(own)] for at, own in found]


def _shown(color: Any) -> Any:
    return color if isinstance(color, str) else _arguments.vector(color, "color")


@dataclass(frozen=True)
class Material:
    """What light makes of a surface."""

    ambient: float = 0.25
    diffuse: float = 0.75
    specular: float = 0.1
    shininess: float = 32.0
    reflectance: float = 0.0
    refractive_index: float = 1.0

    def to_json(self) -> dict[str, Any]:
        """As scenes have it."""
        return {_camel(one.name): _arguments.number(getattr(self, one.name), one.name) for one in fields(self)}


def _camel(name: str) -> str:
    first, *rest = name.split("_")
    return first + "".join(word.capitalize() for word in rest)


@dataclass(frozen=True)
class Light:
    """A light. Use one of the functions below."""

    type: str
    intensity: float = 1.0
    color: Any = None
    direction: Any = None
    position: Any = None
    shadow: bool | None = None
    decay: bool | None = None

    def to_json(self) -> dict[str, Any]:
        """As scenes have it."""
        made: dict[str, Any] = {"type": self.type, "intensity": _arguments.number(self.intensity, "intensity", 0.0)}
        if self.color is not None:
            made["color"] = _arguments.color(self.color, "color")
        if self.direction is not None:
            made["direction"] = _arguments.direction(self.direction, "direction")
        if self.position is not None:
            made["position"] = _arguments.vector(self.position, "position")
        if self.shadow is not None:
            made["shadow"] = bool(self.shadow)
        if self.decay is not None:
            made["decay"] = bool(self.decay)
        return made


def AmbientLight(intensity: float = 1.0, color: _arguments.Color | None = None) -> Light:
    """Light from everywhere."""
    return Light("ambient", intensity, color)


def Headlight(intensity: float = 1.0, color: _arguments.Color | None = None) -> Light:
    """Light from the eye."""
    return Light("headlight", intensity, color)


def DirectionalLight(
    direction: _arguments.Vector, intensity: float = 1.0, color: _arguments.Color | None = None, *, shadow: bool = True
) -> Light:
    """A sun: `direction` is that in which its light goes."""
    return Light("directional", intensity, color, direction=direction, shadow=shadow)


def PointLight(
    position: _arguments.Vector, intensity: float = 1.0, color: _arguments.Color | None = None, *, shadow: bool = True, decay: bool = True
) -> Light:
    """A lamp, whose light falls off with the square of the distance if it decays."""
    return Light("point", intensity, color, position=position, shadow=shadow, decay=decay)


@dataclass(frozen=True)
class Camera:
    """From where something is seen: an eye at `position`, which looks at `look_at` or along `direction`.

    `about` is what :meth:`orbited` turns it about: what it looks at, if nothing is said. `fovy` is the vertical angle of view in degrees; with a `height` instead, rays are parallel and the picture is that high.
    :meth:`fit` makes one that frames an object.
    """

    position: Any
    look_at: Any = None
    direction: Any = None
    up: Any = (0.0, 1.0, 0.0)
    fovy: float = 45.0
    height: float | None = None
    about: Any = None

    def __post_init__(self) -> None:
        if (self.look_at is None) == (self.direction is None):
            raise TypeError("a camera has either look_at or direction")
        self.to_json()

    @staticmethod
    def fit(
        target: Any,
        *,
        view: str | None = None,
        direction: _arguments.Vector | None = None,
        up: _arguments.Vector | str | None = None,
        fovy: float | None = None,
        orthographic: bool = False,
        size: Any = (512, 512),
    ) -> Camera:
        """A camera that frames an object, as pictures have it by default: from `view` (``"iso"``, ``"front"``, ``"back"``, ``"left"``,
        ``"right"``, ``"top"``, ``"bottom"``) or along `direction`, for pictures of `size`."""
        from ._compose import fitted

        return fitted(target, view, direction, up, fovy, orthographic, size)

    @staticmethod
    def from_json(node: Mapping[str, Any]) -> Camera:
        """The camera of a scene, if it has a position."""
        if "position" not in node:
            raise ValueError("a camera without a position frames its scene, and is none by itself; Camera.fit makes one")
        return Camera(
            position=tuple(node["position"]),
            look_at=tuple(node["lookAt"]) if "lookAt" in node else None,
            direction=tuple(node["direction"]) if "direction" in node else None,
            up=tuple(node.get("up", (0.0, 1.0, 0.0))),
            fovy=node.get("fovy", 45.0),
            height=node.get("height"),
        )

    def to_json(self) -> dict[str, Any]:
        """As scenes have it."""
        made: dict[str, Any] = {"position": _arguments.vector(self.position, "position")}
        if self.look_at is not None:
            made["lookAt"] = _arguments.vector(self.look_at, "look_at")
        else:
            made["direction"] = _arguments.direction(self.direction, "direction")
        made["up"] = _arguments.direction(self.up, "up")
        if self.height is None:
            made["fovy"] = _arguments.number(self.fovy, "fovy", 1e-3, 179.0)
        else:
            made |= {"type": "orthographic", "height": _arguments.number(self.height, "height", 1e-18)}
        return made

    def orbited(self, degrees: float, about: _arguments.Vector | None = None) -> Camera:
        """The same camera, turned about what it looks at (or `about`), around what is up."""
        if about is None:
            about = self.look_at if self.about is None else self.about
        if about is None:
            raise ValueError("orbited: a camera with a direction needs about=, the place that it is turned about")
        center, eye = np.array(_arguments.vector(about, "about")), np.array(_arguments.vector(self.position, "position"))
        turn = _rotation(self.up, math.radians(_arguments.number(degrees, "degrees")))
        place = tuple((center + turn @ (eye - center)).tolist())
        if self.direction is None:
            return replace(self, position=place, look_at=tuple((center + turn @ (np.array(self.look_at) - center)).tolist()))
        return replace(self, position=place, direction=tuple((turn @ np.array(self.direction, dtype=float)).tolist()))


def _rotation(axis: Sequence[float], angle: float) -> Any:
    """The matrix of a rotation (Rodrigues)."""
    k = np.array(_arguments.direction(axis, "up"))
    k = k / np.linalg.norm(k)
    cross = np.array([[0, -k[2], k[1]], [k[2], 0, -k[0]], [-k[1], k[0], 0]])
    return np.eye(3) + math.sin(angle) * cross + (1 - math.cos(angle)) * (cross @ cross)
