#!/usr/bin/env python3
"""Whether anything grows: `benches/viewer/soak.py RAYSET FILE [--memory 128MiB] [--minutes 10]`.

Three pages fly for some minutes while a fourth connects and goes, a hundred times. Prints the memory of the program now and then, and
fails if its peak is above --memory, or if the second half of the time needs more than the first. Needs: pip install playwright; Debian's
chromium.
"""
import argparse
import os
import pathlib
import re
import shutil
import subprocess
import sys
import tempfile
import time

from playwright.sync_api import sync_playwright

FLY = """() => import("./camera.js").then(({ orbit }) => {
    const step = () => {
        rayset.view.camera = orbit(rayset.view.camera, 0.01, 0);
        // Now and then it rests, and is traced in full.
        setTimeout(() => requestAnimationFrame(step), Math.random() < 0.01 ? 3000 : 0);
    };
    step();
})"""
RECONNECTIONS = 100


def memory(pid, what):
    return int(re.search(rf"{what}:\s+(\d+) kB", pathlib.Path(f"/proc/{pid}/status").read_text())[1]) / 1024


def main():
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("program")
    arguments.add_argument("file")
    arguments.add_argument("--memory", type=int, default=128, help="MiB")
    arguments.add_argument("--minutes", type=float, default=10)
    given = arguments.parse_args()
    environment = {**os.environ, "XDG_STATE_HOME": tempfile.mkdtemp()}
    server = subprocess.Popen([given.program, "view", given.file, "--no-open", "--memory", f"{given.memory}MiB"],
                              stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, stdin=subprocess.DEVNULL, text=True, env=environment)
    address = server.stdout.readline().strip()
    rss = []
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
        context = browser.new_context(viewport={"width": 1000, "height": 560})

        def opened(where):
            page = context.new_page()
            debugger = context.new_cdp_session(page)
            page.goto(where)
            until = time.time() + 300

            def evaluate(text):
                asked = {"expression": text, "returnByValue": True, "awaitPromise": True}
                return debugger.send("Runtime.evaluate", asked)["result"].get("value")
            while not evaluate("Boolean(window.rayset?.view.scene)"):
                assert time.time() < until, "no scene"
                time.sleep(0.02)
            return page, evaluate

        first, evaluate = opened(address)
        root = address[:address.index("?")]
        others = [opened(root) for _ in range(2)]
        for each in [evaluate, *(other[1] for other in others)]:
            each(f"({FLY})()")
        begin, seconds = time.time(), given.minutes * 60
        for connection in range(RECONNECTIONS):
            page, look = opened(root)
            look("new Promise((done) => rayset.view.addEventListener('frame', () => done(1), { once: true }))")
            page.close()
            rss.append(memory(server.pid, "VmRSS"))
            if connection % 10 == 0:
                print(f"{time.time() - begin:.0f} s: {rss[-1]:.1f} MiB, peak {memory(server.pid, 'VmHWM'):.1f}", flush=True)
            time.sleep(max(0, begin + seconds * (connection + 1) / RECONNECTIONS - time.time()))
        peak = memory(server.pid, "VmHWM")
        browser.close()
    server.terminate()
    server.wait(20)
    half = len(rss) // 2
    before, after = max(rss[half // 4:half]), max(rss[half:])
    print(f"peak {peak:.1f} of {given.memory} MiB; largest of the first half {before:.1f}, of the second {after:.1f}")
    return 0 if peak <= given.memory and after <= before + 1 else 1


if __name__ == "__main__":
    sys.exit(main())
