#!/usr/bin/env python3
"""How near pictures of Gaussian splats are to those of Mitsuba 3 (`ellipsoids`, `volprim_rf_basic`), without a filter.

    pip install mitsuba numpy pillow scipy
    DRJIT_LIBLLVM_PATH=…/libLLVM.so benches/splats/volprim.py target/release/rayset FOLDER CAPTURE.ply... shell fur haze

Captures are as for `compare.py`, the camera is the one that rayset chooses. Both have two rays along each side of a pixel.
Mitsuba composites, in display values, what each ray meets of all ellipsoids of so many deviations, in the order in which
rays enter these, where rayset and rasterisers go by the place of the largest response. Prints the peak signal-to-noise
ratio of display values in decibels, of all pixels and of those on which either shows anything, and seconds of both.
"""

import argparse
import os
import subprocess
import time

import mitsuba
import numpy as np
from PIL import Image
from scipy.spatial.transform import Rotation

import captures
import rasterise
from compare import MADE, camera, decibels

mitsuba.set_variant("llvm_ad_rgb")
# Deviations at which ellipsoids end: there even the densest absorb less than 1/512.
EXTENT = 3.54
SIDE = 2


def scene_of(splats, view):
    count = len(splats.position)
    quaternions = Rotation.from_matrix(splats.rotation).as_quat()
    data = np.hstack([splats.position, splats.deviation, quaternions]).astype(np.float32)
    harmonics = splats.harmonics.reshape(count, -1).astype(np.float32)
    width, height = view.size
    look = mitsuba.ScalarTransform4f().look_at(
        origin=list(view.position), target=list(view.position + view.forward), up=list(view.up)
    )
    fovy = np.degrees(2 * np.arctan(height / 2 / view.focal))
    return mitsuba.load_dict({
        "type": "scene",
        "integrator": {"type": "volprim_rf_basic", "max_depth": 2000},
        "sensor": {
            "type": "perspective", "fov": float(fovy), "fov_axis": "y", "to_world": look, "near_clip": 1e-3,
            "film": {"type": "hdrfilm", "width": width, "height": height, "rfilter": {"type": "box"}, "pixel_format": "rgb"},
            "sampler": {"type": "stratified", "sample_count": SIDE * SIDE, "jitter": False},
        },
        "splats": {
            "type": "ellipsoids", "data": mitsuba.TensorXf(data), "extent": EXTENT,
            "opacities": mitsuba.TensorXf(splats.opacity.astype(np.float32)[:, None]),
            "sh_coeffs": mitsuba.TensorXf(harmonics),
        },
    })


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("program")
    parser.add_argument("folder")
    parser.add_argument("captures", nargs="+")
    parser.add_argument("--size", default="480x320")
    given = parser.parse_args()
    print("| capture | all; object | seconds: rayset | Mitsuba |\n| --- | ---: | ---: | ---: |")
    for capture in given.captures:
        name = os.path.basename(capture).removesuffix(".ply")
        path = lambda end: os.path.join(given.folder, f"{name}{end}")
        if capture in MADE:
            capture = path(".ply")
            captures.write(capture, captures.made(name))
        shot, document = path("-rayset.png"), path(".json")
        if os.path.exists(document):
            os.remove(document)
        command = [given.program, "render", capture, "-o", shot, "--size", given.size, f"--samples={SIDE}"]
        for more in (["--write-scene", document], []):
            begun = time.monotonic()
            subprocess.run(command + ["--splat-filter=none", *more], check=True, capture_output=True)
            ours_took = time.monotonic() - begun
        scene = scene_of(captures.read(capture), camera(document))
        for _ in range(2):
            begun = time.monotonic()
            light = np.array(mitsuba.render(scene, seed=1))
            theirs_took = time.monotonic() - begun
        ours = np.asarray(Image.open(shot).convert("RGB"))
        theirs = np.asarray(mitsuba.Bitmap(light.astype(np.float32)).convert(mitsuba.Bitmap.PixelFormat.RGB, mitsuba.Struct.Type.UInt8, True))
        Image.fromarray(theirs).save(path("-mitsuba.png"))
        shown = np.maximum(ours, theirs).max(axis=2) > 0
        cells = f"{decibels(ours, theirs, np.ones_like(shown)):.1f}; {decibels(ours, theirs, shown):.1f}"
        print(f"| {name} | {cells} | {ours_took:.2f} | {theirs_took:.2f} |", flush=True)


if __name__ == "__main__":
    main()
