"""Pictures whose shares are rendered by workers, and frames.

Shares are dealt out so that all cost about the same (`Share` in the library), so what a share is expected to cost is its part of the rays.
There are several shares for each thread, more of large pictures, and a worker takes another when it is done: none waits long for the last.
"""

from __future__ import annotations

import json
import os
import warnings
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from .. import _native
from .._errors import RaysetWarning
from .._scene import Scene, _nodes
from . import worker
from .pool import Pool
from .tasks import Tasks

#: Rays of a share, about.
_RAYS = 1 << 19
#: Least and most shares for each thread.
_LEAST, _MOST = 4, 32

Told = Callable[[str, int, int], Any]


def render(executor: Any, scene: Scene, crop: Any, layers: bool, memory: int | None, timeout: float, told: Told | None) -> _native.Picture:
    """The picture of a scene, by the workers of a client."""
    picture = _picture(scene, crop, layers)
    pool = Pool(executor, timeout, looking(picture))
    rays, pixels = _rays(scene, crop)
    of = min(_MOST * pool.threads, max(_LEAST * pool.threads, -(-rays // _RAYS)))
    with Tasks(pool, memory) as tasks:
        _submit(tasks, 0, picture, of)
        parts: list[tuple[str, bytes]] = []
        while len(tasks):
            _, outcome = tasks.next()
            _remark(outcome.remarks, set())
            parts.append((f"the part of worker {outcome.worker}", outcome.value))
            if told is not None:
                told("tracing", pixels * len(parts) // of, pixels)
    return _native.join_parts(parts)


def frames(
    executor: Any, scenes: Sequence[Scene], crop: Any, layers: bool, memory: int | None, timeout: float, told: Told | None
) -> Iterator[_native.Picture]:
    """The pictures of some scenes, in order. Those that finish early wait here, compressed, and no more are begun than a few for each thread.

    Frames are whole tasks; the last of them are divided into shares, so that no worker is idle while another has one before it.
    """
    pictures = [_picture(scene, crop, layers) for scene in scenes]
    pool = Pool(executor, timeout, looking(pictures[0]))
    return _frames(pool, pictures, memory, told)


def _frames(pool: Pool, pictures: list[worker.Picture], memory: int | None, told: Told | None) -> Iterator[_native.Picture]:
    count, ahead = len(pictures), 2 * pool.threads + 2
    shares = [max(1, -(-2 * pool.threads // (count - k))) if count - k <= pool.threads else 1 for k in range(count)]
    waiting: dict[int, list[tuple[str, bytes]]] = {}
    begun, said = 0, set[str]()
    with Tasks(pool, memory) as tasks:
        for frame in range(count):
            while len(waiting.get(frame, [])) < shares[frame]:
                while begun < min(count, frame + ahead):
                    _submit(tasks, begun, pictures[begun], shares[begun])
                    begun += 1
                number, outcome = tasks.next()
                _remark(outcome.remarks, said)
                waiting.setdefault(number, []).append((f"the part of worker {outcome.worker}", outcome.value))
            if told is not None:
                told("frames", frame + 1, count)
            yield _native.join_parts(waiting.pop(frame))


def _submit(tasks: Tasks, frame: int, picture: worker.Picture, of: int) -> None:
    for number in range(1, of + 1):
        tasks.submit(frame, f"part {number} of {of} of picture {frame}", worker.render_share, picture, (number, of), priority=-frame)


def _picture(scene: Scene, crop: Any, layers: bool) -> worker.Picture:
    """A scene as workers see it: what it names relative to this process has its whole path."""
    absolute: dict[str, str] = {}
    for name, held in scene._data.items():
        if held.in_memory:
            raise ValueError(
                f"executor: {held!r} is in the memory of this process, where workers do not see it; build it to a file that all of them see, "
                "rs.build(..., path=...), or save() it there and open that"
            )
        absolute[name] = os.path.abspath(name)
    described = scene.to_json()
    for node in _nodes(described):
        if node.get("file") in absolute:
            node["file"] = absolute[node["file"]]
    return worker.Picture(json.dumps(described), str(Path(scene._folder).absolute()), crop, layers)


def looking(picture: worker.Picture) -> Callable[[], Sequence[str]]:
    """What opens the files of a scene on a worker, and returns their names."""

    def look() -> Sequence[str]:
        scene = Scene.from_json(picture.scene, picture.folder)
        _native.cameras(scene._job(None, False), 1)
        return sorted({str(Path(picture.folder) / node["file"]) for node in _nodes(scene.to_json()) if isinstance(node.get("file"), str)})

    return look


def _rays(scene: Scene, crop: Any) -> tuple[int, int]:
    """Rays and pixels of a picture."""
    image = scene.to_json().get("image", {})
    width, height = image.get("size", (512, 512)) if crop is None else crop[2:]
    return width * height * int(image.get("samples", 2)) ** 2, width * height


def _remark(remarks: Sequence[str], said: set[str]) -> None:
    for remark in remarks:
        if remark not in said:
            said.add(remark)
            warnings.warn(remark, RaysetWarning, stacklevel=5)
