"""Sessions: pages, threads and tables that renders share."""

from __future__ import annotations

import os
import threading
from typing import Any

from . import _arguments, _native


class Session:
    """What renders share: pages of clouds and grids within a budget, threads, compiled scenes, tables of shadows.

    :func:`render` has one of its own. Another is for another budget or number of threads::

        with rs.Session(memory="2GiB", threads=8) as s:
            img = s.render(cloud)

    `memory` bounds what the session allocates, 1 GiB by default; pictures, arrays and clouds in memory are not counted. Sessions
    may be used from several threads at once. They do not survive a fork, and cannot be pickled.
    """

    def __init__(self, *, memory: int | str | None = None, threads: int | None = None, _simd: str | None = None) -> None:
        self._native = _native.Session(_arguments.memory_bytes(memory), _arguments.thread_count(threads), _simd)

    def render(self, target: Any, **options: Any) -> Any:
        """As :func:`render`, in this session."""
        from ._render import render

        return render(target, session=self, **options)

    def statistics(self, reset: bool = False) -> dict[str, Any]:
        """What the working set did: bytes read, hits, misses, evictions, for each kind of page."""
        return self._native.statistics(reset)

    def close(self) -> None:
        """Gives back memory and threads, when what is being rendered has ended."""
        self._native.close()

    @property
    def closed(self) -> bool:
        """Whether it was closed."""
        return bool(self._native.closed)

    def __enter__(self) -> Session:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __reduce__(self) -> Any:
        raise TypeError("a session cannot be pickled; make one in each process")

    def __repr__(self) -> str:
        return f"<rayset.Session{' closed' if self.closed else ''}>"


_lock = threading.Lock()
_shared: tuple[tuple[Any, ...], Session] | None = None


def shared(memory: int | None, threads: int | None) -> Session:
    """The session of :func:`render`: made when it is first needed, when other resources are asked for, and after a fork."""
    global _shared
    key = (memory, threads, os.getpid())
    with _lock:
        if _shared is None or (_shared[0] != key and (memory is not None or threads is not None or _shared[0][2] != key[2])):
            _shared = (key, Session(memory=memory, threads=threads))
        return _shared[1]


def _renew() -> None:
    """A lock that another thread held at the fork would stay locked."""
    global _lock
    _lock = threading.Lock()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_renew)
