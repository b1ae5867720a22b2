#!/usr/bin/env python3
"""How near pictures of Gaussian splats are to those of `rasterise.py`, with the camera that rayset chooses.

    pip install numpy pillow
    cargo build --release
    benches/splats/compare.py target/release/rayset FOLDER CAPTURE.ply... shell fur haze

Captures are PLY files, or the names of made ones, which are written to FOLDER beside the pictures of both. For each
filter (without one, of two rays along each side of a pixel; with one, of one): the peak signal-to-noise ratio of display
values in decibels, of all pixels and of those on which either shows anything.
"""

import argparse
import json
import os
import subprocess

import numpy as np
from PIL import Image

import captures
import rasterise

FILTERS = ("none", "3dgs", "mip")
MADE = ("shell", "fur", "haze")


def camera(scene):
    """The camera of a scene that rayset wrote."""
    with open(scene) as file:
        scene = json.load(file)
    of, size = scene["camera"], scene["image"]["size"]
    position = np.array(of["position"])
    return rasterise.Camera(position, position + of["direction"], np.array(of["up"]), of["fovy"], size)


def decibels(a, b, of):
    error = np.mean((a[of].astype(float) - b[of]) ** 2)
    return 10 * np.log10(255**2 / error) if error > 0 else np.inf


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("program")
    parser.add_argument("folder")
    parser.add_argument("captures", nargs="+")
    parser.add_argument("--size", default="480x320")
    parser.add_argument("--option", action="append", default=[], help="another option of `rayset render`, as --option=--samples=1")
    given = parser.parse_args()
    print("| capture | " + " | ".join(f"{name}, all; object" for name in FILTERS) + " |")
    print("| --- |" + " ---: |" * len(FILTERS))
    for capture in given.captures:
        name = os.path.basename(capture).removesuffix(".ply")
        path = lambda end: os.path.join(given.folder, f"{name}{end}")
        if capture in MADE:
            capture = path(".ply")
            captures.write(capture, captures.made(name))
        splats, cells = captures.read(capture), []
        for low_pass in FILTERS:
            rays = 2 if low_pass == "none" else 1
            shot, scene = path(f"-{low_pass}-rayset.png"), path(f"-{low_pass}.json")
            if os.path.exists(scene):
                os.remove(scene)
            command = [given.program, "render", capture, "-o", shot, "--size", given.size, "--write-scene", scene]
            command += [f"--samples={rays}", f"--splat-filter={low_pass}", *given.option]
            subprocess.run(command, check=True, capture_output=True)
            ours = np.asarray(Image.open(shot).convert("RGB"))
            theirs = rasterise.display(rasterise.rasterise(splats, camera(scene), low_pass, samples=rays))
            Image.fromarray(theirs).save(path(f"-{low_pass}.png"))
            shown = np.maximum(ours, theirs).max(axis=2) > 0
            cells.append(f"{decibels(ours, theirs, np.ones_like(shown)):.1f}; {decibels(ours, theirs, shown):.1f}")
        print(f"| {name} | " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main()
