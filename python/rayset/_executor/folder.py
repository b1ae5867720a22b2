"""The folder beside an output in which the parts of a build meet.

It is held by a lock on a file in it for as long as its process lives. One that nobody holds was left behind by a process that was killed, and
the next build of the same output removes it. Where file systems have no locks, nothing is removed but one's own.
"""

from __future__ import annotations

import contextlib
import glob
import os
import shutil
import time
import zlib
from pathlib import Path
from typing import IO

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

#: How long the removal of a folder is tried while others may still write into it.
_PATIENCE = 10.0
#: A folder without a lock is being made, unless it is older than this.
_YOUNG = 60.0


class WorkFolder:
    """A folder beside `output`, as a context: it is removed at the end, whatever happens."""

    def __init__(self, output: Path) -> None:
        prefix = f".{_short(output.name)}.rayset-parts-"
        _remove_leftovers(output.parent, prefix)
        number = 0
        while True:
            self.path = output.parent / f"{prefix}{os.getpid()}-{number}"
            try:
                self.path.mkdir()
                break
            except FileExistsError:
                number += 1
        self._lock = open(self.path / "lock", "wb")
        _take(self._lock)

    def __enter__(self) -> WorkFolder:
        return self

    def __exit__(self, *_: object) -> None:
        # Without its lock, those who would still begin something in it do not.
        with contextlib.suppress(OSError):
            os.remove(self.path / "lock")
        self._lock.close()
        _remove(self.path, _PATIENCE)


def _short(name: str) -> str:
    """The name of an output, short enough to be part of another: file systems allow 255 bytes."""
    encoded = name.encode()
    return name if len(encoded) <= 180 else f"{encoded[:160].decode(errors='ignore')}~{zlib.crc32(encoded):08x}"


def _take(file: IO[bytes]) -> bool:
    """Locks a file, if nobody else has it locked and the file system knows locks."""
    if fcntl is None:
        return False
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    return True


def _remove_leftovers(folder: Path, prefix: str) -> None:
    for found in folder.glob(f"{glob.escape(prefix)}*"):
        try:
            with open(found / "lock", "rb+") as lock:
                if _take(lock):
                    _remove(found, 0)
        except FileNotFoundError:
            with contextlib.suppress(OSError):
                if time.time() - found.stat().st_mtime > _YOUNG:
                    _remove(found, 0)
        except OSError:
            # Somebody else's.
            continue


def _remove(folder: Path, patience: float) -> None:
    """Removes a folder with all that is in it, again while others add to it."""
    end = time.monotonic() + patience
    while True:
        shutil.rmtree(folder, ignore_errors=True)
        if not folder.exists() or time.monotonic() >= end:
            return
        time.sleep(0.05)
