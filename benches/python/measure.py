#!/usr/bin/env python3
"""Measures the Python package beside the program. Run it with the Python that has rayset installed; Linux alone.

    measure.py arrays FOLDER [--points 1e7] [--runs 9]    NumPy to a picture, beside the program from a file of the same array
    measure.py iterator FOLDER [--points 3e8]             an iterator of chunks, built in 256 MiB
    measure.py interrupts [--runs 60]                     how late Ctrl-C is
    measure.py threads [--runs 9]                         four threads that render at once, beside one after another
    measure.py figures FOLDER                             bytes of the package's pictures of scene files beside the program's

`arrays`: CPU seconds, user and system, of whole processes but for starting Python and importing (measured by themselves and taken
away); medians of alternating runs.
"""

from __future__ import annotations

import argparse
import os
import resource
import signal
import statistics
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np

import rayset as rs
from rayset import _program

SIZE = 512


def cpu_and_peak(command: list[str], folder: Path) -> tuple[float, float]:
    """CPU seconds of a process and its children, and its peak memory in MiB."""
    measured = folder / "measured"
    subprocess.run(["/usr/bin/time", "-f", "%U %S %M", "-o", str(measured), *command], check=True, cwd=folder, capture_output=True)
    user, system, kib = measured.read_text().split("\n")[-2].split()
    return float(user) + float(system), int(kib) / 1024


def arrays(folder: Path, count: int, runs: int) -> None:
    """The same points, from an array in memory by the package and from a file of it by the program."""
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / "points.npy"
    z, phi = np.random.default_rng(42).random((2, count))
    z = 2 * z - 1
    flat = np.sqrt(1 - z * z)
    points = np.column_stack([flat * np.cos(2 * np.pi * phi), flat * np.sin(2 * np.pi * phi), z]).astype("f4")
    np.save(file, points)
    radius = float(np.sqrt(160 / count))
    array_mib = points.nbytes / 2**20
    del points
    begin = "import numpy as np, rayset as rs\np = np.load('points.npy')\n"
    code = begin + f"c = rs.build(p, radius={radius}, path='a.rset', memory='256MiB')\nrs.render(c, size={SIZE}, layers=False, memory='256MiB').save('a.png')\n"
    in_memory = begin + f"c = rs.build(p, radius={radius}, memory='256MiB')\nrs.render(c, size={SIZE}, layers=False, memory='256MiB').save('a.png')\n"
    program = _program.path()
    build = [program, "build", "points.npy", "-o", "b.rset", "--radius", str(radius), "--memory", "256MiB"]
    render = [program, "render", "b.rset", "-o", "b.png", "--size", f"{SIZE}x{SIZE}", "--memory", "256MiB"]
    ours, theirs, memory, starts = [], [], [], []
    peaks: list[float] = []
    for _ in range(runs):
        starts.append(cpu_and_peak([sys.executable, "-c", begin], folder)[0])
        seconds, peak = cpu_and_peak([sys.executable, "-c", code], folder)
        ours.append(seconds)
        peaks.append(peak)
        memory.append(cpu_and_peak([sys.executable, "-c", in_memory], folder)[0])
        theirs.append(cpu_and_peak(build, folder)[0] + cpu_and_peak(render, folder)[0])
    start = statistics.median(starts)
    package, whole = statistics.median(ours) - start, statistics.median(theirs)
    same = (folder / "a.png").read_bytes() == (folder / "b.png").read_bytes()
    print(f"{count:,} points, {runs} alternating runs, medians of CPU seconds")
    print(f"package, to a file {package:.2f}; in memory {statistics.median(memory) - start:.2f}; program {whole:.2f}; ratio {package / whole:.3f}")
    print(f"same bytes: {same}; Python, NumPy and loading the array alone {start:.2f} s")
    allowed = array_mib + 256 + 64
    print(f"peak of the package {max(peaks):.0f} MiB; array {array_mib:.0f} + budget 256 + 64 = {allowed:.0f} MiB: {'met' if max(peaks) <= allowed else 'MISSED'}")


def iterator(folder: Path, count: int) -> None:
    """Chunks that are made as they are asked for."""
    folder.mkdir(parents=True, exist_ok=True)
    chunk = 1_000_000

    def chunks():
        random = np.random.default_rng(1)
        for _ in range(0, count, chunk):
            yield random.random((chunk, 3), dtype="f4")

    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    started, cpu = time.perf_counter(), time.process_time()
    cloud = rs.build(chunks(), radius=0.002, memory="256MiB", path=folder / "many.rset")
    seconds, cpu = time.perf_counter() - started, time.process_time() - cpu
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"{len(cloud):,} points in {seconds:.0f} s ({cpu:.0f} CPU s), file {cloud.file_bytes / 1e9:.1f} GB; peak {peak:.0f} MiB, {before:.0f} before the build")
    started = time.perf_counter()
    rs.render(cloud, size=SIZE, look="gas", memory="256MiB").save(folder / "many.png")
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"its picture in {time.perf_counter() - started:.1f} s; peak {peak:.0f} MiB")
    (folder / "many.rset").unlink()


def interrupts(runs: int) -> None:
    """Milliseconds from the signal to the exception."""
    points = np.random.default_rng(1).random((3_000_000, 3))
    small = rs.build(points[:20_000])
    actions = {
        "build": lambda: rs.build(points, radius=0.01),
        "build, auto": lambda: rs.build(points),
        "build to a file": lambda: rs.build(points, radius=0.01, path="/tmp/rayset-measured.rset", memory="48MiB"),
        "render": lambda: rs.render(small, size=3000, samples=8),
    }
    for name, action in actions.items():
        late = []
        for run in range(runs):
            sent: list[float] = []

            def send(after: float = 0.05 + 0.4 * run / runs) -> None:
                time.sleep(after)
                sent.append(time.perf_counter())
                os.kill(os.getpid(), signal.SIGINT)

            thread = threading.Thread(target=send)
            thread.start()
            try:
                action()
                while True:
                    time.sleep(1)
            except KeyboardInterrupt:
                if sent:
                    late.append(1000 * (time.perf_counter() - sent[0]))
            thread.join()
        late.sort()
        print(f"{name}: median {statistics.median(late):.0f} ms, 95 of 100 within {late[int(0.95 * (len(late) - 1))]:.0f}, all within {late[-1]:.0f}")


def threads(runs: int) -> None:
    """Four threads with one session, beside one after another."""
    cloud = rs.build(np.random.default_rng(1).random((200_000, 3)), radius=0.02)
    cameras = [rs.Camera.fit(cloud).orbited(k * 50, about=(0.5, 0.5, 0.5)) for k in range(4)]
    render = lambda camera: np.asarray(rs.render(cloud, camera=camera, size=400, look="gas"))  # noqa: E731
    expected = [render(camera) for camera in cameras]
    together, alone = [], []
    for _ in range(runs):
        started = time.perf_counter()
        for camera in cameras:
            render(camera)
        alone.append(time.perf_counter() - started)
        found = [None] * 4
        workers = [threading.Thread(target=lambda k=k: found.__setitem__(k, render(cameras[k]))) for k in range(4)]
        started = time.perf_counter()
        [worker.start() for worker in workers]
        [worker.join() for worker in workers]
        together.append(time.perf_counter() - started)
        assert all(np.array_equal(a, b) for a, b in zip(found, expected))
    a, b = statistics.median(together), statistics.median(alone)
    print(f"four threads {a:.2f} s, one after another {b:.2f} s: {a / b:.2f}; the same pictures")


def figures(folder: Path) -> None:
    """All scene files of a folder, by the package and by the program."""
    program = _program.path()
    for path in sorted(folder.glob("*.json")):
        output = folder / "by-program.png"
        run = subprocess.run([program, "render", str(path), "-o", str(output), "--memory", "1GiB"], capture_output=True, text=True)
        if run.returncode:
            print(f"{path.name}: {run.stderr.strip().splitlines()[-1]}")
            continue
        mine = folder / "by-package.png"
        rs.render(rs.Scene.load(path), layers=False).save(mine)
        print(f"{path.name}: {'the same bytes' if mine.read_bytes() == output.read_bytes() else 'OTHER BYTES'}, {output.stat().st_size}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=["arrays", "iterator", "interrupts", "threads", "figures"])
    parser.add_argument("folder", type=Path, nargs="?", default=Path("."))
    parser.add_argument("--points", type=float)
    parser.add_argument("--runs", type=int)
    arguments = parser.parse_args()
    folder = arguments.folder.resolve()
    match arguments.what:
        case "arrays":
            arrays(folder, int(arguments.points or 1e7), arguments.runs or 9)
        case "iterator":
            iterator(folder, int(arguments.points or 3e8))
        case "interrupts":
            interrupts(arguments.runs or 60)
        case "threads":
            threads(arguments.runs or 9)
        case "figures":
            figures(folder)


if __name__ == "__main__":
    main()
