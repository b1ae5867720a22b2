#!/usr/bin/env python3
"""What a flight in the viewer is like: `benches/viewer/flight.py RAYSET FILE [--memory 256MiB] [--seconds 60]`.

Opens FILE in Chromium, 1280x720, on the machine that traces, and flies a recorded path: turning at changing speed, nearer and farther,
sideways. Prints medians and 95th percentiles as a line of a table (docs/benchmarks.md, "Looking around"). Needs: pip install
playwright; Debian's chromium.
"""
import argparse
import os
import pathlib
import re
import shutil
import statistics
import subprocess
import sys
import tempfile
import time

from playwright.sync_api import sync_playwright

FLY = """(seconds) => import("./camera.js").then(({ orbit, zoom, pan }) => new Promise((done) => {
    const view = rayset.view;
    const log = { asked: [], traced: [], ages: [], sizes: [], drawn: [], rests: [] };
    view.addEventListener("frame", ({ detail }) => {
        const now = performance.now();
        if (detail.milliseconds !== null) log.ages.push(detail.milliseconds);
        log.traced.push(now);
        log.drawn.push(now);
        log.sizes.push(detail.width * detail.height);
    });
    view.addEventListener("reprojected", () => log.drawn.push(performance.now()));
    const start = performance.now();
    let last = start;
    const step = (now) => {
        const [t, dt] = [(now - start) / 1000, Math.min((now - last) / 1000, 0.1)];
        last = now;
        if (t > seconds) return done(log);
        let camera = orbit(view.camera, dt * (0.6 + 0.5 * Math.sin(t / 3)), 0.15 * dt * Math.sin(t / 5));
        camera = zoom(camera, Math.exp(0.12 * dt * Math.sin(t / 4)), 0.2 * Math.sin(t), 0, 16 / 9);
        camera = pan(camera, 0.02 * dt * Math.sin(t / 2), 0);
        log.asked.push(now);
        view.camera = camera;
        requestAnimationFrame(step);
    };
    requestAnimationFrame(step);
}))"""


def part(values, fraction):
    return sorted(values)[min(int(fraction * len(values)), len(values) - 1)] if values else float("nan")


class Flight:
    """A server, and a page that looks at it."""

    def __init__(self, program, file, memory, playwright):
        self.folder = tempfile.TemporaryDirectory()
        environment = {**os.environ, "XDG_STATE_HOME": self.folder.name}
        self.server = subprocess.Popen([program, "view", file, "--no-open", "--memory", memory], stdout=subprocess.PIPE,
                                       stderr=subprocess.DEVNULL, stdin=subprocess.DEVNULL, text=True, env=environment)
        address = self.server.stdout.readline().strip()
        self.browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
        self.context = self.browser.new_context(viewport={"width": 1280, "height": 720})
        self.page = self.context.new_page()
        self.page.add_init_script("""window.addEventListener("DOMContentLoaded", () => {
            const wait = () => window.rayset ? rayset.view.addEventListener("frame",
                () => (window.firstFrame ??= performance.now())) : setTimeout(wait, 1);
            wait();
        });""")
        self.debugger = self.context.new_cdp_session(self.page)
        self.page.goto(address)
        # What has not been built is built first, which is no part of a flight.
        self.wait("window.rayset?.view.scene", 1800)

    def evaluate(self, expression):
        asked = {"expression": expression, "returnByValue": True, "awaitPromise": True}
        answer = self.debugger.send("Runtime.evaluate", asked)
        assert "exceptionDetails" not in answer, answer["exceptionDetails"]
        return answer["result"].get("value")

    def wait(self, condition, seconds=120):
        until = time.time() + seconds
        while not self.evaluate(f"Boolean({condition})"):
            assert time.time() < until, condition
            time.sleep(0.01)

    def peak_mib(self):
        status = pathlib.Path(f"/proc/{self.server.pid}/status").read_text()
        return int(re.search(r"VmHWM:\s+(\d+) kB", status)[1]) / 1024

    def end(self):
        self.browser.close()
        self.server.terminate()
        self.server.wait(20)


def main():
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("program")
    arguments.add_argument("file")
    arguments.add_argument("--memory", default="256MiB")
    arguments.add_argument("--seconds", type=float, default=60)
    arguments.add_argument("--screenshot")
    given = arguments.parse_args()
    with sync_playwright() as playwright:
        flight = Flight(str(pathlib.Path(given.program).resolve()), given.file, given.memory, playwright)
        # The first picture of a page, from when its address was opened: with its files in the browser's hands as yet nowhere.
        first = []
        for _ in range(5):
            flight.page.reload()
            flight.wait("window.firstFrame")
            first.append(flight.evaluate("firstFrame"))
            flight.wait("rayset.view.isConverged")
        log = flight.evaluate(f"({FLY})({given.seconds})")
        rests = []
        for turn in range(3):
            flight.wait("rayset.view.isConverged")
            rests.append(float(re.search(r"[0-9.]+", flight.evaluate("document.getElementById('status').textContent"))[0]))
            flight.evaluate("import('./camera.js').then(({ orbit }) => void (rayset.view.camera = orbit(rayset.view.camera, 0.3, 0)))")
            time.sleep(0.3)
        if given.screenshot:
            flight.wait("rayset.view.isConverged")
            flight.page.screenshot(path=given.screenshot)
        peak = flight.peak_mib()
        flight.end()
    drawn, waits, at = log["drawn"], [], 0
    for asked in log["asked"]:
        while at < len(drawn) and drawn[at] < asked:
            at += 1
        if at < len(drawn):
            waits.append(drawn[at] - asked)
    gaps = [b - a for a, b in zip(log["traced"], log["traced"][1:])]
    rays = statistics.median(log["sizes"])
    print(f"| {pathlib.Path(given.file).name} | {statistics.median(first):.0f} | {statistics.median(waits):.0f} / {part(waits, 0.95):.0f} "
          f"| {statistics.median(log['ages']):.0f} / {part(log['ages'], 0.95):.0f} | {len(log['traced']) / given.seconds:.1f} / "
          f"{1000 / part(gaps, 0.95):.1f} | {rays / 1000:.0f} k | {statistics.median(rests):.1f} | {peak:.0f} |")


if __name__ == "__main__":
    sys.exit(main())
