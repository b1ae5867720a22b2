"""The program `rayset`, which comes with the package."""

from __future__ import annotations

import atexit
import os
import shutil
import subprocess
import sys
import sysconfig
from collections.abc import Sequence
from pathlib import Path


def path() -> str:
    """The path of the program.

    Raises
    ------
    FileNotFoundError
        If it was not installed with the package.
    """
    name = "rayset.exe" if sys.platform == "win32" else "rayset"
    schemes = [None, f"{os.name}_user"]
    for scheme in schemes:
        folder = sysconfig.get_path("scripts", scheme) if scheme else sysconfig.get_path("scripts")
        if folder and (Path(folder) / name).is_file():
            return str(Path(folder) / name)
    found = os.environ.get("RAYSET_PROGRAM") or shutil.which(name)
    if found is None:
        raise FileNotFoundError("the program `rayset` was not installed with this package; pip install rayset installs both")
    return found


def run(arguments: Sequence[str]) -> int:
    """Runs the program to its end. Returns its exit status."""
    return subprocess.call([path(), *arguments])


def start(arguments: Sequence[str]) -> tuple[subprocess.Popen[str], str]:
    """Starts the viewer. Returns its process and the address that it prints first."""
    # Keys of the terminal are Python's, and so is Ctrl-C.
    process = subprocess.Popen(
        [path(), *arguments],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        start_new_session=True,
    )
    atexit.register(_end, process)
    address = process.stdout.readline().strip() if process.stdout else ""
    if not address:
        status = process.wait()
        raise RuntimeError(f"the viewer ended with status {status}; `{' '.join([path(), *arguments])}` says why")
    return process, address


def _end(process: subprocess.Popen[str]) -> None:
    if process.poll() is None:
        process.terminate()
