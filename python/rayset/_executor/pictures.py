"""Pictures whose shares are rendered by workers, and frames.

A picture is cut into more shares than there are threads, each with squares from all over it (`Share` in the library), and a worker takes
another when it is done. Those that are expected to take longest come first, as a coarse picture of their samples tells it, so that none is
waited for at the end (docs/benchmarks.md). How they are cut and in which order they are begun changes no byte.
"""

from __future__ import annotations

import json
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from .. import _arguments, _native
from .._errors import RaysetWarning
from .._scene import Scene, _nodes
from . import worker
from .pool import Pool
from .tasks import Tasks

#: Rays of a share, about.
_RAYS = 1 << 19
#: Least and most shares for each thread.
_LEAST, _MOST = 4, 32
#: Edges of the squares of a coarse picture that is shown, and of one that only tells what shares cost; it comes before all others.
_COARSE, _PROBE, _FIRST = 8, 16, 1e9
#: Shares for each thread that are begun before it is known what they cost.
_AT_ONCE = 2
#: Pictures that are handed on before the last, about, and the least seconds between them.
_PASSES, _PAUSE = 16, 0.5

Told = Callable[[str, int, int], Any]


def render(executor: Any, scene: Scene, crop: Any, layers: bool, memory: int | None, timeout: float, told: Told | None) -> _native.Picture:
    """The picture of a scene, by the workers of a client."""
    plan = _plan(executor, scene, crop, layers, timeout)
    pixels, most, parts = plan.crop[2] * plan.crop[3], 0, list[_Part]()
    with Tasks(plan.pool, memory, told is not None) as tasks:

        def tell() -> None:
            # What a worker that died had done is done again.
            nonlocal most
            done = int(pixels * (len(parts) + tasks.partly()) / plan.of)
            if told is not None and done > most:
                most = done
                told("tracing", done, pixels)

        for coarse, part in _shares(tasks, plan, _PROBE if plan.is_probed else None, tell):
            if not coarse:
                parts.append(part)
                tell()
    return _native.join_parts(parts)


def passes(executor: Any, scene: Scene, crop: Any, layers: bool, memory: int | None, timeout: float) -> Iterator[_native.Picture]:
    """Pictures of the whole size: a coarse one, then those in which ever more shares have come, at last the picture."""
    return _passes(_plan(executor, scene, crop, layers, timeout), memory)


def _passes(plan: _Plan, memory: int | None) -> Iterator[_native.Picture]:
    parts = list[_Part]()
    below: _native.Picture | None = None
    with Tasks(plan.pool, memory) as tasks:
        shown, when = 0, time.monotonic()
        for coarse, part in _shares(tasks, plan, _COARSE, None):
            if coarse:
                below = _native.join_coarse([part], plan.crop, plan.whole)
            else:
                parts.append(part)
            is_due = len(parts) >= shown + plan.of / _PASSES and time.monotonic() >= when + _PAUSE
            if below is not None and len(parts) < plan.of and (coarse or is_due):
                yield below if not parts else _native.join_parts(parts, below)
                shown, when = len(parts), time.monotonic()
    yield _native.join_parts(parts)


_Part = tuple[str, bytes]


@dataclass(frozen=True)
class _Plan:
    """A picture, who renders it, and how it is cut."""

    picture: worker.Picture
    pool: Pool
    #: How many shares.
    of: int
    #: Left, top, width and height of what is rendered, and the size of the whole.
    crop: list[int]
    whole: tuple[int, int]
    samples: int

    @property
    def is_probed(self) -> bool:
        """Whether a coarse picture, for the order of the shares alone, is worth its rays: one for as many as a square has."""
        return self.samples >= 2 and self.picture.layers and self.of > _AT_ONCE * self.pool.threads


def _plan(executor: Any, scene: Scene, crop: Any, layers: bool, timeout: float) -> _Plan:
    picture = _picture(scene, crop, layers)
    pool = Pool(executor, timeout, looking(picture), _pins([scene]))
    image = scene.to_json().get("image", {})
    (width, height), samples = image.get("size", (512, 512)), image.get("samples", 1)
    samples = 2 if samples == "auto" else int(samples)
    area = [0, 0, int(width), int(height)] if crop is None else list(crop)
    of = min(_MOST * pool.threads, max(_LEAST * pool.threads, -(-area[2] * area[3] * samples**2 // _RAYS)))
    return _Plan(picture, pool, of, area, (int(width), int(height)), samples)


def _shares(tasks: Tasks, plan: _Plan, edge: int | None, waiting: Callable[[], None] | None) -> Iterator[tuple[bool, _Part]]:
    """All shares as they come, and the coarse picture of squares with this `edge`, if there is to be one, marked.

    What is begun before the coarse picture is there is begun as it is numbered, and then what it tells to take longest first.
    """
    said, numbers = set[str](), list(range(1, plan.of + 1))
    at_once = plan.of if edge is None else min(plan.of, _AT_ONCE * plan.pool.threads)
    if edge is not None:
        tasks.submit(True, "the coarse picture", worker.render_share, plan.picture, (1, 1), edge, priority=_FIRST)
    _submit(tasks, False, plan.picture, numbers[:at_once], plan.of)
    while len(tasks):
        coarse, outcome = tasks.next(waiting)
        _remark(outcome.remarks, said)
        part = _part(outcome)
        if coarse and edge is not None:
            costs = _costs(part, plan, edge)
            _submit(tasks, False, plan.picture, sorted(numbers[at_once:], key=lambda number: -costs[number - 1]), plan.of)
        yield coarse, part


def _costs(coarse: _Part, plan: _Plan, edge: int) -> list[float]:
    """What shares are expected to cost: about as much as they have samples that are not transparent, and something for each pixel."""
    samples = _native.join_parts([coarse]).layer("samples")
    if samples is None:
        return [0.0] * plan.of
    return _native.share_costs((1.0 + samples).ravel().tolist(), plan.crop, edge, plan.of)


def frames(
    executor: Any, scenes: Sequence[Scene], crop: Any, layers: bool, memory: int | None, timeout: float, told: Told | None
) -> Iterator[_native.Picture]:
    """The pictures of some scenes, in order. Those that finish early wait here, compressed, and no more are begun than a few for each thread.

    Frames are whole tasks; the last of them are divided into shares, so that no worker is idle while another has one before it.
    """
    pictures = [_picture(scene, crop, layers) for scene in scenes]
    pool = Pool(executor, timeout, looking(pictures[0]), _pins(scenes[:1]))
    return _frames(pool, pictures, memory, told)


def _frames(pool: Pool, pictures: list[worker.Picture], memory: int | None, told: Told | None) -> Iterator[_native.Picture]:
    count, ahead = len(pictures), 2 * pool.threads + 2
    shares = [max(1, -(-2 * pool.threads // (count - k))) if count - k <= pool.threads else 1 for k in range(count)]
    waiting: dict[int, list[_Part]] = {}
    begun, said = 0, set[str]()
    with Tasks(pool, memory) as tasks:
        for frame in range(count):
            while len(waiting.get(frame, [])) < shares[frame]:
                while begun < min(count, frame + ahead):
                    _submit(tasks, begun, pictures[begun], range(1, shares[begun] + 1), shares[begun], begun)
                    begun += 1
                number, outcome = tasks.next()
                _remark(outcome.remarks, said)
                waiting.setdefault(number, []).append(_part(outcome))
            if told is not None:
                told("frames", frame + 1, count)
            yield _native.join_parts(waiting.pop(frame))


def _submit(tasks: Tasks, label: Any, picture: worker.Picture, numbers: Sequence[int], of: int, frame: int = 0) -> None:
    for number in numbers:
        tasks.submit(label, f"part {number} of {of} of picture {frame}", worker.render_share, picture, (number, of), priority=-frame)


def _part(outcome: worker.Outcome) -> _Part:
    """A part with its name for messages."""
    return f"the part of worker {outcome.worker}", outcome.value


def _picture(scene: Scene, crop: Any, layers: bool) -> worker.Picture:
    """A scene as workers see it: what it names relative to this process has its whole path."""
    absolute: dict[str, str] = {}
    for name, held in scene._data.items():
        if held.in_memory:
            raise ValueError(
                f"executor: {held!r} is in the memory of this process, where workers do not see it; build it to a file that all of them see, "
                "rs.build(..., path=...), or save() it there and open that"
            )
        absolute[name] = _arguments.absolute(name)
    described = scene.to_json()
    for node in _nodes(described):
        if node.get("file") in absolute:
            node["file"] = absolute[node["file"]]
    return worker.Picture(json.dumps(described), _arguments.absolute(scene._folder), crop, layers)


def _pins(scenes: Sequence[Scene]) -> dict[str, str | None]:
    """What is open here of objects that are remote."""
    return {name: held._file.version for scene in scenes for name, held in scene._data.items()}


def looking(picture: worker.Picture) -> Callable[[], Sequence[str]]:
    """What opens the files of a scene on a worker, and returns their names."""

    def look() -> Sequence[str]:
        scene = Scene.from_json(picture.scene, picture.folder)
        _native.cameras(scene._job(None, False), 1, None)
        return sorted({_arguments.beside(picture.folder, node["file"]) for node in _nodes(scene.to_json()) if isinstance(node.get("file"), str)})

    return look


def _remark(remarks: Sequence[str], said: set[str]) -> None:
    for remark in remarks:
        if remark not in said:
            said.add(remark)
            warnings.warn(remark, RaysetWarning, stacklevel=5)
