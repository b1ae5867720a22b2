#!/usr/bin/env python3
"""Measures pictures of clouds behind a web server that is 50 ms away, against the same from a disk.

    cargo build --release -p rayset-cli --features remote
    cargo build --release -p rayset-remote --features stores --example range_server
    latency.py PROGRAM RANGE_SERVER FOLDER [--repeat 5] [--predictors] [--only NAME]

FOLDER has the data: sphere-10m.rset is made if it is not there, figure 10 is measured if fig10.json is (`rayset figure 10 --data FOLDER`).
The limit is that of `crates/rayset/benches/remote_storage.rs`: 1.3 times the larger of the time from the disk and of the distinct pages that
rays ask for · 50 ms / 64, plus ten round trips; and 0.6 requests for each of these pages. Times are those of the whole program, one
thread; figures are medians. Ends with 1 if a limit is exceeded.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import re
import statistics
import subprocess
import sys
import time
from pathlib import Path

LATENCY, IN_FLIGHT = 0.05, 64
PAGE = 32 << 10
SPHERE = {
    "rayset": 1,
    "image": {"size": [512, 512]},
    "camera": {"position": [0, 0, 3], "lookAt": [0, 0, 0], "fovy": 45},
    "lights": "none",
    "background": "#000000",
}


def render(program: Path, scene: str, picture: Path, memory: int, *more: str) -> tuple[float, dict]:
    """Seconds of a picture, and what the program says of it."""
    statistics_of = picture.with_suffix(".json")
    words = [program, "render", scene, "-o", picture, "--threads", "1", "--memory", str(memory), "--stats", statistics_of, *more]
    begun = time.monotonic()
    done = subprocess.run([str(word) for word in words], capture_output=True, text=True, check=False)
    seconds = time.monotonic() - begun
    if done.returncode != 0:
        sys.exit(f"{words}\n{done.stdout}{done.stderr}")
    return seconds, json.loads(statistics_of.read_text())


def digest(picture: Path) -> str:
    return hashlib.sha256(picture.read_bytes()).hexdigest()


def memory_for(program: Path, scene: str, folder: Path, page_bytes: int, *more: str) -> int:
    """What the whole program may take so that about so many bytes are left for pages: what it plans with grows with the memory."""
    memory = 1 << 30
    for _ in range(4):
        _, known = render(program, scene, folder / "plan.png", memory, *more)
        memory -= known["pages_budget_bytes"] - page_bytes
    return memory


class Server:
    """The range server of crate rayset-remote, at a distance, as long as it is needed."""

    def __init__(self, program: Path, folder: Path):
        words = [str(program), str(folder), "0", f"latency_ms={1000 * LATENCY}", "jitter=0.2"]
        self.process = subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        self.address = self.process.stdout.readline().strip().rstrip("/")

    def end(self) -> int:
        """The number of requests for ranges that it has answered."""
        said, _ = self.process.communicate()
        return int(re.search(r"(\d+) reads", said)[1])


def scenes(folder: Path, program: Path) -> list[tuple[str, str, int, list[str]]]:
    """Names, files of scenes, bytes of pages that fit, and options."""
    cloud = folder / "sphere-10m.rset"
    radius = (160 / 1e7) ** 0.5
    if not cloud.exists():
        points = folder / "sphere-10m.ply"
        subprocess.run([program, "generate", "sphere-10m", "-o", points], check=True, stdout=subprocess.DEVNULL)
        subprocess.run([program, "build", points, "-o", cloud, "--radius", str(radius)], check=True, stdout=subprocess.DEVNULL)
        points.unlink()
    tenth = cloud.stat().st_size // 10 // PAGE * PAGE
    found = []
    for name, kappa, stop in (("opaque", 2.0, 0.01), ("translucent", 0.02, 0.0)):
        root = {"type": "cloud", "file": cloud.name, "transferFunction": {"opacity": {"extinction": kappa / radius}, "color": "#ffffff"}}
        scene = SPHERE | {"rendering": {"stopTransmittance": stop, "unitDistance": radius}, "root": root}
        (folder / f"{name}.json").write_text(json.dumps(scene))
        found.append((f"sphere-10m {name}", f"{name}.json", tenth, []))
    if (folder / "fig10.json").exists():
        files = sum((folder / name).stat().st_size for name in ("scan.rset", "other.rset", "volume.rset"))
        # Tables of shadows are pages, too.
        shadows = 64 << 20
        for part in (1, 10):
            found.append((f"figure 10, 1/{part}", "fig10.json", files // part // PAGE * PAGE + shadows, []))
    return found


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("program", type=Path)
    parser.add_argument("range_server", type=Path)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--repeat", type=int, default=5)
    parser.add_argument("--predictors", action="store_true", help="also without look-ahead, once each")
    parser.add_argument("--only", default="")
    given = parser.parse_args()
    program, folder = given.program.resolve(), given.folder.resolve()
    print("| case | predictor | from the disk s | s | bound s | of bound | pages asked for | requests a page |")
    print("| --- | --- | ---: | ---: | ---: | ---: | ---: | ---: |")
    met = True
    for name, scene, page_bytes, more in scenes(folder, program):
        if given.only not in name:
            continue
        near = str(folder / scene)
        times = [render(program, near, folder / "near.png", 1 << 30, *more)[0] for _ in range(given.repeat + 1)]
        in_core = statistics.median(times[1:])
        _, known = render(program, near, folder / "near.png", 1 << 30, "--predictor", "none", *more)
        # There is room for all of them: each is read once.
        pages = sum(kind["reads"] for kind in known["working_set_by_kind"])
        bound = 1.3 * max(in_core, pages * LATENCY / IN_FLIGHT) + 10 * LATENCY
        # What requests take is set aside of remote files alone.
        server = Server(given.range_server, folder)
        memory = memory_for(program, f"{server.address}/{scene}", folder, page_bytes, *more)
        server.end()
        for predictor, repeat in [("packet", given.repeat)] + [("line", 1), ("none", 1)] * given.predictors:
            seconds, requests = [], []
            for _ in range(repeat):
                server = Server(given.range_server, folder)
                try:
                    taken, known = render(program, f"{server.address}/{scene}", folder / "remote.png", memory, "--predictor", predictor, *more)
                finally:
                    answered = server.end()
                if known["pages_budget_bytes"] > 1.1 * page_bytes + PAGE:
                    sys.exit(f"{name}: {known['pages_budget_bytes']} bytes of pages, not {page_bytes}")
                if digest(folder / "remote.png") != digest(folder / "near.png"):
                    sys.exit(f"{name}: another picture")
                seconds.append(taken)
                requests.append(answered)
            taken, a_page = statistics.median(seconds), statistics.median(requests) / pages
            print(f"| {name} | {predictor} | {in_core:.2f} | {taken:.2f} | {bound:.2f} | {taken / bound:.2f} | {pages:.0f} | {a_page:.2f} |", flush=True)
            met &= predictor != "packet" or (taken <= bound and a_page <= 0.6)
    if not met:
        sys.exit("missed")


if __name__ == "__main__":
    main()
