#!/usr/bin/env python3
"""How far shading vectors are from the normals of a mesh, of which a tenth of the vertices is drawn as points.

    pip install numpy scipy plyfile OpenEXR
    cargo build --release
    benches/scans/shading.py target/release/rayset FOLDER bun_zipper.ply lucy.ply

For each mesh, the root mean square of the angle in degrees over all pixels of eight frames of a turntable whose opacity
is at least a half, and in brackets that of all but a hundredth of them: for points alone, and for points with normals,
the means of their faces. The true normal of a pixel is that of the place on the mesh that is nearest to what the picture
shows there, interpolated between the vertices. Pixels of which that is farther than three spacings are left out; how many
is said.
"""

import argparse
import json
import os
import subprocess

import numpy as np
import OpenEXR
from plyfile import PlyData
from scipy.spatial import cKDTree

FRAMES = 8


def mesh(path):
    """Vertices, triangles, normals of vertices, and the area of all."""
    data = PlyData.read(path)
    vertices = np.stack([data["vertex"][axis] for axis in "xyz"], axis=1).astype(float)
    faces = np.stack(data["face"].data[data["face"].data.dtype.names[0]]).astype(int)
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    across = np.cross(b - a, c - a)
    normals = np.zeros_like(vertices)
    for corner in range(3):
        np.add.at(normals, faces[:, corner], across)
    area = 0.5 * np.linalg.norm(across, axis=1).sum()
    return vertices, faces, normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30), area


def write(path, columns):
    """A PLY file of points."""
    names = ["x", "y", "z", "nx", "ny", "nz"][: columns.shape[1]]
    with open(path, "wb") as file:
        header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(columns)}"]
        header += [f"property float {name}" for name in names] + ["end_header", ""]
        file.write("\n".join(header).encode() + columns.astype("<f4").tobytes())


def rays(camera, size):
    """Origin and directions of the rays through the centres of pixels."""
    width, height = size
    forward = np.array(camera["direction"]) / np.linalg.norm(camera["direction"])
    right = np.cross(forward, camera["up"])
    right /= np.linalg.norm(right)
    up, tangent = np.cross(right, forward), np.tan(np.radians(camera["fovy"]) / 2)
    x = (2 * (np.arange(width) + 0.5) / width - 1) * tangent * width / height
    y = (1 - 2 * (np.arange(height) + 0.5) / height) * tangent
    directions = forward + x[None, :, None] * right + y[:, None, None] * up
    return np.array(camera["position"]), directions / np.linalg.norm(directions, axis=2, keepdims=True)


def frame(program, points, folder, camera, size):
    """Depth, opacity and shading vectors of a picture of points."""
    scene, shot = os.path.join(folder, "shot.json"), os.path.join(folder, "shot.exr")
    with open(points) as file:
        document = json.load(file)
    document["camera"] = camera
    with open(scene, "w") as file:
        json.dump(document, file)
    subprocess.run([program, "render", scene, "-o", shot, "--samples=1"], check=True, capture_output=True)
    layers = OpenEXR.File(shot).channels()
    normal = np.stack([layers[f"normal.{axis}"].pixels for axis in "XYZ"], axis=2)
    return layers["depth.Z"].pixels, layers["opacity.Y"].pixels, normal


def turned(camera, center, angle):
    """A camera turned about an axis through a place, along its up direction."""
    up = np.array(camera["up"]) / np.linalg.norm(camera["up"])
    cos, sin = np.cos(angle), np.sin(angle)
    turn = lambda v: v * cos + np.cross(up, v) * sin + up * (up @ v) * (1 - cos)
    position = center + turn(np.array(camera["position"]) - center)
    return {**camera, "position": list(position), "direction": list(turn(np.array(camera["direction"])))}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("program")
    parser.add_argument("folder")
    parser.add_argument("meshes", nargs="+")
    parser.add_argument("--size", default="480x320")
    parser.add_argument("--part", type=int, default=10, help="one of so many vertices is a point")
    parser.add_argument("--option", action="append", default=[], help="another option of `rayset render`, as --option=--shape=round")
    given = parser.parse_args()
    print("| mesh | points alone | points with normals |\n| --- | ---: | ---: |")
    for path in given.meshes:
        vertices, faces, normals, area = mesh(path)
        some = np.random.default_rng(1).permutation(len(vertices))[: len(vertices) // given.part]
        spacing = np.sqrt(area / len(some))
        # Places on the mesh, far closer than points are.
        count, random = 2_000_000, np.random.default_rng(2)
        a, b, c = (vertices[faces[:, corner]] for corner in range(3))
        shares = np.linalg.norm(np.cross(b - a, c - a), axis=1)
        triangle = random.choice(len(faces), count, p=shares / shares.sum())
        u, v = random.random((2, count))
        u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
        between = np.stack([1 - u - v, u, v], axis=1)
        at = lambda of: sum(between[:, corner, None] * of[faces[triangle, corner]] for corner in range(3))
        places, directions = at(vertices), at(normals)
        tree, cells = cKDTree(places), []
        for columns in (vertices[some], np.hstack([vertices[some], normals[some]])):
            points, scene = os.path.join(given.folder, "points.ply"), os.path.join(given.folder, "points.json")
            write(points, columns)
            if os.path.exists(scene):
                os.remove(scene)
            command = [given.program, "render", points, "-o", os.path.join(given.folder, "first.png"), "--size", given.size]
            subprocess.run(command + ["--write-scene", scene, *given.option], check=True, capture_output=True)
            with open(scene) as file:
                document = json.load(file)
            size, center = document["image"]["size"], (vertices.min(axis=0) + vertices.max(axis=0)) / 2
            found, pixels = [], 0
            for k in range(FRAMES):
                camera = turned(document["camera"], center, 2 * np.pi * k / FRAMES)
                depth, opacity, shading = frame(given.program, scene, given.folder, camera, size)
                origin, toward = rays(camera, size)
                shown = opacity >= 0.5
                place = origin + toward[shown] * depth[shown][:, None]
                distance, nearest = tree.query(place)
                near = distance < 3 * spacing
                pixels += len(near)
                normal = directions[nearest[near]]
                cos = np.abs((shading[shown][near] * normal).sum(axis=1)) / np.linalg.norm(normal, axis=1)
                found.append(np.degrees(np.arccos(np.clip(cos, 0, 1))))
            angles = np.sort(np.concatenate(found))
            rms = lambda of: np.sqrt(np.mean(of**2))
            left_out = 100 * (1 - len(angles) / pixels)
            cells.append(f"{rms(angles):.1f}° ({rms(angles[: len(angles) * 99 // 100]):.1f}°), {left_out:.2f} % left out")
        print(f"| {os.path.basename(path)} | " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main()
