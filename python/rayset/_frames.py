"""Pictures of one scene from many places: turntables, animations, lists of cameras."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

from . import _arguments, _native, _session
from ._image import Image
from ._parts import Camera
from ._progress import Progress, Told
from ._render import _scene_of
from ._scene import Samples, Scene
from ._session import Session


def render_frames(
    target: Any,
    cameras: Iterable[Camera] | None = None,
    *,
    turntable: int | None = None,
    camera: Camera | None = None,
    size: Any = None,
    samples: Samples | None = None,
    crop: Any = None,
    layers: bool = True,
    view: str | None = None,
    up: Any = None,
    session: Session | None = None,
    memory: int | str | None = None,
    threads: int | None = None,
    progress: Progress = False,
    executor: Any = None,
    timeout: float = 60,
    **options: Any,
) -> Iterator[Image]:
    """Renders pictures of one scene, and yields them in order.

    The scene is compiled once. Each picture is what :func:`render` makes from that camera.

    Parameters
    ----------
    target
        As :func:`render` takes it.
    cameras
        From where. Without any, and without `turntable`, those of the animation of the scene, frame by frame.
    turntable
        How many pictures from all around: the camera turns about the middle of what is seen. Without a `camera`, all of them see all of it.
    executor
        A client of ``dask.distributed``. Its workers render several frames at a time; those that are done early wait here, and no more are begun
        than two for each thread of a worker and two more, ahead of the one that is waited for.
    progress
        Is told how many frames are done.
    crop, layers, view, up, session, memory, threads, timeout, options
        As :func:`render` takes them.

    What is left is stopped when the iterator is closed, or nobody has it any more.
    """
    if cameras is not None and turntable is not None:
        raise TypeError("say either cameras or turntable")
    if executor is not None and (session is not None or threads is not None):
        raise TypeError(f"{'session' if session is not None else 'threads'} is for this process; the workers of an executor have their own")
    if session is not None and (memory is not None or threads is not None):
        raise TypeError("memory and threads belong to the session: rs.Session(memory=..., threads=...)")
    keys = ("lights", "background", "exposure", "tone_mapping", "rendering")
    changes = {key: options.pop(key, None) for key in keys}
    scene = _scene_of(target, {**changes, "size": size, "samples": samples, "camera": camera}, view, up, options)
    job = scene._job(crop, layers)
    scenes = _seen_from(scene, crop, layers, cameras, turntable)
    budget, threads, patience = _arguments.memory_bytes(memory), _arguments.thread_count(threads), _arguments.seconds(timeout)
    if executor is None:
        engine = session if session is not None else _session.shared(budget, threads)
        return _here(engine, scenes, crop, layers, progress)
    from ._executor import pictures

    told = Told(progress)
    return _there(pictures.frames(executor, scenes, job["crop"], layers, budget, patience, told.told), scenes, told)


def _seen_from(scene: Scene, crop: Any, layers: bool, cameras: Iterable[Camera] | None, turntable: int | None) -> list[Scene]:
    if cameras is not None:
        found = list(cameras)
        for one in found:
            if not isinstance(one, Camera):
                raise TypeError(f"cameras: {one!r} where a Camera was expected")
        return [scene.with_camera(one) for one in found]
    turns = None if turntable is None else _arguments.whole(turntable, "turntable", 1, 1_000_000)
    first, about = (scene, None) if turns is None else scene._first_of_turntable()
    return [scene.with_camera(_camera(numbers)) for numbers in _native.cameras(first._job(crop, layers), turns, about)]


def _camera(numbers: dict[str, list[float]]) -> Camera:
    angle = {"fovy": numbers["fovy"][0]} if "fovy" in numbers else {}
    height = {"height": numbers["height"][0]} if "height" in numbers else {}
    return Camera(position=tuple(numbers["position"]), direction=tuple(numbers["direction"]), up=tuple(numbers["up"]), **angle, **height)


def _here(engine: Session, scenes: list[Scene], crop: Any, layers: bool, progress: Progress) -> Iterator[Image]:
    with Told(progress) as told:
        for number, scene in enumerate(scenes, start=1):
            picture = engine._native.render(scene._job(crop, layers), None)
            if told is not None:
                told("frames", number, len(scenes))
            yield Image(picture, scene)


def _there(pictures: Iterator[_native.Picture], scenes: list[Scene], progress: Told) -> Iterator[Image]:
    with progress:
        for scene, picture in zip(scenes, pictures):
            yield Image(picture, scene)
