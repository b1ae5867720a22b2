"""Progress, as people want to be told of it."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any, TypeAlias, Union

Progress: TypeAlias = Union[bool, None, Callable[[str, int, int], Any]]
"""``True`` for a bar, or a callable that is told what is being done, how much of it is done, and how much there is."""


class _Bar:
    """A bar of tqdm, or a line now and then where there is no tqdm."""

    def __init__(self) -> None:
        self.doing = ""
        self.bar: Any = None
        try:
            from tqdm.auto import tqdm

            self.tqdm: Any = tqdm
        except ImportError:
            self.tqdm = None

    def __call__(self, doing: str, done: int, total: int) -> None:
        total = max(total, done)
        if self.tqdm is None:
            part = f"{100 * done // total:3d} %" if total else ""
            end = "\r" if sys.stderr.isatty() else "\n"
            print(f"{doing} {part}", end=end, file=sys.stderr, flush=True)
            return
        if doing != self.doing:
            self.close()
            self.doing = doing
            self.bar = self.tqdm(total=total, desc=doing, unit_scale=True)
        self.bar.total = total
        self.bar.update(done - self.bar.n)

    def close(self) -> None:
        if self.bar is not None:
            self.bar.close()
            self.bar = None


class Told:
    """A context in which progress is told; its value is what the engine calls, or ``None``."""

    def __init__(self, progress: Progress) -> None:
        if progress is not None and not isinstance(progress, bool) and not callable(progress):
            raise TypeError(f"progress={progress!r}: expected True, or a callable of what is done, how much, and of how much")
        self.bar = _Bar() if progress is True else None
        self.told: Callable[[str, int, int], Any] | None = progress if callable(progress) else self.bar

    def __enter__(self) -> Callable[[str, int, int], Any] | None:
        return self.told

    def __exit__(self, *_: object) -> None:
        if self.bar is not None:
            self.bar.close()
