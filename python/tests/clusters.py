"""Clusters of Dask, and what their workers see: what tests of them share."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import points

import rayset as rs

distributed = pytest.importorskip("distributed")

SIZE = (96, 72)


@pytest.fixture(scope="module", params=[1, 2], ids=["one worker", "two workers"])
def client(request: pytest.FixtureRequest) -> Iterator[Any]:
    with cluster_of(request.param) as cluster, distributed.Client(cluster) as connected:
        yield connected


@pytest.fixture
def two() -> Iterator[Any]:
    """Two workers of one test's own, which it may change and kill."""
    with cluster_of(2) as cluster, distributed.Client(cluster) as connected:
        yield connected


def cluster_of(workers: int) -> Any:
    return distributed.LocalCluster(n_workers=workers, threads_per_worker=1, processes=True, dashboard_address=":0", silence_logs=50)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What all see: a cloud, a grid, and files of points."""
    made = tmp_path_factory.mktemp("seen")
    where = points(3000)
    rs.build(where, radius=0.2, attributes={"T": where[:, 0].astype("f4")}, path=made / "cloud.rset")
    z, y, x = np.mgrid[-1:1:24j, -1:1:24j, -1:1:24j]
    rs.build_grid(np.exp(-3 * (x**2 + y**2 + z**2)).astype("f4"), spacing=2 / 23, origin=(-1, -1, -1), path=made / "grid.rset")
    np.save(made / "a.npy", points(300_000, 2))
    np.save(made / "b.npy", points(100_000, 3) + 4)
    return made


def scene_of(kind: str, folder: Path) -> rs.Scene:
    cloud = rs.open(folder / "cloud.rset")
    if kind == "opaque":
        return rs.Scene(cloud, look="surface", color_by="T", ambient_occlusion=0.5, size=SIZE)
    if kind == "translucent":
        return rs.Scene(cloud, look="gas", color_by="T", size=SIZE)
    if kind == "solids":
        root = (cloud - rs.Box((0.5, 0, 0), (2, 2, 2))) | rs.Sphere((1.5, 0, 0), 0.8, color="#c8ccd4").with_material(diffuse=0.2, reflectance=0.7)
        return rs.Scene(root, lights=[rs.AmbientLight(0.4), rs.DirectionalLight((-0.5, -1, -1), 0.8)], tone_mapping="filmic", exposure=0.5, size=SIZE)
    return rs.Scene(rs.open(folder / "grid.rset"), size=SIZE)


def are_same(a: rs.Image, b: rs.Image) -> bool:
    layers = all(np.array_equal(getattr(a, name), getattr(b, name)) for name in ("linear", "depth", "normal", "albedo", "instance", "samples", "lod_error"))
    return layers and a._repr_png_() == b._repr_png_()


def is_soon(holds: Callable[[], bool]) -> bool:
    end = time.monotonic() + 60
    while not holds():
        if time.monotonic() > end:
            return False
        time.sleep(0.05)
    return True
