#!/usr/bin/env python3
"""Measures what two workers of one thread gain over one, on one machine. Run it with the Python that has rayset and distributed.

    many_machines.py frames SCENE.json [--frames 24] [--size 512] [--pairs 3]    a turntable of a scene
    many_machines.py build FOLDER [--points 1e8] [--pairs 3]                     a cloud of random points, spacing measured

Wall-clock seconds from the call to its end, clusters started before; medians of pairs of runs, of which every other begins with two workers.
The load is that of the machine when a run begins.
"""

from __future__ import annotations

import argparse
import os
import statistics
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from distributed import Client, LocalCluster

import rayset as rs

#: Points that are made at a time.
CHUNK = 1 << 22


def timed(workers: int, work: Callable[[Any], Any]) -> float:
    """Seconds of some work with so many workers, which have done nothing before."""
    load = os.getloadavg()[0]
    with LocalCluster(n_workers=workers, threads_per_worker=1, processes=True, dashboard_address=":0") as cluster, Client(cluster) as client:
        begun = time.monotonic()
        work(client)
        seconds = time.monotonic() - begun
    print(f"  {workers} of one thread: {seconds:.1f} s, load {load:.1f} at the beginning", flush=True)
    return seconds


def compare(work: Callable[[Any], Any], pairs: int) -> None:
    """Two workers beside one."""
    one, two = [], []
    for pair in range(pairs):
        for workers in (1, 2) if pair % 2 == 0 else (2, 1):
            (one if workers == 1 else two).append(timed(workers, work))
    ratios = sorted(b / a for a, b in zip(one, two))
    print(f"median of {pairs}: {statistics.median(one):.1f} s and {statistics.median(two):.1f} s; ratios {', '.join(f'{r:.3f}' for r in ratios)}")


def frames(scene: Path, count: int, size: int, pairs: int) -> None:
    """A turntable."""
    opened = rs.Scene.load(scene)
    compare(lambda client: sum(1 for _ in rs.render_frames(opened, turntable=count, size=size, layers=False, executor=client)), pairs)


def build(folder: Path, count: int, pairs: int) -> None:
    """A cloud of points that are dense in the middle."""
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / "points.npy"
    if not file.exists() or np.load(file, mmap_mode="r").shape != (count, 3):
        made = np.lib.format.open_memmap(file, mode="w+", dtype="f4", shape=(count, 3))
        for at in range(0, count, CHUNK):
            made[at : at + CHUNK] = np.random.default_rng(at).normal(size=(min(CHUNK, count - at), 3))
        made.flush()
    said = {"columns": ["x", "y", "z"], "memory": "1GiB"}
    compare(lambda client: rs.build(file, path=folder / "cloud.rset", executor=client, **said), pairs)
    begun = time.monotonic()
    rs.build(file, path=folder / "alone.rset", threads=1, **said)
    print(f"without an executor, one thread: {time.monotonic() - begun:.1f} s")
    same = (folder / "cloud.rset").read_bytes() == (folder / "alone.rset").read_bytes()
    print(f"the same bytes: {same}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=["frames", "build"])
    parser.add_argument("where", type=Path)
    parser.add_argument("--frames", type=int, default=24)
    parser.add_argument("--size", type=int, default=512)
    parser.add_argument("--points", type=float, default=1e8)
    parser.add_argument("--pairs", type=int, default=3)
    given = parser.parse_args()
    if given.what == "frames":
        frames(given.where, given.frames, given.size, given.pairs)
    else:
        build(given.where, int(given.points), given.pairs)


if __name__ == "__main__":
    main()
