"""Pictures of objects and scenes."""

from __future__ import annotations

import logging
import os
import warnings
from collections.abc import Iterator, Mapping
from typing import Any, Literal, overload

from . import _arguments, _session
from ._errors import RaysetWarning
from ._image import Image
from ._objects import Object
from ._parts import Camera
from ._progress import Progress, Told
from ._scene import Samples, Scene
from ._session import Session

_log = logging.getLogger("rayset")


@overload
def render(target: Any, *, progressive: Literal[True], **options: Any) -> Iterator[Image]: ...
@overload
def render(target: Any, *, progressive: Literal[False] = False, **options: Any) -> Image: ...


def render(
    target: Any,
    *,
    camera: Camera | None = None,
    size: Any = None,
    samples: Samples | None = None,
    lights: Any = None,
    background: _arguments.Color | None = None,
    exposure: float | None = None,
    tone_mapping: str | None = None,
    rendering: Mapping[str, Any] | None = None,
    crop: Any = None,
    layers: bool = True,
    view: str | None = None,
    up: Any = None,
    session: Session | None = None,
    memory: int | str | None = None,
    threads: int | None = None,
    progress: Progress = False,
    progressive: bool = False,
    executor: Any = None,
    timeout: float = 60,
    **look_options: Any,
) -> Any:
    """Renders a picture.

    Parameters
    ----------
    target
        A cloud, a grid, an object made of them, a :class:`Scene`, or a file of any kind.
    camera
        From where; by default the camera that frames it (`view` and `up` say otherwise), or the scene's.
    size
        Width and height; 512 by 512, or the scene's.
    samples
        Rays along each side of a pixel, or ``"auto"``: one, and two along each side where the picture is not smooth; what the look says (2,
        ``"auto"`` of gas), or the scene.
    lights, background, exposure, tone_mapping, rendering
        As :class:`Scene` has them, in place of those of the look or the scene.
    crop
        Left, top, width and height of a part: bit for bit the same pixels as in the whole.
    layers
        Whether the picture has depth, normals and the other layers.
    session, memory, threads
        A :class:`Session`; or the budget and the number of threads of the common one. None of these changes a pixel.
    progress
        ``True`` for a bar, or a callable of what is being done, how much of it is done, and how much there is.
    progressive
        Returns an iterator instead: pictures of the whole size, coarse first, the last of which is the picture. With `executor`, shares of
        the picture take the place of squares as they come.
    executor
        A client of ``dask.distributed``: its workers render the picture, the very same, from files that all of them see. `memory` is then
        for each worker; half of what it may use, by default. See ``docs/python.md``, "Many machines".
    timeout
        Seconds for which the scheduler, or all workers, may be gone before there is an :class:`ExecutorError`.
    look_options
        For clouds and grids without a transfer function: ``look`` (``"surface"``, ``"classes"``, ``"height"``, ``"intensity"``, ``"gas"``,
        ``"splats"``, ``"density"``, ``"volume"``), ``color_by``, ``colormap``, ``value_range``, ``log``, ``opacity``, ``color``, ``kernel``,
        ``radius_scale``, and the other options of the program by their names.

    Ctrl-C ends it within a few hundredths of a second.
    """
    if session is not None and not isinstance(session, Session):
        raise TypeError(f"session={session!r}: expected a Session")
    if session is not None and (memory is not None or threads is not None):
        raise TypeError("memory and threads belong to the session: rs.Session(memory=..., threads=...)")
    if camera is not None and not isinstance(camera, Camera):
        raise TypeError(f"camera={camera!r}: expected a Camera, as Camera.fit(cloud) makes it")
    if executor is not None and (session is not None or threads is not None):
        name = "session" if session is not None else "threads"
        raise TypeError(f"{name} is for this process; the workers of an executor have their own threads and sessions")
    changes = {
        "size": size,
        "lights": lights,
        "background": background,
        "camera": camera,
        "samples": samples,
        "exposure": exposure,
        "tone_mapping": tone_mapping,
        "rendering": rendering,
    }
    scene = _scene_of(target, changes, view, up, look_options)
    if executor is not None:
        from ._executor import pictures

        job = scene._job(crop, layers)
        budget, wait = _arguments.memory_bytes(memory), _arguments.seconds(timeout)
        if progressive:
            return _Passes(pictures.passes(executor, scene, job["crop"], layers, budget, wait), scene)
        with Told(progress) as told:
            return Image(pictures.render(executor, scene, job["crop"], layers, budget, wait, told), scene)
    engine = session if session is not None else _session.shared(_arguments.memory_bytes(memory), _arguments.thread_count(threads))
    job = scene._job(crop, layers)
    if progressive:
        return _Passes(engine._native.begin(job), scene)
    with Told(progress) as told:
        picture = engine._native.render(job, told)
    for remark in engine._native.remarks():
        warnings.warn(remark, RaysetWarning, stacklevel=2)
    return Image(picture, scene)


def _scene_of(target: Any, changes: dict[str, Any], view: Any, up: Any, look_options: dict[str, Any]) -> Scene:
    if isinstance(target, (str, os.PathLike)):
        from ._open import open as opened

        target = opened(target)
    if isinstance(target, Scene):
        if look_options or view is not None or up is not None:
            name = next(iter(look_options), "view" if view is not None else "up")
            raise TypeError(f"{name!r} is for clouds and grids; a scene says itself what its objects look like")
        return target._changed(**changes)
    if not isinstance(target, Object):
        raise TypeError(f"render: expected a cloud, a grid, an object, a scene or a file, and got {type(target).__name__}")
    if changes["size"] is None:
        changes["size"] = (512, 512)
    scene = Scene(target, view=view, up=up, **changes, **look_options)
    if scene.line:
        _log.info("%s", scene.line)
    return scene


class _Passes:
    """Pictures, coarse first. What is left is stopped when it is closed, or nobody has it any more."""

    def __init__(self, pictures: Any, scene: Scene) -> None:
        self._pictures = pictures
        self._scene = scene

    def __iter__(self) -> _Passes:
        return self

    def __next__(self) -> Image:
        return Image(next(self._pictures), self._scene)

    def close(self) -> None:
        """Stops what is left."""
        self._pictures.close()

    def __enter__(self) -> _Passes:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
