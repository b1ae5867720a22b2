#!/usr/bin/env python3
"""A rasteriser of Gaussian splats to compare with: NumPy, slow, from the formulas alone.

    pip install numpy pillow
    benches/splats/rasterise.py CAPTURE.ply -o PICTURE.png --position 1,2,3 --look-at 0,0,0 --up 0,0,1 --fovy 35

A ray that passes a Gaussian of opacity o at the least distance b, in deviations, meets alpha = o exp(-b^2/2) there. What
meets less than 1/512 is left out. The others are composited front to back, in the order of where on the ray they are
nearest, in display values; colours are spherical harmonics of the direction from the eye to the centre. `--filter 3dgs`
widens each Gaussian by 0.3 square pixels at the depth of its centre, as it was trained; `mip` by 0.1, with less opacity.
"""

import argparse

import numpy as np
from PIL import Image

import captures

LEAST = 1 / 512
# Side of a tile, in pixels.
TILE = 16


def vector(text):
    return np.array([float(part) for part in text.split(",")])


class Camera:
    """A pinhole: `fovy` degrees over the height."""

    def __init__(self, position, look_at, up, fovy, size):
        self.position, self.size = position, size
        self.forward = (look_at - position) / np.linalg.norm(look_at - position)
        right = np.cross(self.forward, up)
        self.right = right / np.linalg.norm(right)
        self.up = np.cross(self.right, self.forward)
        # Pixels on a unit of the plane one unit ahead.
        self.focal = size[1] / 2 / np.tan(np.radians(fovy) / 2)

    def directions(self, x, y):
        """Of length 1, through places of the picture in pixels, y down."""
        across = (x - self.size[0] / 2) / self.focal
        above = (self.size[1] / 2 - y) / self.focal
        direction = self.forward + across[..., None] * self.right + above[..., None] * self.up
        return direction / np.linalg.norm(direction, axis=-1, keepdims=True)


def harmonic_basis(direction, count):
    """The first `count` real spherical harmonics, in the order and with the signs of INRIA's trainer."""
    x, y, z = direction.T
    one = np.ones_like(x)
    values = [
        0.28209479177387814 * one,
        -0.4886025119029199 * y, 0.4886025119029199 * z, -0.4886025119029199 * x,
        1.0925484305920792 * x * y, -1.0925484305920792 * y * z, 0.31539156525252005 * (2 * z * z - x * x - y * y),
        -1.0925484305920792 * x * z, 0.5462742152960396 * (x * x - y * y),
        -0.5900435899266435 * y * (3 * x * x - y * y), 2.890611442640554 * x * y * z,
        -0.4570457994644658 * y * (4 * z * z - x * x - y * y), 0.3731763325901154 * z * (2 * z * z - 3 * x * x - 3 * y * y),
        -0.4570457994644658 * x * (4 * z * z - x * x - y * y), 1.445305721320277 * z * (x * x - y * y),
        -0.5900435899266435 * x * (x * x - 3 * y * y),
    ]
    return np.stack(values[:count], axis=1)


def widened(splats, camera, low_pass):
    """Deviations and opacities after the low-pass filter, which is a Gaussian ball about each centre."""
    pixels = {"none": 0.0, "3dgs": 0.3, "mip": 0.1}[low_pass]
    depth = (splats.position - camera.position) @ camera.forward
    width = np.sqrt(pixels) * np.maximum(depth, 0) / camera.focal
    deviation = np.sqrt(splats.deviation**2 + width[:, None] ** 2)
    opacity = splats.opacity
    if low_pass == "mip":
        # Of areas as the eye sees them: of what is left of the covariance across the direction to the centre.
        opacity = opacity * np.sqrt(seen_area(splats, camera, splats.deviation) / seen_area(splats, camera, deviation))
    return deviation, opacity


def seen_area(splats, camera, deviation):
    """The determinant of the covariance across the direction from the eye."""
    direction = splats.position - camera.position
    direction = direction / np.linalg.norm(direction, axis=1, keepdims=True)
    local = np.einsum("nij,ni->nj", splats.rotation, direction)
    return np.prod(deviation**2, axis=1) * np.sum((local / deviation) ** 2, axis=1)


def rasterise(splats, camera, low_pass="none", samples=1, background=(0, 0, 0)):
    """The picture: height x width x 3 linear values. Samples of a pixel are averaged in linear light."""
    deviation, opacity = widened(splats, camera, low_pass)
    toward = splats.position - camera.position
    distance = np.linalg.norm(toward, axis=1)
    basis = harmonic_basis(toward / distance[:, None], splats.harmonics.shape[1])
    color = np.maximum(0, 0.5 + np.einsum("nk,nkc->nc", basis, splats.harmonics))
    # Maps a direction to the space where the Gaussian is a ball of deviation 1.
    to_ball = np.swapaxes(splats.rotation / deviation[:, None, :], 1, 2)
    start = np.einsum("nij,nj->ni", to_ball, -toward)
    reach = np.sqrt(2 * np.log(np.maximum(opacity / LEAST, 1))) * deviation.max(axis=1)
    angle = np.where(reach < distance, np.arcsin(np.minimum(reach / distance, 1)), np.pi)
    axis = toward / distance[:, None]
    width, height = camera.size
    picture = np.zeros((height, width, 3))
    for top in range(0, height, TILE):
        for left in range(0, width, TILE):
            x, y = np.meshgrid(np.arange(left, min(left + TILE, width)), np.arange(top, min(top + TILE, height)))
            middle = camera.directions(np.array(left + TILE / 2), np.array(top + TILE / 2))
            half = np.arccos(np.clip(np.min(camera.directions(x + [[0.5]], y + [[0.5]]) @ middle), -1, 1)) + 2 / camera.focal
            near = np.flatnonzero((np.arccos(np.clip(axis @ middle, -1, 1)) < angle + half) & (opacity >= LEAST))
            for number in range(samples * samples):
                offset = ((number % samples + 0.5) / samples, (number // samples + 0.5) / samples)
                rays = camera.directions((x + offset[0]).ravel(), (y + offset[1]).ravel())
                seen = trace(rays, to_ball[near], start[near], opacity[near], color[near], background)
                linear = np.where(seen <= 0.04045, seen / 12.92, ((seen + 0.055) / 1.055) ** 2.4)
                picture[y, x] += linear.reshape(*x.shape, 3) / samples**2
    return picture


def trace(rays, to_ball, start, opacity, color, background):
    """Display values of rays."""
    count = len(rays)
    light, open_to = np.zeros((count, 3)), np.ones(count)
    if len(opacity):
        directions = np.einsum("nij,rj->nri", to_ball, rays)
        squared = np.einsum("nri,nri->nr", directions, directions)
        along = -np.einsum("nri,ni->nr", directions, start) / squared
        # By cross products, which are exact where Gaussians are very flat.
        nearest = np.square(np.cross(start[:, None, :], directions)).sum(axis=2) / squared
        alpha = opacity[:, None] * np.exp(-nearest / 2)
        splat, ray = np.nonzero((alpha >= LEAST) & (along > 0))
        order = np.lexsort((along[splat, ray], ray))
        splat, ray = splat[order], ray[order]
        alpha = np.minimum(alpha[splat, ray], 0.9999)
        # The product of what is left, as a sum of logarithms that begins anew with each ray.
        passed = np.cumsum(np.log1p(-alpha)) - np.log1p(-alpha)
        first = np.searchsorted(ray, np.arange(count))
        share = alpha * np.exp(passed - passed[np.minimum(first, len(passed) - 1)][ray]) if len(ray) else alpha
        for channel in range(3):
            light[:, channel] = np.bincount(ray, share * color[splat, channel], count)
        open_to = 1 - np.bincount(ray, share, count)
    return light + open_to[:, None] * np.array(background)


def display(linear):
    """Bytes of sRGB."""
    value = np.clip(linear, 0, 1)
    value = np.where(value <= 0.0031308, value * 12.92, 1.055 * value ** (1 / 2.4) - 0.055)
    return np.round(value * 255).astype(np.uint8)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("capture")
    parser.add_argument("-o", "--output", required=True)
    parser.add_argument("--position", type=vector, required=True)
    parser.add_argument("--look-at", type=vector, required=True)
    parser.add_argument("--up", type=vector, default=vector("0,-1,0"))
    parser.add_argument("--fovy", type=float, default=35)
    parser.add_argument("--size", default="480x320")
    parser.add_argument("--filter", choices=("none", "3dgs", "mip"), default="none")
    parser.add_argument("--samples", type=int, default=1, help="rays along each side of a pixel")
    parser.add_argument("--background", default="000000", help="display values, as RRGGBB")
    given = parser.parse_args()
    size = [int(side) for side in given.size.split("x")]
    camera = Camera(given.position, given.look_at, given.up, given.fovy, size)
    background = [int(given.background[i : i + 2], 16) / 255 for i in (0, 2, 4)]
    picture = rasterise(captures.read(given.capture), camera, given.filter, given.samples, background)
    Image.fromarray(display(picture)).save(given.output)


if __name__ == "__main__":
    main()
