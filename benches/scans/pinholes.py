#!/usr/bin/env python3
"""Counts pinholes of surfaces in the pictures of a turntable: places of at most five pixels square, in the midst of a
surface, where rays pass through it to what lies far behind.

    pip install numpy scipy OpenEXR
    cargo build --release
    benches/scans/pinholes.py target/release/rayset FOLDER "bun_zipper.ply --mesh-points 1000000" lucy.ply

Behind an input may stand options of `rayset render`. A place is far behind if it is deeper than all around it by a
twentieth of the object's extent in depth, or shows nothing.
"""

import argparse
import os
import shlex
import subprocess

import numpy as np
import OpenEXR
from scipy import ndimage

FRAMES = 8
PIXELS = 5


def pinholes(path):
    """The middles of pinholes in a picture, as rows and columns: those that show the background, and all of them."""
    layers = OpenEXR.File(path).channels()
    depth, opacity = layers["depth.Z"].pixels, layers["opacity.Y"].pixels
    surface = opacity >= 0.5
    if not surface.any():
        return [], []
    nearest, farthest = depth[surface].min(), depth[surface].max()
    far = (farthest - nearest) / 20
    depth = np.where(surface, depth, farthest + (farthest - nearest))
    # What is deep and thin stands out of the deepest squares that fit into what is around it.
    deep = depth - ndimage.grey_opening(depth, size=(PIXELS + 1, PIXELS + 1)) > far
    labels, _ = ndimage.label(deep, np.ones((3, 3)))
    seen_through, found = [], []
    for i, (rows, columns) in enumerate(ndimage.find_objects(labels), 1):
        around = (slice(max(rows.start - 1, 0), rows.stop + 1), slice(max(columns.start - 1, 0), columns.stop + 1))
        own = labels[around] == i
        # Slits and silhouettes are deep beyond the place, too.
        ring = ndimage.binary_dilation(own, np.ones((3, 3))) & ~own
        is_inside = 0 < rows.start and rows.stop < depth.shape[0] and 0 < columns.start and columns.stop < depth.shape[1]
        is_small = is_inside and max(rows.stop - rows.start, columns.stop - columns.start) <= PIXELS
        if is_small and (depth[around][ring] < depth[around][own].min() - far).all():
            middle = ((rows.start + rows.stop) // 2, (columns.start + columns.stop) // 2)
            found.append(middle)
            if not surface[around][own].all():
                seen_through.append(middle)
    return seen_through, found


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("program")
    parser.add_argument("folder")
    parser.add_argument("inputs", nargs="+")
    parser.add_argument("--size", default="960x640")
    given = parser.parse_args()
    print(f"| input | places of background in {FRAMES} frames | pinholes in each |\n| --- | ---: | --- |")
    for given_input in given.inputs:
        path, *options = shlex.split(given_input)
        frames = os.path.join(given.folder, "frame.exr")
        command = [given.program, "render", path, "-o", frames, "--turntable", str(FRAMES), "--size", given.size]
        subprocess.run(command + options, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        background, counts = 0, []
        for frame in range(FRAMES):
            seen_through, found = pinholes(os.path.join(given.folder, f"frame.{frame:04}.exr"))
            background += len(seen_through)
            counts.append(f"{len(found)}" + (f" (at {found[0][1]}, {found[0][0]})" if found else ""))
        print(f"| {os.path.basename(path)} {' '.join(options)} | {background} | {'; '.join(counts)} |", flush=True)


if __name__ == "__main__":
    main()
