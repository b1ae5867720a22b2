#!/usr/bin/env python3
"""Executes the notebooks of this folder, each in an empty folder of its own: `run.py [--write] [NAME …]`.

With `--write` the outputs are kept in the notebooks; otherwise they are only checked to run. Needs nbclient, ipykernel, matplotlib,
laspy[lazrs], and the package `rayset`.
"""

import argparse
import os
import sys
import tempfile
import time
from pathlib import Path

os.environ["MPLBACKEND"] = "module://matplotlib_inline.backend_inline"  # whatever the shell says
import nbformat
from nbclient import NotebookClient
from nbclient.exceptions import CellExecutionError

HERE = Path(__file__).resolve().parent
LIMIT = 1_500_000
"""Bytes of a notebook with its outputs."""


def execute(path: Path) -> nbformat.NotebookNode:
    notebook = nbformat.read(path, as_version=4)
    with tempfile.TemporaryDirectory(prefix="rayset-notebook-") as folder:
        client = NotebookClient(notebook, timeout=900, kernel_name="python3", resources={"metadata": {"path": folder}}, record_timing=False)
        client.execute()
    for cell in notebook.cells:
        cell.metadata.pop("execution", None)
    # What differs from one machine to the next is no part of what is kept.
    notebook.metadata = {
        "kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"},
        "language_info": {"name": "python"},
    }
    return notebook


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", help="notebooks; all of them by default")
    parser.add_argument("--write", action="store_true", help="keep the outputs in the notebooks")
    said = parser.parse_args()
    failed = False
    for path in [HERE / name for name in said.names] or sorted(HERE.glob("*.ipynb")):
        begun = time.monotonic()
        try:
            notebook = execute(path)
        except CellExecutionError as error:
            print(f"{path.name}: {error}", file=sys.stderr)
            failed = True
            continue
        size = len(nbformat.writes(notebook))
        print(f"{path.name}: {time.monotonic() - begun:.0f} s, {size / 1e6:.2f} MB", flush=True)
        if size > LIMIT:
            print(f"{path.name}: larger than {LIMIT / 1e6:.1f} MB; make its pictures smaller", file=sys.stderr)
            failed = True
        elif said.write:
            nbformat.write(notebook, path)
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
