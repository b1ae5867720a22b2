"""Scenes: everything that decides the pixels of a picture, as ``docs/scene.md`` has it."""

from __future__ import annotations

import copy
import json
import os
import weakref
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Literal

from . import _arguments, _compose, _native
from ._objects import Cloud, Grid, Object, held_in_memory
from ._parts import Camera

Samples = int | Literal["auto"]


class Scene:
    """A scene, which is a dictionary: :meth:`to_json` gives it, and :meth:`from_json` takes it back.

    Parameters
    ----------
    root
        The object that is seen. Clouds and grids without a transfer function get a look.
    camera
        A :class:`Camera`; by default one that frames the root.
    lights
        A list of lights, or ``"none"``; those of the look by default.
    background
        A colour; ``"none"`` for transparent; that of the look by default.
    size, samples, exposure, tone_mapping
        Width and height, rays along each side of a pixel or ``"auto"``, stops, ``"none"`` or ``"filmic"``.
    rendering
        Settings as scenes have them, over those of the look: ``{"unitDistance": 0.01, "shadows": "exact"}``.
    look_options
        What is said of looks: ``look``, ``colormap``, ``color_by``, … as :func:`render` takes them.
    """

    def __init__(
        self,
        root: Object,
        *,
        camera: Camera | None = None,
        lights: Any = None,
        background: _arguments.Color | None = None,
        size: Any = (512, 512),
        samples: Samples | None = None,
        exposure: float | None = None,
        tone_mapping: str | None = None,
        rendering: Mapping[str, Any] | None = None,
        view: str | None = None,
        up: Any = None,
        **look_options: Any,
    ) -> None:
        if not isinstance(root, Object):
            raise TypeError(f"Scene: expected a cloud, a grid or an object made of them, and got {type(root).__name__}")
        if camera is not None and not isinstance(camera, Camera):
            raise TypeError(f"camera={camera!r}: expected a Camera, as Camera.fit(cloud) makes it")
        said = _compose.camera_options(view, None, up, None, False)
        made = _compose.compose(root, look_options, camera, _arguments.size(size), said)
        self._json = made.scene
        self._data = made.data
        self._folder = os.getcwd()
        #: What the camera was chosen for, unless somebody has said where it is.
        self._framed: tuple[Object, dict[str, Any], dict[str, Any]] | None = (root, look_options, said) if camera is None else None
        #: What was chosen for the look, and why.
        self.line = made.line
        self._override(None, lights, background, None, samples, exposure, tone_mapping, rendering)

    @classmethod
    def from_json(cls, scene: Mapping[str, Any] | str, folder: _arguments.PathLike | None = None) -> Scene:
        """The scene of a dictionary or a text. Paths in it are relative to `folder`, by default where the process is."""
        if isinstance(scene, str):
            try:
                scene = json.loads(scene)
            except json.JSONDecodeError as error:
                raise ValueError(f"this text is not JSON: {error}; Scene.load opens a file") from None
        if not isinstance(scene, Mapping):
            raise TypeError(f"Scene.from_json: expected a dictionary or its text, and got {type(scene).__name__}")
        made = cls.__new__(cls)
        made._json = copy.deepcopy(dict(scene))
        names = {str(node["file"]) for node in _nodes(made._json) if str(node.get("file", "")).startswith("memory:")}
        made._data = {name: held_in_memory(name) for name in names}
        made._framed = None
        made._folder = os.getcwd() if folder is None else _arguments.file(folder, "folder")
        made.line = ""
        return made

    @classmethod
    def load(cls, path: _arguments.PathLike) -> Scene:
        """Reads a scene file; one at an address names its clouds beside it."""
        where = _arguments.file(path, "path")
        if _arguments.is_address(where):
            return cls.from_json(_native.read_text(where), where.partition("?")[0].rpartition("/")[0])
        file = Path(where)
        try:
            text = file.read_text(encoding="utf-8")
        except OSError as error:
            # What was meant to be an address may grant access.
            raise type(error)(error.errno, error.strerror, _native.shown(where)) from None
        return cls.from_json(text, file.parent)

    def to_json(self) -> dict[str, Any]:
        """The dictionary."""
        return copy.deepcopy(self._json)

    def save(self, path: _arguments.PathLike) -> None:
        """Writes a scene file. Clouds in memory are written beside it, as ``NAME.1.rset`` and so on."""
        where = _arguments.path(path, "path")
        text = self._on_disk(where.parent, where.stem)
        where.write_text(text, encoding="utf-8")

    def _on_disk(self, folder: Path, stem: str) -> str:
        """The text of the scene, with what is in memory written to files in a folder."""
        names: dict[str, str] = {}
        for name, held in self._data.items():
            if held.in_memory:
                file = folder / f"{stem}.{len(names) + 1}.rset"
                held.save(file)
                names[name] = file.name
            else:
                names[name] = _arguments.absolute(name)
        scene = self.to_json()
        for node in _nodes(scene):
            if node.get("file") in names:
                node["file"] = names[node["file"]]
        return json.dumps(scene, indent=2)

    @property
    def camera(self) -> Camera | None:
        """The camera; ``None`` if it is the one that frames the scene."""
        node = self._json.get("camera", {})
        return Camera.from_json(node) if "position" in node else None

    def with_camera(self, camera: Camera) -> Scene:
        """The same scene, seen from elsewhere; what is compiled of it is used again."""
        other = copy.copy(self)
        other._json = {**self._json, "camera": camera.to_json()}
        other._framed = None
        return other

    def _first_of_turntable(self) -> tuple[Scene, _compose.About | None]:
        """The same scene, seen as by the first camera of a turntable, and what its cameras turn about; ``None`` if the camera is one that
        somebody has said, or frames the whole scene."""
        if self._framed is None:
            return self, None
        root, options, said = self._framed
        size = _arguments.size(self._json.get("image", {}).get("size", (512, 512)))
        found = _compose.first_of_turntable(root, options, size, said)
        if found is None:
            return self, None
        camera, about = found
        other = copy.copy(self)
        other._json = {**self._json, "camera": camera}
        return other, about

    def _override(
        self, size: Any, lights: Any, background: Any, camera: Camera | None, samples: Any, exposure: Any, tone_mapping: Any, rendering: Any
    ) -> None:
        image = dict(self._json.get("image", {}))
        if size is not None:
            image["size"] = list(_arguments.size(size))
        if samples is not None:
            image["samples"] = "auto" if samples == "auto" else _arguments.whole(samples, "samples", 1, 64)
        if exposure is not None:
            image["exposure"] = _arguments.number(exposure, "exposure", -32, 32)
        if tone_mapping is not None:
            image["toneMapping"] = _arguments.choice(tone_mapping, "tone_mapping", ("none", "filmic"))
        if image:
            self._json["image"] = image
        if lights is not None:
            self._json["lights"] = _compose.lights_json(lights)
        if isinstance(background, str) and background == "none":
            self._json.pop("background", None)
        elif background is not None:
            self._json["background"] = _arguments.color(background, "background")
        if camera is not None:
            self._json["camera"] = camera.to_json()
            self._framed = None
        if rendering is not None:
            self._json["rendering"] = {**self._json.get("rendering", {}), **rendering}

    def _changed(self, **changes: Any) -> Scene:
        """The same scene with other settings."""
        if all(value is None for value in changes.values()):
            return self
        other = copy.copy(self)
        other._json = copy.deepcopy(self._json)
        other._override(**changes)
        return other

    def _job(self, crop: Any, layers: bool) -> dict[str, Any]:
        """What the engine takes."""
        text = json.dumps(self._json)
        # What is compiled depends on all but the camera, and on the files as they are now.
        key = {name: value for name, value in self._json.items() if name not in ("camera", "animation")}
        files = [[str(file), *_stat(self._folder, str(file))] for file in sorted({str(n["file"]) for n in _nodes(key) if "file" in n})]
        data = self._data.values()
        return {
            "scene": text,
            "key": json.dumps([key, files, self._folder]),
            "folder": self._folder,
            "clouds": [held._file for held in data if isinstance(held, Cloud)],
            "grids": [held._file for held in data if isinstance(held, Grid)],
            "crop": None if crop is None else [_arguments.whole(v, "crop", 0, 1 << 20) for v in _four(crop)],
            "layers": bool(layers),
        }

    def view(self, *, memory: int | str | None = None, block: bool = False) -> Viewer:
        """Opens the scene in the viewer, in a tab of the browser. It goes on until :meth:`Viewer.close`, or until Python ends."""
        return Viewer(self, memory, block)

    def _repr_png_(self) -> bytes:
        from ._render import render

        return render(self)._repr_png_()

    def __repr__(self) -> str:
        width, height = self._json.get("image", {}).get("size", (512, 512))
        return f"<rayset.Scene {width} x {height}, {len(self._data)} in it that are open>"


def _four(crop: Any) -> list[Any]:
    found = list(crop) if not isinstance(crop, (str, int)) else []
    if len(found) != 4:
        raise TypeError(f"crop={crop!r}: expected left, top, width and height in pixels")
    return found


def _nodes(value: Any) -> Iterator[dict[str, Any]]:
    """All dictionaries in a scene."""
    if isinstance(value, dict):
        yield value
        for inner in value.values():
            yield from _nodes(inner)
    elif isinstance(value, list):
        for inner in value:
            yield from _nodes(inner)


def _stat(folder: str, name: str) -> list[int]:
    try:
        found = os.stat(_arguments.beside(folder, name))
    except OSError:
        return []
    return [found.st_size, found.st_mtime_ns, found.st_ino]


class Viewer:
    """The viewer of a scene: a process of the program. It ends with Python, or by :meth:`close`, or as a context."""

    def __init__(self, scene: Scene, memory: int | str | None, block: bool) -> None:
        from ._program import start

        self._folder = _native.TemporaryFolder()
        weakref.finalize(self, self._folder.close)
        file = Path(self._folder.path) / "scene.json"
        text = scene._on_disk(file.parent, "scene")
        where = json.loads(text)
        for node in _nodes(where):
            name = node.get("file")
            if isinstance(name, str) and not (file.parent / name).exists():
                node["file"] = _arguments.absolute(_arguments.beside(scene._folder, name))
        file.write_text(json.dumps(where), encoding="utf-8")
        budget = _arguments.memory_bytes(memory)
        options = [] if budget is None else ["--memory", str(budget)]
        #: The address that the browser opens, once.
        self.process, self.address = start(["view", str(file), *options])
        if block:
            self.process.wait()

    def close(self) -> None:
        """Ends the process, and removes what was written for it."""
        if self.process.poll() is None:
            self.process.terminate()
            self.process.wait()
        if self.process.stdout is not None:
            self.process.stdout.close()
        self._folder.close()

    def __enter__(self) -> Viewer:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _repr_html_(self) -> str:
        return f'<a href="{self.address}" target="_blank">Look around in it</a> (the address opens once)'
