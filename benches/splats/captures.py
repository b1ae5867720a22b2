"""Gaussian splats of PLY files, read from the description of their formats alone.

INRIA's layout (`f_dc_*`, `f_rest_*`, `opacity` before the logistic function, logarithms of deviations, rotations w x y z)
and PlayCanvas's compressed one (every 256 vertices share the bounds of a chunk).
"""

from dataclasses import dataclass

import numpy as np

# Of the spherical harmonic of degree 0.
C0 = 0.28209479177387814
TYPES = {"float": "<f4", "double": "<f8", "uint": "<u4", "int": "<i4", "uchar": "u1", "ushort": "<u2"}


@dataclass
class Splats:
    """N Gaussians."""

    # N x 3, in the units of the file.
    position: np.ndarray
    # N x 3 standard deviations along the axes of each.
    deviation: np.ndarray
    # N x 3 x 3: columns are these axes.
    rotation: np.ndarray
    # N, at the centre.
    opacity: np.ndarray
    # N x K x 3 coefficients of spherical harmonics, of display values less a half.
    harmonics: np.ndarray


def rotations(quaternion):
    """The matrices of quaternions w, x, y, z of any length."""
    w, x, y, z = (quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True)).T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), 2, 0)


def elements(path):
    """The tables of a binary little-endian PLY file by their names."""
    with open(path, "rb") as file:
        data = file.read()
    end = data.index(b"end_header\n") + len(b"end_header\n")
    tables, kinds = {}, {}
    for line in data[:end].decode().splitlines():
        word = line.split()
        if word[:1] == ["format"] and word[1] != "binary_little_endian":
            raise SystemExit(f"{path}: {word[1]}; expected binary_little_endian")
        if word[:1] == ["element"]:
            kinds[word[1]] = (int(word[2]), [])
        if word[:1] == ["property"]:
            kinds[list(kinds)[-1]][1].append((word[2], TYPES[word[1]]))
    for name, (count, columns) in kinds.items():
        tables[name] = np.frombuffer(data, np.dtype(columns), count, end)
        end += tables[name].nbytes
    return tables


def columns(table, names):
    return np.stack([table[name].astype(float) for name in names], axis=1)


def read(path):
    tables = elements(path)
    return packed(tables) if "chunk" in tables else plain(tables["vertex"])


def plain(vertex):
    count = len(vertex)
    dc = columns(vertex, ["f_dc_0", "f_dc_1", "f_dc_2"])[:, None, :]
    rest = [name for name in vertex.dtype.names if name.startswith("f_rest_")]
    # All of red, then all of green, then all of blue.
    others = columns(vertex, [f"f_rest_{i}" for i in range(len(rest))]) if rest else np.zeros((count, 0))
    others = others.reshape(count, 3, -1).swapaxes(1, 2)
    return Splats(
        position=columns(vertex, "xyz"),
        deviation=np.exp(columns(vertex, ["scale_0", "scale_1", "scale_2"])),
        rotation=rotations(columns(vertex, ["rot_0", "rot_1", "rot_2", "rot_3"])),
        opacity=1 / (1 + np.exp(-vertex["opacity"].astype(float))),
        harmonics=np.concatenate([dc, others], axis=1),
    )


def packed(tables):
    vertex, chunk = tables["vertex"], tables["chunk"][np.arange(len(tables["vertex"])) // 256]

    def fraction(word, shift, bits):
        return (word >> shift & (1 << bits) - 1) / ((1 << bits) - 1)

    def within(low, high, fractions):
        low, high = columns(chunk, low), columns(chunk, high)
        return low * (1 - fractions) + high * fractions

    def three(word):
        return np.stack([fraction(word, 21, 11), fraction(word, 11, 10), fraction(word, 0, 11)], axis=1)

    color = np.stack([fraction(vertex["packed_color"], shift, 8) for shift in (24, 16, 8)], axis=1)
    if "min_r" in chunk.dtype.names:
        color = within(["min_r", "min_g", "min_b"], ["max_r", "max_g", "max_b"], color)
    word = vertex["packed_rotation"]
    small = np.stack([(fraction(word, shift, 10) - 0.5) * np.sqrt(2) for shift in (20, 10, 0)], axis=1)
    largest = np.sqrt(np.maximum(0, 1 - (small * small).sum(axis=1)))
    quaternion = np.zeros((len(vertex), 4))
    for which in range(4):
        these = word >> 30 == which
        quaternion[these] = np.insert(small[these], which, largest[these], axis=1)
    axes = ("x", "y", "z")
    scales = within([f"min_scale_{a}" for a in axes], [f"max_scale_{a}" for a in axes], three(vertex["packed_scale"]))
    return Splats(
        position=within([f"min_{a}" for a in axes], [f"max_{a}" for a in axes], three(vertex["packed_position"])),
        deviation=np.exp(scales),
        rotation=rotations(quaternion),
        opacity=fraction(vertex["packed_color"], 0, 8),
        harmonics=((color - 0.5) / C0)[:, None, :],
    )


def write(path, splats):
    """Writes INRIA's layout."""
    rest = splats.harmonics.shape[1] - 1
    names = ["x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2"] + [f"f_rest_{i}" for i in range(3 * rest)]
    names += ["opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"]
    logit = np.log(splats.opacity / (1 - splats.opacity))[:, None]
    others = splats.harmonics[:, 1:].swapaxes(1, 2).reshape(len(logit), -1)
    parts = [splats.position, splats.harmonics[:, 0], others, logit, np.log(splats.deviation), quaternions(splats.rotation)]
    head = "".join(f"property float {name}\n" for name in names)
    with open(path, "wb") as file:
        file.write(f"ply\nformat binary_little_endian 1.0\nelement vertex {len(logit)}\n{head}end_header\n".encode())
        file.write(np.concatenate(parts, axis=1).astype("<f4").tobytes())


def quaternions(rotation):
    """Quaternions w, x, y, z of rotations by less than half a turn, as `made` has them."""
    w = np.sqrt(np.maximum(1e-12, 1 + np.trace(rotation, axis1=1, axis2=2))) / 2
    pairs = ((2, 1), (0, 2), (1, 0))
    return np.stack([w] + [(rotation[:, i, j] - rotation[:, j, i]) / (4 * w) for i, j in pairs], axis=1)


def made(name, count=4000):
    """One of three captures that are made: `shell`, `fur`, `haze`."""
    random = np.random.default_rng(7)
    position = random.normal(size=(count, 3))
    position /= np.linalg.norm(position, axis=1, keepdims=True)
    quaternion = random.normal(size=(count, 4))
    quaternion[:, 0] = 1 + np.abs(quaternion[:, 0])
    harmonics = np.zeros((count, 4, 3))
    harmonics[:, 0] = random.uniform(-1.2, 1.5, size=(count, 3))
    if name == "shell":
        # Discs that touch a ball, opaque, as surfaces are trained: the last axis is turned to the normal.
        deviation, opacity = np.tile([0.05, 0.04, 0.002], (count, 1)), random.uniform(0.6, 0.995, count)
        rotation = facing(position)
        harmonics[:, 1:] = random.normal(scale=0.2, size=(count, 3, 3))
    elif name == "fur":
        # Needles along normals.
        position *= random.uniform(0.9, 1.1, size=(count, 1))
        deviation, opacity = np.tile([0.01, 0.01, 0.08], (count, 1)), random.uniform(0.3, 0.99, count)
        rotation = facing(position)
    elif name == "haze":
        # Wide and thin, all through each other.
        position *= random.uniform(0, 1, size=(count, 1)) ** (1 / 3)
        deviation, opacity = np.exp(random.uniform(-4, -1.5, size=(count, 3))), random.uniform(0.01, 0.3, count)
        rotation = rotations(quaternion)
    else:
        raise SystemExit(f"{name}: no made capture; expected shell, fur or haze")
    return Splats(position, deviation, rotation, opacity, harmonics)


def facing(direction):
    """Rotations, by less than half a turn, that take the z axis to directions of any length."""
    z = direction / np.linalg.norm(direction, axis=1, keepdims=True)
    z = np.where(z[:, 2:] < -0.99, -z, z)
    # Half of the way there is the axis of half a turn; the quaternion is (1 + cos, cross product).
    quaternion = np.stack([1 + z[:, 2], -z[:, 1], z[:, 0], np.zeros(len(z))], axis=1)
    return rotations(quaternion)
