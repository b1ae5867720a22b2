"""From an object and what is said of its look to a scene."""

from __future__ import annotations

import copy
import json
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

from . import _arguments, _native
from ._errors import SceneError
from ._objects import Cloud, Grid, Object
from ._parts import Camera, Light

#: What can be said of a look. The background is an argument of its own.
LOOK_OPTIONS: tuple[str, ...] = tuple(name for name in _native.look_options() if name != "background")
_VIEWS = ("iso", "front", "back", "left", "right", "top", "bottom")
#: What a look says of a cloud or a grid itself.
_OF_LEAF = ("transferFunction", "interpolation", "material", "kernel", "normalised", "radiusScale")


def look_options(options: Mapping[str, Any]) -> dict[str, Any]:
    """What was said of a look; the program reads what its values mean."""
    for name in options:
        if name not in LOOK_OPTIONS:
            raise TypeError(f"unknown argument {name!r}; a look has {', '.join(LOOK_OPTIONS)}")
    return {name: value for name, value in options.items() if value is not None and value is not False}


def camera_options(view: Any, direction: Any, up: Any, fovy: Any, orthographic: bool) -> dict[str, Any]:
    """What was said of a camera."""
    said: dict[str, Any] = {}
    if view is not None:
        said["view"] = _arguments.choice(view, "view", _VIEWS)
    if direction is not None:
        said["direction"] = _arguments.direction(direction, "direction")
    if up is not None:
        said["up"] = up if isinstance(up, str) else _arguments.direction(up, "up")
    if fovy is not None:
        said["fovy"] = _arguments.number(fovy, "fovy", 1e-3, 179.0)
    if orthographic:
        said["orthographic"] = True
    return said


def _plain(value: Any) -> Any:
    """A value as JSON has it: numbers and arrays of NumPy as numbers and lists, numbers that JSON has none for and all else as texts."""
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, (list, tuple)):
        return [_plain(each) for each in value]
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    return value if isinstance(value, (bool, int, float, str)) else str(value)


#: A place on the axis that the cameras of a turntable turn about, and its direction.
About = tuple[Sequence[float], Sequence[float]]


def look_of(
    held: Cloud | Grid, said: Mapping[str, Any], size: tuple[int, int], turns: bool = False
) -> tuple[dict[str, Any], str, About | None]:
    """The scene that a cloud or grid is rendered as, what is said of it, and with `turns` what the cameras of a turntable turn about, of
    which its camera is the first. Errors name arguments, not options."""
    try:
        text, line, _, _, about = held._file.look(json.dumps({name: _plain(value) for name, value in said.items()}), size, turns)
    except SceneError as error:
        words = re.sub(r"--([a-z-]+)", lambda found: found[1].replace("-", "_"), str(error))
        raise SceneError(words.replace(", for which `help` lists the others", "")) from None
    return json.loads(text), line, about


def fitted(target: Any, view: Any, direction: Any, up: Any, fovy: Any, orthographic: bool, size: Any) -> Camera:
    """See :meth:`Camera.fit`."""
    if not isinstance(target, Object):
        raise TypeError(f"Camera.fit: expected a cloud, a grid or an object made of them, and got {type(target).__name__}")
    data = _framed(target)
    if data is None:
        raise ValueError("Camera.fit: there are no points or voxels to frame; say position and look_at")
    chosen, _, _ = look_of(data, camera_options(view, direction, up, fovy, orthographic), _arguments.size(size))
    middle = tuple(0.5 * (a + b) for a, b in zip(*data.bounds))
    return replace(Camera.from_json(chosen["camera"]), about=middle)


def _framed(target: Object) -> Cloud | Grid | None:
    """The cloud or grid that is framed: the first, which is what others are taken from."""
    return next(iter(target._data.values()), None)


class Composed:
    """A scene as a dictionary, what it refers to, and what was said of it."""

    def __init__(self, scene: dict[str, Any], data: Mapping[str, Cloud | Grid], line: str = "") -> None:
        self.scene = scene
        self.data = dict(data)
        self.line = line


def compose(target: Object, options: Mapping[str, Any], camera: Camera | None, size: tuple[int, int], camera_said: Mapping[str, Any]) -> Composed:
    """The scene of an object: clouds and grids that have no transfer function get a look, and the first one's lights, background and
    settings are those of the whole."""
    said = look_options(options)
    leaves = {name: held for name, held in target._data.items()}
    chosen: dict[str, dict[str, Any]] = {}
    line = ""
    for name, held in leaves.items():
        # What is said of a look is for the first; a grid beside a cloud has none of it.
        own = said if not chosen or isinstance(held, Cloud) else {}
        chosen[name], said_of_it, _ = look_of(held, {**own, **camera_said}, size)
        line = line or said_of_it
    if not chosen:
        if said:
            name, value = next(iter(said.items()))
            raise ValueError(f"{name}={value}: looks are for clouds and grids, and this has none")
        scene: dict[str, Any] = {"rayset": 1, "image": {"size": list(size), "samples": 2}, "root": target.to_json()}
    else:
        first = next(iter(chosen.values()))
        scene = {key: value for key, value in first.items() if key != "root"}
        scene["root"] = _dressed(target._node, chosen)
        if all("transferFunction" in node for node in _leaves(target._node)):
            # It belongs to looks of surfaces, and nothing here has one.
            scene.get("rendering", {}).pop("ambientOcclusion", None)
        if len(chosen) > 1 and "compositing" not in said:
            # Splats alone are blended as they were trained; light of several objects adds up.
            scene.get("rendering", {}).pop("compositing", None)
        if not _is_framed_by_first(target):
            scene["camera"] = {key: first["camera"][key] for key in ("type", "up", "fovy") if key in first["camera"]}
            scene["camera"]["direction"] = _direction(first["camera"])
    if camera is not None:
        scene["camera"] = camera.to_json()
    return Composed(scene, target._data, line)


def first_of_turntable(
    target: Object, options: Mapping[str, Any], size: tuple[int, int], camera_said: Mapping[str, Any]
) -> tuple[dict[str, Any], About] | None:
    """The first camera of a turntable whose cameras all see the only cloud or grid of an object, and what they turn about; ``None`` of
    objects whose bounds are to be framed."""
    if not _is_framed_by_first(target):
        return None
    (held,) = target._data.values()
    chosen, _, about = look_of(held, {**look_options(options), **camera_said}, size, turns=True)
    return None if about is None else (chosen["camera"], about)


def _is_framed_by_first(target: Object) -> bool:
    """Whether all that is seen is where the only cloud or grid is: it is not moved, and what is added to it lies within its bounds."""
    if len(target._data) != 1:
        return False
    (held,) = target._data.values()
    low, high = held.bounds
    margin = 0.02 * max(b - a for a, b in zip(low, high))

    def stays(node: Mapping[str, Any]) -> bool:
        kind = node.get("type")
        if kind in ("cloud", "grid"):
            return "transform" not in node
        children = node.get("children")
        if children is None:
            box = _bounds_of_solid(node)
            return box is not None and all(low[k] - margin <= box[0][k] and box[1][k] <= high[k] + margin for k in range(3))
        if "transform" in node:
            return False
        if kind == "difference":
            return stays(children[0])
        return any(map(stays, children)) if kind == "intersection" else all(map(stays, children))

    return stays(target._node)


def _leaves(node: Mapping[str, Any]) -> Iterator[Mapping[str, Any]]:
    """The clouds and grids of a node."""
    if node.get("type") in ("cloud", "grid"):
        yield node
    for child in node.get("children", []):
        yield from _leaves(child)


def _bounds_of_solid(node: Mapping[str, Any]) -> tuple[list[float], list[float]] | None:
    """The box around a solid that was only moved; `None` of others."""
    half = {
        "sphere": lambda: [node["radius"]] * 3,
        "box": lambda: [0.5 * v for v in node["size"]],
        "ellipsoid": lambda: list(node["radii"]),
        "noise": lambda: list(node["radii"]),
    }.get(str(node.get("type")))
    moves = node.get("transform", [])
    if half is None or not all(isinstance(move, Mapping) and set(move) == {"translate"} for move in moves):
        return None
    place = [sum(move["translate"][k] for move in moves) for k in range(3)]
    size = half()
    return [place[k] - size[k] for k in range(3)], [place[k] + size[k] for k in range(3)]


def _direction(camera: Mapping[str, Any]) -> list[float]:
    if "direction" in camera:
        return list(camera["direction"])
    return [b - a for a, b in zip(camera["position"], camera["lookAt"])]


def _dressed(node: Mapping[str, Any], chosen: Mapping[str, dict[str, Any]]) -> dict[str, Any]:
    """A node whose clouds and grids have looks."""
    made = dict(copy.deepcopy(dict(node)))
    if "children" in made:
        made["children"] = [_dressed(child, chosen) for child in node["children"]]
    own = chosen.get(made.get("file", ""))
    if own is not None and "transferFunction" not in made:
        root = own["root"]
        for key in _OF_LEAF:
            if key in root and key not in made:
                made[key] = root[key]
        made.setdefault("comment", root.get("comment", ""))
    return made


def lights_json(lights: Any) -> Any:
    """Lights as scenes have them."""
    if lights == "none" or lights is None:
        return lights
    if isinstance(lights, Light):
        lights = [lights]
    if isinstance(lights, str) or not isinstance(lights, Iterable):
        raise TypeError(f"lights={lights!r}: expected a list of lights, or \"none\"")
    found = []
    for light in lights:
        if not isinstance(light, (Light, Mapping)):
            raise TypeError(f"lights: expected lights, and got {light!r}")
        found.append(light.to_json() if isinstance(light, Light) else dict(light))
    return found
