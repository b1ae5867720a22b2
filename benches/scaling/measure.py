"""What the program costs on this machine: `simulate.py measure`, which writes costs.json."""

import base64
import json
import os
import platform
import subprocess
import time
from collections import OrderedDict
from pathlib import Path

SIZES = [10**6, 10**7, 10**8]
POINTS = 10**11
PICTURES = {"8K": (7680, 4320), "1080p": (1920, 1080)}
LOOKS = ["opaque", "translucent"]
FIELD = 30.0
FRAMES = 1000
GAP, MOST = 64 << 10, 1 << 20
"""Reads closer than GAP bytes share a request of at most MOST bytes: the program's own numbers."""


def median(values):
    values = sorted(values)
    middle = len(values) // 2
    return values[middle] if len(values) % 2 else (values[middle - 1] + values[middle]) / 2


def joined(pages, page_bytes):
    """Requests and bytes for pages that are asked for together."""
    requests = size = 0
    start = end = None
    for page in sorted(pages):
        at = page * page_bytes
        if end is not None and at - end <= GAP and at + page_bytes - start <= MOST:
            end = at + page_bytes
            continue
        if end is not None:
            size += end - start
        start, end = at, at + page_bytes
        requests += 1
    return requests, size + (end - start if end is not None else 0)


def summary(trace, frame=0):
    """Of a traced picture: totals, what neighbouring blocks share, and what joins."""
    blocks = {(i, j): (ns, set(pages)) for i, j, ns, pages in trace["frames"][frame]["blocks"]}
    busy = {at: block for at, block in blocks.items() if len(block[1]) > 32}
    distinct = set().union(*(pages for _, pages in blocks.values()))
    shared = possible = 0
    for (i, j), (_, pages) in busy.items():
        for other in ((i + 1, j), (i, j + 1)):
            if other in busy:
                shared += len(pages & busy[other][1])
                possible += min(len(pages), len(busy[other][1]))
    requests = size = 0
    for _, pages in busy.values():
        q, b = joined(pages, trace["page_bytes"])
        requests, size = requests + q, size + b
    asked = sum(len(pages) for _, pages in busy.values())
    of_eight = len({page // 8 for page in distinct})
    return {
        "points": trace["points"],
        "cpu_s": sum(ns for ns, _ in blocks.values()) / 1e9,
        "pages": len(distinct),
        "node_pages": sum(page >= trace["first_node_page"] for page in distinct),
        "block_pages": sum(len(pages) for _, pages in blocks.values()),
        "busy_blocks": len(busy),
        "shared_with_neighbour": shared / possible if possible else 0.0,
        "requests_a_page": requests / asked if asked else 1.0,
        "bytes_a_page": size / asked if asked else trace["page_bytes"],
        "pages_of_eight": of_eight,
    }


def lru(frames, capacity):
    """Pages read for each frame, where so many fit and the least recently used goes."""
    held, reads = OrderedDict(), []
    for frame in frames:
        missed = 0
        for pages in frame:
            for page in pages:
                if page in held:
                    held.move_to_end(page)
                    continue
                missed += 1
                held[page] = None
                if len(held) > capacity:
                    held.popitem(last=False)
        reads.append(missed)
    return reads


class Measurement:
    def __init__(self, program, bench, data):
        self.program, self.bench, self.data = program, bench, Path(data)
        self.data.mkdir(parents=True, exist_ok=True)
        self.loads = []

    def run(self, *words, program=None):
        self.loads.append(os.getloadavg()[0])
        return subprocess.run([program or self.program, *map(str, words)], check=True, capture_output=True, text=True).stdout

    def scaling(self, *words):
        return [json.loads(line) for line in self.run(*words, program=self.bench).splitlines() if line.startswith("{")]

    def trace(self, points, size, look, field=FIELD, repeat=3, **more):
        words = [f"{key}={value}" for key, value in more.items()]
        width, height = size
        runs = [
            self.scaling("trace", f"cloud={self.cloud(points)}", f"size={width}x{height}", f"look={look}", f"field={field}", *words)[0]
            for _ in range(repeat)
        ]
        runs.sort(key=lambda run: sum(block[2] for block in run["frames"][0]["blocks"]))
        return runs[len(runs) // 2]

    def cloud(self, points):
        return self.data / f"cloud-{points // 10**6}m.rset"

    def clouds(self, mesh):
        """The same surface with more and more points; radii follow the spacing."""
        said = self.data / "clouds.json"
        if said.exists():
            return json.loads(said.read_text())
        # Automatic radii, once; then all points share their mean.
        radius = self.scaling("cloud", f"mesh={mesh}", f"points={SIZES[0]}", f"out={self.cloud(SIZES[0])}")[0]["radius"]
        rows = []
        for points in SIZES:
            given = f"radius={radius * (SIZES[0] / points) ** 0.5}"
            rows += self.scaling("cloud", f"mesh={mesh}", f"points={points}", f"out={self.cloud(points)}", given)
        said.write_text(json.dumps(rows))
        return rows

    def scale_models(self):
        """The same points a pixel as in the picture of 10¹¹ points, in a picture and a cloud that are as much smaller."""
        rows = []
        for name, (width, height) in PICTURES.items():
            for points in SIZES:
                factor = (POINTS / points) ** 0.5
                size = max(1, round(width / factor)), max(1, round(height / factor))
                if size[0] < 16:
                    continue
                for look in LOOKS:
                    trace = self.trace(points, size, look, FIELD / factor)
                    rows.append({"picture": name, "look": look, "size": size, **summary(trace)})
        return rows

    def reads(self):
        """What the program reads for the largest scale models from 50 ms away, look-ahead included: the whole, and block by block."""
        rows, points = [], SIZES[-1]
        factor = (POINTS / points) ** 0.5
        for name, (width, height) in PICTURES.items():
            size = round(width / factor), round(height / factor)
            blocks = -(-size[0] // 32) * -(-size[1] // 32)
            for look in LOOKS:
                words = ["remote", f"cloud={self.cloud(points)}", f"size={size[0]}x{size[1]}", f"look={look}", f"field={FIELD / factor}", "threads=2"]
                whole = self.scaling(*words, "repeat=1")[0]
                alone = [self.scaling(*words, f"part={part}/{blocks}", "repeat=1")[0] for part in range(1, blocks + 1)]
                rows.append({"picture": name, "look": look, "points": points, "size": size,
                             "whole": {k: whole[k] for k in ("unique", "reads", "requests", "bytes", "seconds")},
                             "alone": {k: sum(run[k] for run in alone) for k in ("unique", "reads", "requests", "bytes")}})
        return rows

    def levels(self):
        """Four points a pixel: what a picture would cost if aggregates stood for finer points."""
        points, rows = SIZES[0], []
        for name, (width, height) in PICTURES.items():
            factor = (4 * width * height / points) ** 0.5
            size = round(width / factor), round(height / factor)
            for look in LOOKS:
                rows.append({"picture": name, "look": look, "size": size, "factor": factor,
                             **summary(self.trace(points, size, look, FIELD / factor))})
        return rows

    def fixed(self):
        """One picture of clouds of more and more points."""
        return [{"size": (512, 288), "look": look, **summary(self.trace(points, (512, 288), look))} for look in LOOKS for points in SIZES]

    def maps(self):
        """How work and pages are spread over the picture: as many squares as an 8K picture has blocks."""
        maps = {}
        for look in LOOKS:
            blocks = self.trace(SIZES[-1], PICTURES["1080p"], look, unit=8, repeat=1)["frames"][0]["blocks"]
            maps[look] = {}
            for name, value in (("cpu", lambda b: b[2]), ("pages", lambda b: len(b[3]))):
                values = [value(block) for block in blocks]
                top = max(values)
                # A square root keeps small values apart in a byte.
                packed = bytes(round(255 * (v / top) ** 0.5) for v in values)
                maps[look][name] = base64.b64encode(packed).decode()
        return {"columns": 240, "rows": 135, "square_roots_of": maps}

    def turntable(self, frames=10):
        """Pages from frame to frame of a turntable, in a scale model whose surface moves as many pixels a frame."""
        width, height = PICTURES["1080p"]
        points = SIZES[-1]
        factor = (POINTS / points) ** 0.5
        size = round(width / factor), round(height / factor)
        rows = []
        for look in LOOKS:
            trace = self.trace(points, size, look, FIELD / factor, repeat=1, frames=frames, turn=360 / FRAMES * factor)
            pages = [[block[3] for block in frame["blocks"]] for frame in trace["frames"]]
            distinct = [len(set().union(*map(set, frame))) for frame in pages]
            all_pages = trace["point_pages"] + trace["node_pages"]
            rows.append({
                "look": look, "size": size, "points": points, "frames": frames, "distinct": distinct,
                "cpu_s": [sum(block[2] for block in frame["blocks"]) / 1e9 for frame in trace["frames"]],
                "reads_by_capacity": {str(share): lru(pages, int(all_pages * share)) for share in (0.005, 0.02, 0.1, 0.25, 0.5, 1.0)},
                "all_pages": all_pages,
            })
        return rows

    def parts(self, points=10**7, size=(1024, 576)):
        """Pages that parts read, by the program, and as the traced picture has it."""
        picture = [f"cloud={self.cloud(points)}", f"size={size[0]}x{size[1]}", "look=opaque"]
        trace = self.trace(points, size, "opaque", repeat=5)
        rows = []
        for of in (1, 2, 4, 8, 16, 32, 64, 576):
            runs = [self.scaling("remote", *picture, f"part={part}/{of}", "latency=0", "repeat=1")[0] for part in range(1, of + 1)]
            rows.append({"of": of, "pages": [run["unique"] for run in runs], "seconds": [run["seconds"] for run in runs]})
        blocks = [[i, j, ns, pages] for i, j, ns, pages in trace["frames"][0]["blocks"]]
        return {"points": points, "size": size, "page_bytes": trace["page_bytes"], "blocks": blocks, "measured": rows}

    def remote(self, points=10**7, size=(1024, 576)):
        """Pictures from a simulated object that is 50 ms away, in one and in several processes at a time."""
        picture = [f"cloud={self.cloud(points)}", f"size={size[0]}x{size[1]}", "look=opaque"]
        rows = []
        for of, threads, latency in [(1, 1, 0.05), (1, 2, 0.05), (2, 1, 0.05), (4, 1, 0.05), (8, 1, 0.05), (1, 1, 0.2), (2, 1, 0.2), (1, 1, 0.0)]:
            runs = []
            # Two processes at a time: there are two processors.
            for first in range(1, of + 1, 2):
                jobs = [
                    subprocess.Popen([self.bench, "remote", *picture, f"part={part}/{of}", f"threads={threads}", f"latency={latency}", "repeat=5"],
                                     stdout=subprocess.PIPE, text=True)
                    for part in range(first, min(first + 2, of + 1))
                ]
                for job in jobs:
                    lines = [json.loads(line) for line in job.communicate()[0].splitlines() if line.startswith("{")]
                    runs.append({key: median([line[key] for line in lines]) for key in lines[0]})
            self.loads.append(os.getloadavg()[0])
            rows.append({"of": of, "threads": threads, "latency": latency, "runs": runs})
        return rows

    def opening(self):
        """The least that a process takes, by the size of the cloud."""
        rows = []
        for points in SIZES:
            header = json.loads(self.run("info", self.cloud(points), "--json"))
            low, high = header["bounds_min"], header["bounds_max"]
            eye = ",".join(str(b + (b - a)) for a, b in zip(low, high))
            ahead = ",".join(str(a - b) for a, b in zip(low, high))
            times = []
            for _ in range(5):
                started = time.monotonic()
                self.run("render", self.cloud(points), "-o", self.data / "dot.png", "--size", "9x9", "--crop", "4,4,1,1", "--samples", 1,
                         "--position", eye, f"--direction={ahead}", "--threads", 1, "--memory", "256MiB", "--shading", "none",
                         "--opacity", "extinction:1", "--color", "white", "--ambient-occlusion", 0)
                times.append(time.monotonic() - started)
            remote = self.scaling("remote", f"cloud={self.cloud(points)}", "size=8x8", "repeat=1")[0]
            rows.append({"points": points, "seconds": median(times), "opening_requests": remote["opening_requests"], "opened_s": remote["opened"],
                         "file_bytes": self.cloud(points).stat().st_size})
        return rows

    def merges(self):
        """`rayset merge` of an 8K picture in parts."""
        rows = []
        look = ["--samples", 1, "--ambient-occlusion", 0, "--shading", "none", "--opacity", "extinction:1", "--color", "white", "--memory", "1GiB"]
        for of in (1, 8, 64):
            names = [self.data / f"p.{part}.part" for part in range(1, of + 1)]
            for part, name in enumerate(names, 1):
                self.run("render", self.cloud(SIZES[0]), "--size", "7680x4320", "--part", f"{part}/{of}", "-o", name, *look)
            times = []
            for _ in range(3):
                started = time.monotonic()
                self.run("merge", *names, "-o", self.data / "merged.png", "--memory", "1GiB")
                times.append(time.monotonic() - started)
            rows.append({"of": of, "pixels": 7680 * 4320, "seconds": median(times), "bytes": sum(name.stat().st_size for name in names)})
            for name in names:
                name.unlink()
        return rows

    def builds(self):
        """Every step of builds in parts, part after part, one thread each; and builds in one process."""
        rows = []
        for millions, ofs in ((10, (1, 4)), (30, (1, 2, 8))):
            ply = self.data / f"sphere-{millions}m.ply"
            if not ply.exists():
                self.run("generate", f"sphere-{millions}m", "-o", ply)
            radius = (160 / (millions * 10**6)) ** 0.5
            common = ["--radius", radius, "--memory", "512MiB", "--threads", 1]
            started = time.monotonic()
            self.run("build", ply, "-o", self.data / "one.rset", *common)
            rows.append({"points": millions * 10**6, "of": 0, "seconds": {"whole": time.monotonic() - started}})
            (self.data / "one.rset").unlink()
            for of in ofs:
                out, steps = self.data / "parts.rset", {}
                for step in ("read", "count", "scatter", "order"):
                    steps[step] = [
                        json.loads(self.run("build", ply, "-o", out, "--part", f"{part}/{of}", "--step", step, "--json", *common))["seconds"]
                        for part in range(1, of + 1)
                    ]
                exchanged = sum(path.stat().st_size for path in Path(f"{out}.parts").iterdir())
                started = time.monotonic()
                self.run("merge", f"{out}.parts", "-o", out, "--memory", "512MiB")
                steps["merge"] = time.monotonic() - started
                rows.append({"points": millions * 10**6, "of": of, "seconds": steps, "ordered_bytes": exchanged, "file_bytes": out.stat().st_size})
                out.unlink()
        return rows

    def everything(self, mesh, only):
        costs = {}
        path = Path(__file__).with_name("costs.json")
        if path.exists():
            costs = json.loads(path.read_text())
        for name in ("clouds", "scale_models", "reads", "levels", "fixed", "maps", "turntable", "parts", "remote", "opening", "merges", "builds"):
            if only and name not in only:
                continue
            self.loads.clear()
            begun = time.monotonic()
            value = self.clouds(mesh) if name == "clouds" else getattr(self, name)()
            costs[name] = value
            costs.setdefault("loads", {})[name] = [round(min(self.loads or [0]), 2), round(max(self.loads or [0]), 2)]
            cpus = [line.split(":")[1].strip() for line in open("/proc/cpuinfo") if line.startswith("model name")]
            costs["machine"] = {"processor": cpus[0], "processors": len(cpus), "system": platform.system(), "date": time.strftime("%Y-%m-%d")}
            path.write_text(json.dumps(costs, separators=(",", ":")).replace('],"', '],\n"').replace('},"', '},\n"') + "\n")
            print(f"{name}: {time.monotonic() - begun:.0f} s, load {costs['loads'][name]}", flush=True)
