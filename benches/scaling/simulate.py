#!/usr/bin/env python3
"""Many machines and a bucket, simulated with costs that were measured: docs/scaling.md.

    simulate.py measure --program RAYSET --bench BENCH --mesh FILE --data FOLDER    costs.json, of this machine; ten minutes, 2 GB
    simulate.py simulate [--figure FILE.svg] [--page docs/scaling.md]               the tables, and the figure
    simulate.py validate [--page docs/scaling.md]                                   what can be run here, predicted and measured
    simulate.py check                                                               limits that are known in closed form

BENCH is the program that `cargo bench -p rayset --bench scaling --no-run` names. Python's standard library is all it takes.
"""

import argparse
import base64
import heapq
import json
import math
import random
import sys
from dataclasses import dataclass, replace
from pathlib import Path

import refusals

HERE = Path(__file__).resolve().parent
FIRST_ROUND_TRIPS = 2.5
"""Before the first block and behind the last: node pages, then points, then what was not foreseen. One is known; the rest is fitted (`validate`)."""
WORKERS = [2**k for k in range(11)]


@dataclass(frozen=True)
class Parameters:
    """What is not measured here. Sources are in docs/scaling.md."""

    points: float = 1e11
    threads: int = 8
    memory_bytes: float = 16 * 2**30
    network: float = 3.125e9 / 8  # bytes a second of a worker
    connection: float = 90e6  # bytes a second of a request
    latency: float = 0.05
    jitter: float = 0.2
    in_flight: int = 64  # the program's own
    prefix_rate: float = 5500.0  # requests a second of one prefix
    prefixes: int = 1  # a cloud is one object
    dispatch: float = 0.02  # seconds a task, one after another
    worker_hour: float = 0.36
    get_million: float = 0.40
    egress_gigabyte: float = 0.09
    exchange: float = 5e9  # bytes a second of the file system through which builds exchange files
    most_build_parts: int = 512  # the program's own
    page_bytes: int = 32768
    attempts: int = 6
    first_pause: float = 0.1
    longest_pause: float = 5.0
    decrease: float = 0.7  # the program's own: what a refusal leaves of the requests in flight
    longest_quiet: float = 1.0
    give_up_after: float = 150.0


# --- how the program deals out a picture (crates/rayset-render/src/trace/parts/share.rs, crates/rayset-base/src/geometry/curve.rs)


def hilbert_cell(side, index):
    x = y = 0
    s = 1
    while s < side:
        rx = 1 if index & 2 else 0
        ry = (index ^ rx) & 1
        if ry == 0:
            if rx:
                x, y = s - 1 - x, s - 1 - y
            x, y = y, x
        x, y = x + s * rx, y + s * ry
        index >>= 2
        s <<= 1
    return x, y


def hilbert_cells(columns, rows):
    side = 1
    while side < min(columns, rows):
        side *= 2
    for at in range(-(-max(columns, rows) // side)):
        x0, y0 = (at * side, 0) if columns > rows else (0, at * side)
        for index in range(side * side):
            x, y = hilbert_cell(side, index)
            if x0 + x < columns and y0 + y < rows:
                yield x0 + x, y0 + y


def dealt(columns, rows, of, most=8):
    """The blocks of each share, in order."""
    stretch = max(1, min(most, columns * rows // (16 * of)))
    shares = [[] for _ in range(of)]
    for at, block in enumerate(hilbert_cells(columns, rows)):
        shares[at // stretch % of].append(block)
    return shares


# --- the machine room


def run(work, p, window_pages, start=None, seed=1):
    """Every worker takes its chunks (processor seconds, pages, requests, bytes) in order: reads ahead as far as the window reaches, and
    traces on all of its threads what has come. Returns when each is done, and the requests and bytes.

    Requests wait for three servers: the worker's requests in flight, the bucket's rate, the worker's network."""
    rate = p.prefix_rate * p.prefixes
    randoms = random.Random(seed)
    count = len(work)
    begun = start or [0.0] * count
    issued, used, ahead, ready = [0] * count, [0] * count, [0.0] * count, [[] for _ in range(count)]
    busy, done, pipe, network, last = [False] * count, [0.0] * count, list(begun), list(begun), list(begun)
    bucket = requests = size = 0.0
    events = []
    serial = 0

    def push(time, kind, worker, chunk):
        nonlocal serial
        serial += 1
        heapq.heappush(events, (time, serial, kind, worker, chunk))

    for worker in range(count):
        push(begun[worker], "issue", worker, None)
    while events:
        now, _, kind, w, chunk = heapq.heappop(events)
        if kind == "arrived":
            ready[w].append(chunk)
        elif kind == "traced":
            busy[w] = False
            ahead[w] -= work[w][chunk][1]
            used[w] += 1
            last[w] = now
        # One chunk at a time is asked for, so that workers take turns at the bucket.
        if issued[w] < len(work[w]) and (ahead[w] < window_pages or ahead[w] == 0) and (kind != "arrived"):
            cpu, pages, asked, bytes_ = work[w][issued[w]]
            arrival = now
            if asked > 0:
                flight = p.latency + bytes_ / asked / p.connection
                pipe[w] = max(pipe[w], now) + asked * flight / p.in_flight
                bucket = max(bucket, now) + asked / rate
                network[w] = max(network[w], now) + bytes_ / p.network
                slowest = 1 + p.jitter * (2 * randoms.random() ** (1 / asked) - 1)
                arrival = max(pipe[w], bucket + p.latency, network[w] + p.latency, now + flight - p.latency + p.latency * slowest)
                requests, size = requests + asked, size + bytes_
            ahead[w] += pages
            push(arrival, "arrived", w, issued[w])
            issued[w] += 1
            # The next goes out when the last request of this one has.
            push(max(now, pipe[w] - 2 * p.latency, bucket - 2 * p.latency, network[w] - 2 * p.latency) if asked > 0 else now, "issue", w, None)
        if ready[w] and not busy[w]:
            chunk = ready[w].pop(0)
            busy[w] = True
            push(now + work[w][chunk][0] / p.threads, "traced", w, chunk)
    for w in range(count):
        assert used[w] == len(work[w]), "everything is traced"
        done[w] = last[w]
    return done, requests, size


# --- the work


@dataclass
class Picture:
    """Costs of blocks of 32×32 pixels."""

    columns: int
    rows: int
    cpu: dict
    pages: dict
    shared: float  # fraction of a block's pages that a neighbouring block needs, too
    requests_a_page: tuple  # where blocks are read one by one; where all follow each other
    bytes_a_page: float

    def total(self, what):
        return sum(getattr(self, what).values())


class Costs:
    def __init__(self, raw, p):
        self.raw, self.p, self.shared = raw, p, {}

    def model(self, picture, look):
        """The largest scale model of a picture."""
        rows = [r for r in self.raw["scale_models"] if r["picture"] == picture and r["look"] == look]
        return max(rows, key=lambda r: r["points"])

    def page_cpu(self):
        """Processor seconds for reading a page, besides tracing: from renders of an object without latency."""
        parts = self.raw["parts"]
        traced = sum(block[2] for block in parts["blocks"]) / 1e9
        alone = next(r for r in self.raw["remote"] if r["of"] == 1 and r["latency"] == 0)["runs"][0]
        return max(0.0, (alone["seconds"] - traced) / alone["unique"])

    def weights(self, look, what, columns, rows):
        maps = self.raw["maps"]
        packed = base64.b64decode(maps["square_roots_of"][look][what])
        pooled = {}
        for at, value in enumerate(packed):
            j, i = divmod(at, maps["columns"])
            block = i * columns // maps["columns"], j * rows // maps["rows"]
            pooled[block] = pooled.get(block, 0) + value**2
        total = sum(pooled.values())
        return {block: value / total for block, value in pooled.items()}

    def picture(self, name, look, lod=False, pages_of_eight=False, exact=False):
        width, height = {"8K": (7680, 4320), "1080p": (1920, 1080)}[name]
        columns, rows = -(-width // 32), -(-height // 32)
        cpu_at, pages_at = self.weights(look, "cpu", columns, rows), self.weights(look, "pages", columns, rows)
        if lod or exact:
            rows_of = self.raw["levels"] if lod else [self.model(name, look)]
            model = next(r for r in rows_of if r["picture"] == name and r["look"] == look)
            factor = model["factor"] ** 2 if lod else self.p.points / model["points"]
            alone, whole = model["block_pages"] * factor, model["pages"] * factor
            requests, bytes_ = (model["requests_a_page"],) * 2, model["bytes_a_page"]
        else:
            model = self.model(name, look)
            factor = self.p.points / model["points"]
            read = next(r for r in self.raw["reads"] if r["picture"] == name and r["look"] == look)
            # Each part of the scale model reads all node pages at once, which are too many for that at full size.
            again = (-(-read["size"][0] // 32) * -(-read["size"][1] // 32) - 1) * large_nodes(self.raw)["node_pages"]
            alone, whole = (read["alone"]["unique"] - again) * factor, read["whole"]["unique"] * factor
            requests = tuple(read[k]["requests"] / read[k]["unique"] for k in ("alone", "whole"))
            bytes_ = read["whole"]["bytes"] / read["whole"]["unique"]
        if pages_of_eight:
            # No more than all; and four of them fit in a request.
            coarse = min(model["pages_of_eight"] / model["pages"], self.all_pages() / 8 / whole)
            alone, whole, requests, bytes_ = alone * coarse, whole * coarse, (max(0.25, 8 * requests[0]), max(0.25, 8 * requests[1])), 8.0 * self.p.page_bytes
        picture = Picture(
            columns, rows,
            {b: w * model["cpu_s"] * factor for b, w in cpu_at.items()},
            {b: w * alone for b, w in pages_at.items()},
            0.0, requests, bytes_,
        )
        key = name, look, lod, pages_of_eight, exact
        if key not in self.shared:
            self.shared[key] = calibrated(picture, whole)
        picture.shared = self.shared[key]
        return picture

    def all_pages(self):
        top = max(self.raw["turntable"], key=lambda r: r["points"])
        return top["all_pages"] * self.p.points / top["points"]

    def opening(self):
        """Seconds until a worker can begin, and the memory for the table of pages."""
        pages = self.all_pages()
        rows = self.raw["opening"]
        (small, large) = rows[0], rows[-1]
        slope = max(0.0, (large["seconds"] - small["seconds"]) / (large["file_bytes"] - small["file_bytes"]))
        file_bytes = pages * self.p.page_bytes
        # Round trips: header, footer, descriptions; then down the octree, a level of node pages at a time.
        node = large_nodes(self.raw)
        fan = node["nodes_a_page"]
        levels = math.log(max(2.0, node["node_pages"] * self.p.points / node["points"])) / math.log(fan) + 1
        return {
            "cpu_s": small["seconds"] + slope * (file_bytes - small["file_bytes"]),
            "round_trips": large["opening_requests"] + math.ceil(levels) + FIRST_ROUND_TRIPS - 1,
            "table_bytes": 28 * pages,
            "node_bytes": node["node_pages"] * self.p.points / node["points"] * self.p.page_bytes,
            "file_bytes": file_bytes,
        }

    def merge_rate(self):
        """Seconds of a merge: a pixel, and a part."""
        rows = self.raw["merges"]
        few, many = rows[0], rows[-1]
        part = max(0.0, (many["seconds"] - few["seconds"]) / (many["of"] - few["of"]))
        return (few["seconds"] - part * few["of"]) / few["pixels"], part, few["bytes"] / few["pixels"]


def large_nodes(raw):
    row = max((r for r in raw["scale_models"]), key=lambda r: (r["points"], r["node_pages"]))
    return {"points": row["points"], "node_pages": row["node_pages"], "nodes_a_page": 409}


def calibrated(picture, whole):
    """What neighbours share, such that one worker with room for everything reads `whole` pages."""
    share, low, high = dealt(picture.columns, picture.rows, 1)[0], 0.0, 1.0
    for _ in range(12):
        picture.shared = (low + high) / 2
        if sum(c[1] for c in chunks(picture, share, 1e18, 0.0)) > whole:
            low = picture.shared
        else:
            high = picture.shared
    return (low + high) / 2


def stretch_of(share):
    """Blocks in a row that are neighbours, on average."""
    breaks = sum(abs(a - c) + abs(b - d) != 1 for (a, b), (c, d) in zip(share, share[1:]))
    return len(share) / (breaks + 1) if share else 1.0


def chunks(picture, share, cache_pages, page_cpu, neighbours=True):
    """What a worker reads and traces for its share: pages of a neighbouring block are there if that came before, not too long ago."""
    at, read = {}, 0.0
    alone, whole = picture.requests_a_page
    a_page = whole + (alone - whole) / stretch_of(share)
    result = []
    for block in share:
        pages = picture.pages.get(block, 0.0)
        fresh = pages
        i, j = block
        for other in ((i - 1, j), (i + 1, j), (i, j - 1), (i, j + 1)):
            before = at.get(other)
            if neighbours and before is not None and read - before <= cache_pages and pages > 0:
                fresh *= 1 - picture.shared * min(pages, picture.pages.get(other, 0.0)) / pages
        read += fresh
        at[block] = read
        requests = fresh * a_page
        result.append((picture.cpu.get(block, 0.0) + fresh * page_cpu, fresh, max(requests, 1.0) if fresh >= 0.5 else 0.0, fresh * picture.bytes_a_page))
    return result


def window(total_cpu, total_pages, p, cache_pages):
    """The look-ahead: twice what the threads use up during a round trip, at least 64 pages, at most three quarters of the memory."""
    pace = total_pages / max(total_cpu, 1e-9) * p.threads
    return min(max(64.0, 2 * pace * p.latency), 0.75 * cache_pages)


def outcome(seconds, workers, requests, size, p, tail=0.0, billed=None):
    hours = (billed if billed is not None else workers * seconds) / 3600
    return {"workers": workers, "seconds": seconds, "bytes": size, "requests": requests, "tail": tail,
            "money": hours * p.worker_hour + requests / 1e6 * p.get_million}


def starts(costs, workers, p):
    opening = costs.opening()
    return [p.dispatch * (k + 1) + opening["cpu_s"] + opening["round_trips"] * p.latency for k in range(workers)]


def cache_pages(costs, p):
    opening = costs.opening()
    return max(64.0, (0.9 * p.memory_bytes - opening["table_bytes"]) / p.page_bytes)


def simulate_picture(costs, look, workers, p, most=8, lod=False, pages_of_eight=False, shared_cache=False, band_merge=False, exact=False):
    picture = costs.picture("8K", look, lod, pages_of_eight, exact)
    cache = cache_pages(costs, p)
    if pages_of_eight:
        cache /= 8
    page_cpu = costs.page_cpu() * (8 if pages_of_eight else 1)
    shares = dealt(picture.columns, picture.rows, workers, most)
    work = [chunks(picture, share, cache, page_cpu) for share in shares]
    if shared_cache:
        # A page is read from the bucket once, whoever needs it, and comes from the neighbour's memory otherwise.
        alone = sum(c[1] for c in chunks(picture, dealt(picture.columns, picture.rows, 1, most)[0], 1e18, page_cpu))
        ratio = min(1.0, alone / max(1e-9, sum(c[1] for w in work for c in w)))
        work = [[(c, n, q * ratio, b * ratio) for c, n, q, b in w] for w in work]
    reach = window(picture.total("cpu"), picture.total("pages"), p, cache)
    begun = starts(costs, workers, p)
    done, requests, size = run(work, p, reach, begun)
    # Headers and levels of node pages, by each worker.
    requests += workers * costs.opening()["round_trips"]
    a_pixel, a_part, bytes_a_pixel = costs.merge_rate()
    pixels = 7680 * 4320
    merging = (a_pixel * pixels + a_part * workers + pixels * bytes_a_pixel / p.network) if workers > 1 else 0.0
    if band_merge:
        merging = merging / min(workers, 64) + 0.2
    billed = sum(d - b for d, b in zip(done, begun)) + workers * (begun[0]) + merging
    mean = sum(done) / len(done)
    result = outcome(max(done) + merging, workers, requests, size, p, max(done) / mean, billed)
    loads = [sum(c[0] for c in w) / p.threads for w in work], [sum(c[3] for c in w) for w in work]
    result.update(merge=merging, start=begun[-1], skew=[max(load) * workers / sum(load) for load in loads])
    return result


def frame_reads(costs, look, cache):
    """Pages of the first frame and of later ones, where so many fit: replayed on the scale model."""
    row = next(r for r in costs.raw["turntable"] if r["look"] == look)
    factor = costs.p.points / row["points"]
    share = cache / (row["all_pages"] * factor)
    shares = sorted((float(k), v) for k, v in row["reads_by_capacity"].items())
    share = min(max(share, shares[0][0]), shares[-1][0])
    low = max((s for s in shares if s[0] <= share), key=lambda s: s[0])
    high = min((s for s in shares if s[0] >= share), key=lambda s: s[0])
    part = 0.0 if high[0] == low[0] else math.log(share / low[0]) / math.log(high[0] / low[0])

    def mix(pick):
        return (pick(low[1]) * (1 - part) + pick(high[1]) * part) * factor

    later = lambda reads: sum(reads[-4:]) / 4
    return mix(lambda reads: reads[0]), mix(later), sum(row["cpu_s"]) / len(row["cpu_s"]) * factor


def simulate_flight(costs, look, workers, p, frames=1000, lod=False, by_region=False, exact=False):
    cache = cache_pages(costs, p)
    pieces = 1 if by_region else 16
    model = next(r for r in costs.raw["levels"] if r["picture"] == "1080p" and r["look"] == look) if lod else costs.model("1080p", look)
    page_cpu = costs.page_cpu()
    a_page, bytes_a_page = model["requests_a_page"], model["bytes_a_page"]
    if lod:
        factor = model["factor"] ** 2
        cpu, first = model["cpu_s"] * factor, model["pages"] * factor
        row = next(r for r in costs.raw["turntable"] if r["look"] == look)
        kept = sorted((float(k), v) for k, v in row["reads_by_capacity"].items())[-1][1]
        # Coarse pages move with the surface: as many are new in a frame as in the scale model with room for all, at least.
        later = first if cache < first else first * kept[1] / kept[0]
    else:
        room = cache * (workers if by_region else 1)
        first, later, cpu = frame_reads(costs, look, room)
        # What the look-ahead reads besides, and what it joins.
        read = next(r for r in costs.raw["reads"] if r["picture"] == "1080p" and r["look"] == look)
        if not exact:
            besides = read["whole"]["unique"] / model["pages"]
            first, later = (min(pages * besides, costs.all_pages()) for pages in (first, later))
            a_page, bytes_a_page = read["whole"]["requests"] / read["whole"]["unique"], read["whole"]["bytes"] / read["whole"]["unique"]
        if room >= costs.all_pages():
            later = min(later, (costs.all_pages() - first) / (frames - 1))
    used = min(workers, frames) if not by_region else workers
    work = []
    for k in range(used):
        mine = [(f == 0) for f in range(frames * (k + 1) // used - frames * k // used)] if not by_region else [f == 0 for f in range(frames)]
        part = 1.0 / used if by_region else 1.0
        chunk = []
        for is_first in mine:
            pages = (first if is_first else later) * part / pieces
            for _ in range(pieces):
                chunk.append((cpu * part / pieces + pages * page_cpu, pages, max(1.0, pages * a_page), pages * bytes_a_page))
        work.append(chunk)
    if used > 64 and by_region:
        # Workers are alike: some 64 are simulated, with their share of the bucket.
        step = used // 64
        work, q = work[::step], replace(p, prefix_rate=p.prefix_rate * len(work[::step]) / used)
    else:
        step, q = 1, p
    begun = starts(costs, used, p)
    reach = window(cpu, first, p, cache)
    done, requests, size = run(work, q, reach, begun[::step][: len(work)])
    scale = used / len(work)
    requests, size = requests * scale + used * costs.opening()["round_trips"], size * scale
    return outcome(max(done), used, requests, size, p, billed=sum(d - b + begun[0] for d, b in zip(done, begun[::step])) * scale)


def build_rates(raw, points=None, skip=()):
    """Points a second of one thread, step by step: of the largest build measured, or of that of so many points."""
    rows = [r for r in raw["builds"] if r["of"] and (points is None or r["points"] == points)]
    row = max(rows, key=lambda r: (r["points"], -r["of"]))
    rates = {step: row["points"] / sum(row["seconds"][step]) for step in ("read", "count", "scatter", "order")}
    rates["merge"] = row["points"] / row["seconds"]["merge"]
    widest = max((r for r in raw["builds"] if r["of"]), key=lambda r: r["of"])
    skew = max(widest["seconds"]["order"]) * widest["of"] / sum(widest["seconds"]["order"])
    return rates, skew, row["file_bytes"] / row["points"]


def simulate_build(costs, workers, p, merge_in_parts=False):
    """Steps with a barrier after each. A process a processor as long as there are parts left: 512 at most."""
    rates, skew, file_bytes = build_rates(costs.raw)
    n = p.points
    processes = min(workers * p.threads, p.most_build_parts)
    machines = -(-processes // p.threads)
    # Bytes a point that go in and out.
    moved = {"read": 12 + 24, "count": 24, "scatter": 48, "order": 24 + file_bytes}
    seconds, steps = 0.0, {}
    for step in ("read", "count", "scatter", "order"):
        uneven = skew if step == "order" else 1.0
        computing = n / processes / rates[step] * uneven
        moving = n * moved[step] / min(p.exchange, machines * p.network)
        steps[step] = max(computing, moving) + p.dispatch * processes
        seconds += steps[step]
    merging = max(n / rates["merge"], 2 * n * file_bytes / p.network)
    if merge_in_parts:
        merging = max(merging / machines, 2 * n * file_bytes / min(p.exchange, machines * p.network)) + p.dispatch * machines
    steps["merge"] = merging
    billed = machines * seconds + (merging * machines if merge_in_parts else merging)
    size = n * (sum(moved.values()) + 2 * file_bytes)
    result = outcome(seconds + merging, workers, 0, size, p, billed=billed)
    result["steps"] = steps
    return result


# --- reports


def human(value, units):
    for scale, unit in units:
        if value >= scale:
            value /= scale
            return f"{value:.0f} {unit}" if value >= 100 else f"{value:.1f} {unit}" if value >= 10 else f"{value:.2f} {unit}"
    return f"{value:.2g}"


def duration(seconds):
    if seconds < 1000:
        return f"{seconds:.0f} s" if seconds >= 10 else f"{seconds:.1f} s"
    return f"{seconds / 60:.0f} min" if seconds < 7200 else f"{seconds / 3600:.1f} h" if seconds < 2 * 86400 else f"{seconds / 86400:.1f} d"


def size_text(value):
    return human(value, ((1e15, "PB"), (1e12, "TB"), (1e9, "GB"), (1e6, "MB"))) if value else "–"


def number(value):
    return human(value, ((1e9, "G"), (1e6, "M"), (1e3, "k"))) if value else "–"


def money(value):
    return f"${value:,.0f}" if value >= 100 else f"${value:.2f}"


JOBS = [
    ("8K picture, opaque", lambda c, n, p: simulate_picture(c, "opaque", n, p)),
    ("8K picture, translucent", lambda c, n, p: simulate_picture(c, "translucent", n, p)),
    ("1000 frames at 1080p, opaque", lambda c, n, p: simulate_flight(c, "opaque", n, p)),
    ("build", lambda c, n, p: simulate_build(c, n, p)),
]


def tables(costs, p, out):
    curves = {}
    for name, job in JOBS:
        rows = [job(costs, n, p) for n in WORKERS]
        curves[name] = [(n, row["seconds"]) for n, row in zip(WORKERS, rows)]
        out(f"\n**{name[0].upper() + name[1:]}**\n\n| workers | time | of ideal | bytes | requests | money |\n| ---: | ---: | ---: | ---: | ---: | ---: |")
        for n, row in zip(WORKERS, rows):
            ideal = rows[0]["seconds"] / n / row["seconds"]
            out(f"| {n} | {duration(row['seconds'])} | {100 * ideal:.0f} % | {size_text(row['bytes'])} | {number(row['requests'])} | {money(row['money'])} |")
    return curves


def remedies(costs, p, out):
    out("\n| job, workers | change | time | bytes | requests | money |\n| --- | --- | ---: | ---: | ---: | ---: |")

    def line(job, change, row):
        out(f"| {job} | {change} | {duration(row['seconds'])} | {size_text(row['bytes'])} | {number(row['requests'])} | {money(row['money'])} |")

    for look in ("opaque", "translucent"):
        for n in (64, 1024):
            name = f"8K {look}, {n}"
            line(name, "as it is", simulate_picture(costs, look, n, p))
            line(name, "cloud in 16 objects with prefixes of their own", simulate_picture(costs, look, n, replace(p, prefixes=16)))
            line(name, "a cache that all workers share", simulate_picture(costs, look, n, p, shared_cache=True))
            line(name, "look-ahead that reads what rays ask for, no more", simulate_picture(costs, look, n, p, exact=True))
            line(name, "stretches of 64 blocks", simulate_picture(costs, look, n, p, most=64))
            line(name, "pages of 256 KiB", simulate_picture(costs, look, n, replace(p, page_bytes=32768), pages_of_eight=True))
            line(name, "merged and encoded in bands, by up to 64", simulate_picture(costs, look, n, p, band_merge=True))
            line(name, "level of detail, four points a pixel", simulate_picture(costs, look, n, p, lod=True))
    for n in (64, 1024):
        name = f"flight opaque, {n}"
        line(name, "as it is", simulate_flight(costs, "opaque", n, p))
        line(name, "regions of the picture, not frames, to workers", simulate_flight(costs, "opaque", n, p, by_region=True))
        line(name, "cloud in 16 objects with prefixes of their own", simulate_flight(costs, "opaque", n, replace(p, prefixes=16)))
        line(name, "look-ahead that reads what rays ask for, no more", simulate_flight(costs, "opaque", n, p, exact=True))
        line(name, "regions, 16 objects and that", simulate_flight(costs, "opaque", n, replace(p, prefixes=16), by_region=True, exact=True))
        line(name, "level of detail, four points a pixel", simulate_flight(costs, "opaque", n, p, lod=True))
    for n in (64, 1024):
        name = f"build, {n}"
        line(name, "as it is", simulate_build(costs, n, p))
        line(name, "parts lay out their own pages", simulate_build(costs, n, p, merge_in_parts=True))
        line(name, "that, and 8192 parts and 50 GB/s of exchange", simulate_build(costs, n, replace(p, most_build_parts=8192, exchange=50e9), merge_in_parts=True))


def cloud(costs, p, out):
    opening = costs.opening()
    rates, skew, file_bytes = build_rates(costs.raw)
    a_pixel, a_part, bytes_a_pixel = costs.merge_rate()
    out("| of the cloud and the worker | |\n| --- | ---: |")
    for name, value in (
        ("file", size_text(opening["file_bytes"])),
        ("pages of 32 KiB", number(costs.all_pages())),
        ("node pages, all of them", size_text(opening["node_bytes"])),
        ("table of pages in a worker's memory, 28 bytes each", size_text(opening["table_bytes"])),
        ("pages that fit in a worker", number(cache_pages(costs, p))),
        ("until a worker begins", f"{opening['cpu_s']:.2f} s and {opening['round_trips']:.0f} round trips"),
        ("processor time for reading a page", f"{1e6 * costs.page_cpu():.0f} µs"),
        ("merge of a picture", f"{1e-6 / a_pixel:.1f} million pixels a second, and {1000 * a_part:.1f} ms a part"),
        *((f"build: {step}, one processor", f"{rate / 1e6:.1f} million points a second") for step, rate in rates.items()),
        ("build: most laborious of eight parts of `order`", f"{skew:.2f} of the mean"),
    ):
        out(f"| {name} | {value} |")


def models(costs, p, out):
    out("| picture | look | processor | pages asked for | of all | read, one worker | read, every block alone | requests a page |\n| --- | --- | ---: | ---: | ---: | ---: | ---: | ---: |")
    for read in costs.raw["reads"]:
        model, factor = costs.model(read["picture"], read["look"]), p.points / read["points"]
        whole, alone = read["whole"], read["alone"]
        again = (-(-read["size"][0] // 32) * -(-read["size"][1] // 32) - 1) * large_nodes(costs.raw)["node_pages"]
        out(f"| {read['picture']} | {read['look']} | {duration(model['cpu_s'] * factor)} | {number(model['pages'] * factor)} | {100 * model['pages'] * factor / costs.all_pages():.0f} % "
            f"| {size_text(whole['bytes'] * factor)} | {size_text((alone['bytes'] - again * p.page_bytes) * factor)} | {whole['requests'] / whole['unique']:.2f} to {alone['requests'] / alone['unique']:.2f} |")
    out("\nOne picture, 512×288, of more and more points:\n\n| look | points | processor | pages | of all |\n| --- | ---: | ---: | ---: | ---: |")
    for row in costs.raw["fixed"]:
        everything = {r["points"]: max(q["pages"] for q in costs.raw["fixed"] if q["points"] == r["points"]) for r in costs.raw["fixed"]}
        out(f"| {row['look']} | {number(row['points'])} | {row['cpu_s']:.2f} s | {row['pages']} | {100 * row['pages'] / everything[row['points']]:.0f} % |")


def skews(costs, p, out):
    out("| workers | opaque: processor | bytes | translucent: processor | bytes |\n| ---: | ---: | ---: | ---: | ---: |")
    for n in (4, 16, 64, 256, 1024):
        values = [value for look in ("opaque", "translucent") for value in simulate_picture(costs, look, n, p)["skew"]]
        out(f"| {n} | " + " | ".join(f"{value:.2f}" for value in values) + " |")


def throttling(costs, p, out):
    out("\n| workers | served a second | refused for each served | longest wait for an answer | given up, if refusals were failures |\n| ---: | ---: | ---: | ---: | ---: |")
    read = next(r for r in costs.raw["reads"] if r["picture"] == "8K" and r["look"] == "opaque")["whole"]
    for n in (1, 4, 8, 16, 32, 64, 256, 1024):
        seconds, size = (60.0 if n > 64 else 30.0), read["bytes"] / read["requests"]
        row, lost = refusals.paced(n, p, seconds, size=size), refusals.stubborn(n, p, seconds=10.0 if n > 64 else 20.0, size=size)
        assert row["longest_s"] < p.give_up_after
        out(f"| {n} | {row['served_s']:.0f} | {row['refused_a_request']:.2f} | {row['longest_s']:.1f} s | {100 * lost:.2g} % |")


def svg(curves, path):
    """Time against workers, both by logarithms; thin lines are what one worker would take, divided."""
    width, height, left, top, right, bottom = 820, 520, 74, 20, 250, 56
    colors = ["#0072b2", "#d55e00", "#009e73", "#cc79a7"]
    top_s = max(s for curve in curves.values() for _, s in curve) * 1.5
    low_s = min(s for curve in curves.values() for _, s in curve) / 4
    x = lambda n: left + (width - left - right) * math.log2(n) / 10
    y = lambda s: top + (height - top - bottom) * math.log(top_s / s) / math.log(top_s / low_s)
    lines = [f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" font-family="sans-serif" font-size="13">',
             f'<rect width="{width}" height="{height}" fill="white"/>']
    for n in WORKERS:
        lines.append(f'<path d="M{x(n):.1f} {top}V{height - bottom}" stroke="#e4e4e4"/><text x="{x(n):.1f}" y="{height - bottom + 18}" text-anchor="middle">{n}</text>')
    for seconds, label in ((1, "1 s"), (10, "10 s"), (60, "1 min"), (600, "10 min"), (3600, "1 h"), (36000, "10 h"), (86400 * 4, "4 days"), (86400 * 40, "40 days"), (86400 * 400, "400 days")):
        if low_s < seconds < top_s:
            lines.append(f'<path d="M{left} {y(seconds):.1f}H{width - right}" stroke="#e4e4e4"/><text x="{left - 8}" y="{y(seconds) + 4:.1f}" text-anchor="end">{label}</text>')
    ends = []
    for (name, curve), color in zip(curves.items(), colors):
        path_of = lambda points: "M" + "L".join(f"{x(n):.1f} {y(s):.1f}" for n, s in points)
        ideal = [(n, curve[0][1] / n) for n in WORKERS if curve[0][1] / n > low_s]
        lines.append(f'<path d="{path_of(ideal)}" fill="none" stroke="{color}" stroke-opacity=".35" stroke-dasharray="3 4"/>')
        lines.append(f'<path d="{path_of(curve)}" fill="none" stroke="{color}" stroke-width="2.2"/>')
        ends.append([y(curve[-1][1]), name, color])
    ends.sort()
    for at in range(1, len(ends)):
        ends[at][0] = max(ends[at][0], ends[at - 1][0] + 18)
    for at, name, color in ends:
        lines.append(f'<text x="{width - right + 10}" y="{at + 4:.1f}" fill="{color}">{name}</text>')
    lines.append(f'<text x="{(left + width - right) / 2}" y="{height - 12}" text-anchor="middle">workers of 8 processors</text></svg>')
    Path(path).write_text("\n".join(lines) + "\n")


# --- what can be run here


def exact_share(blocks, share, page_bytes):
    """Chunks of a share of a traced picture: the very pages, each read once, and joined as if all were asked for together."""
    from measure import joined

    held, fresh = set(), []
    for block in share:
        ns, pages = blocks.get(block, (0, ()))
        fresh.append((ns / 1e9, len(set(pages) - held)))
        held |= set(pages)
    requests, size = joined(held, page_bytes)
    count = max(1, len(held))
    return [(cpu, pages, requests * pages / count, size * pages / count) for cpu, pages in fresh]


def validate(costs, p, out):
    raw, worst = costs.raw, {}
    parts = raw["parts"]
    columns, rows = -(-parts["size"][0] // 32), -(-parts["size"][1] // 32)
    blocks = {(i, j): (ns, pages) for i, j, ns, pages in parts["blocks"]}
    page_cpu = costs.page_cpu()
    out("\nPages that parts read, all together:\n\n| parts | measured | of what one reads | from the traced pages | error | by the law of neighbours | error |\n| ---: | ---: | ---: | ---: | ---: | ---: | ---: |")
    # Every part reads all node pages at once. Of pages of points, what neighbours share is calibrated with the first row alone.
    nodes = next(r["node_pages"] for r in raw["scale_models"] if r["points"] == parts["points"])
    first_node = max(page for _, pages in blocks.values() for page in pages) + 1 - nodes
    points = {at: (ns, [page for page in pages if page < first_node]) for at, (ns, pages) in blocks.items()}
    one = sum(parts["measured"][0]["pages"])
    picture = Picture(columns, rows, {}, {at: len(pages) for at, (_, pages) in points.items()}, 0.0, (1, 1), 1)
    picture.shared = calibrated(picture, one - nodes)
    for row in parts["measured"]:
        shares = dealt(columns, rows, row["of"])
        exact = nodes * row["of"] + sum(c[1] for share in shares for c in exact_share(points, share, parts["page_bytes"]))
        law = nodes * row["of"] + sum(c[1] for share in shares for c in chunks(picture, share, 1e18, 0.0))
        measured = sum(row["pages"])
        error, law_error = exact / measured - 1, law / measured - 1
        worst["pages"] = max(worst.get("pages", 0), abs(error), abs(law_error))
        out(f"| {row['of']} | {measured} | {measured / one:.2f} | {exact:.0f} | {100 * error:+.1f} % | {law:.0f} | {100 * law_error:+.1f} % |")
    out("\nA picture from a remote object, one thread or two a process; two processes at a time:\n\n| parts | threads | latency | slowest part, measured | predicted | error | requests, measured | predicted |\n| ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: |")
    for row in raw["remote"]:
        if row["latency"] == 0:
            continue
        q = replace(p, threads=row["threads"], latency=row["latency"], network=1e12, connection=1e12, prefix_rate=1e12)
        shares = dealt(columns, rows, row["of"])
        work = [[(c + n * page_cpu, n, r, s) for c, n, r, s in exact_share(blocks, share, parts["page_bytes"])] for share in shares]
        total_cpu = sum(c[0] for w in work for c in w)
        total_pages = sum(c[1] for w in work for c in w)
        reach = window(total_cpu, total_pages, q, 1e9)
        done, requests, _ = run(work, q, reach, [q.latency * FIRST_ROUND_TRIPS] * row["of"])
        measured = max(r["seconds"] for r in row["runs"])
        predicted = max(done)
        error = predicted / measured - 1
        worst["remote"] = max(worst.get("remote", 0), abs(error))
        out(f"| {row['of']} | {row['threads']} | {1000 * row['latency']:.0f} ms | {measured:.3f} s | {predicted:.3f} s | {100 * error:+.0f} % | {sum(r['requests'] for r in row['runs']):.0f} | {requests:.0f} |")
    out("\nThe scale model: 10⁸ points, predicted from 10⁷ in a tenth of the pixels:\n\n| picture of 10¹¹ | look | processor, predicted / measured | pages, predicted / measured |\n| --- | --- | ---: | ---: |")
    for name in ("8K", "1080p"):
        for look in ("opaque", "translucent"):
            models = {r["points"]: r for r in raw["scale_models"] if r["picture"] == name and r["look"] == look}
            if 10**7 in models and 10**8 in models:
                cpu, pages = (10 * models[10**7][k] / models[10**8][k] for k in ("cpu_s", "pages"))
                out(f"| {name} | {look} | {cpu:.2f} | {pages:.2f} |")
    out("\nBuilds of 30 million points, predicted from the steps of 10 million in one part:\n\n| parts | step | measured | predicted | error |\n| ---: | --- | ---: | ---: | ---: |")
    base = next(r for r in raw["builds"] if r["of"] == 1)
    for row in raw["builds"]:
        if row["points"] == 30 * 10**6 and row["of"]:
            for step in ("read", "count", "scatter", "order", "merge"):
                measured = row["seconds"][step]
                measured = sum(measured) if isinstance(measured, list) else measured
                before = base["seconds"][step]
                predicted = (sum(before) if isinstance(before, list) else before) * row["points"] / base["points"]
                error = predicted / measured - 1
                worst["build"] = max(worst.get("build", 0), abs(error))
                out(f"| {row['of']} | {step} | {measured:.2f} s | {predicted:.2f} s | {100 * error:+.0f} % |")
    out("\nLargest errors: " + ", ".join(f"{k} {100 * v:.0f} %" for k, v in worst.items()) + ".")
    return worst


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("command", choices=["measure", "simulate", "validate", "check"])
    for option in ("program", "bench", "mesh", "data", "figure", "page"):
        parser.add_argument("--" + option)
    parser.add_argument("--only", nargs="*", help="of measure: only these")
    arguments = parser.parse_args()
    sys.path.insert(0, str(HERE))
    if arguments.command == "measure":
        import measure

        measure.Measurement(arguments.program, arguments.bench, arguments.data).everything(arguments.mesh, arguments.only)
        return
    if arguments.command == "check":
        import unittest

        unittest.main(module="test_simulate", argv=["check"])
        return
    p = Parameters()
    costs = Costs(json.loads((HERE / "costs.json").read_text()), p)
    sections, curves = {}, {}

    def section(name, report):
        lines = []
        found = report(costs, p, lines.append)
        sections[name] = "\n".join(lines).strip()
        print(sections[name] + "\n")
        return found

    if arguments.command == "validate":
        section("validation", validate)
    else:
        section("cloud", cloud)
        section("models", models)
        curves = section("tables", tables)
        section("remedies", remedies)
        section("throttling", throttling)
        section("skews", skews)
    if arguments.figure and curves:
        svg(curves, arguments.figure)
    if arguments.page:
        page = Path(arguments.page)
        text = page.read_text()
        for name, lines in sections.items():
            begin, end = f"<!-- {name} -->", f"<!-- end of {name} -->"
            before, _, rest = text.partition(begin)
            _, _, after = rest.partition(end)
            text = f"{before}{begin}\n{lines}\n{end}{after}"
        page.write_text(text)


if __name__ == "__main__":
    main()
