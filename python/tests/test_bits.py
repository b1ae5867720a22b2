"""The figures of the paper, small: the same bits whoever renders them, and wherever their clouds lie."""

from __future__ import annotations

import json
import os
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import program, served

import rayset as rs

#: One of each kind: a cut cloud around a volume, operators, many objects under lights. `RAYSET_TEST_ALL=1` renders all that there are.
FIGURES = [1, 2, 3, 4, 5, 10, 11] if os.environ.get("RAYSET_TEST_ALL") else [1, 4, 10]
SIZE = 128


@pytest.fixture(scope="module")
def figures(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Data, scenes and pictures of the figures, made by the program. The statue of figures 3 and 5 has fewer points than in the paper."""
    rayset = program()
    if rayset is None:
        pytest.skip("the program is not installed")
    folder = tmp_path_factory.mktemp("figures")
    # What is there already is used again.
    random = np.random.default_rng(3)
    height, angle = random.uniform(0, 1, 100_000), random.uniform(0, 2 * np.pi, 100_000)
    reach = 0.15 + 0.05 * np.sin(7 * height)
    _write_ply(folder / "statue.ply", np.column_stack([reach * np.cos(angle), height, reach * np.sin(angle)]))
    for number in FIGURES:
        output = folder / f"fig{number}.png"
        command = [rayset, "figure", str(number), "--data", str(folder), "--size", f"{SIZE}x{SIZE}", "--output", str(output), "--memory", "256MiB"]
        subprocess.run(command, check=True, capture_output=True)
        if number == 5:
            # A picture for each radius, of which the cloud of the last is left.
            sorted(folder.glob("fig5.*.png"))[-1].rename(output)
        if number in (3, 5):
            # The next has another statue.
            (folder / "statue.rset").rename(folder / f"statue{number}.rset")
            scene = (folder / f"fig{number}.json").read_text()
            assert '"statue.rset"' in scene
            (folder / f"fig{number}.json").write_text(scene.replace('"statue.rset"', f'"statue{number}.rset"'))
    return folder


def _write_ply(path: Path, points: np.ndarray) -> None:
    head = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(points)}\nproperty float x\nproperty float y\nproperty float z\nend_header\n"
    path.write_bytes(head.encode() + points.astype("<f4").tobytes())


@pytest.fixture(scope="module")
def bucket(figures: Path) -> Iterator[str | None]:
    """The address of a bucket with the scenes and their clouds, on a server that speaks S3's protocol; `None` without moto."""
    try:
        import boto3
        from moto.server import ThreadedMotoServer
    except ImportError:
        yield None
        return
    server = ThreadedMotoServer("127.0.0.1", 0, verbose=False)
    server.start()
    endpoint = "http://{}:{}".format(*server.get_host_and_port())
    with pytest.MonkeyPatch.context() as patch:
        known = {"AWS_ENDPOINT_URL": endpoint, "AWS_ACCESS_KEY_ID": "a", "AWS_SECRET_ACCESS_KEY": "b", "AWS_REGION": "us-east-1"}
        for name, value in known.items():
            patch.setenv(name, value)
        s3 = boto3.client("s3", endpoint_url=endpoint, region_name="us-east-1")
        s3.create_bucket(Bucket="figures")
        for path in figures.glob("*.rset"):
            s3.upload_file(str(path), "figures", path.name)
        yield "s3://figures"
    server.stop()


@pytest.fixture(scope="module", params=[1, 2], ids=["one worker", "two workers"])
def client(request: pytest.FixtureRequest, bucket: str | None) -> Iterator[Any]:
    # Workers have the environment of whoever starts them.
    distributed = pytest.importorskip("distributed")
    options: dict[str, Any] = {"threads_per_worker": 1, "processes": True, "dashboard_address": ":0", "silence_logs": 50}
    with distributed.LocalCluster(n_workers=request.param, **options) as cluster, distributed.Client(cluster) as connected:
        yield connected


def _scene(number: int, folder: Path) -> dict[str, Any]:
    scene: dict[str, Any] = json.loads((folder / f"fig{number}.json").read_text())
    scene.setdefault("image", {})["size"] = [SIZE, SIZE]
    return scene


def _bits(image: rs.Image) -> list[bytes]:
    return [getattr(image, name).tobytes() for name in ("linear", "depth", "normal", "albedo", "instance", "samples", "lod_error")]


@pytest.fixture(scope="module")
def expected(figures: Path) -> dict[int, list[bytes]]:
    """The bits of one process."""
    return {number: _bits(rs.render(rs.Scene.from_json(_scene(number, figures), figures))) for number in FIGURES}


@pytest.mark.parametrize("number", FIGURES)
def test_a_process_makes_the_picture_of_the_program(number: int, figures: Path) -> None:
    image = rs.render(rs.Scene.from_json(_scene(number, figures), figures))
    assert image._repr_png_() == (figures / f"fig{number}.png").read_bytes()
    assert len(np.unique(image.rgba.reshape(-1, 4), axis=0)) > 100, "there is something to see"


@pytest.mark.parametrize("number", FIGURES)
def test_threads_and_memory_change_no_bit(number: int, figures: Path, expected: dict[int, list[bytes]]) -> None:
    with rs.Session(memory="48MiB", threads=1) as session:
        assert _bits(session.render(rs.Scene.from_json(_scene(number, figures), figures))) == expected[number]


@pytest.mark.parametrize("number", FIGURES)
def test_clouds_in_memory_change_no_bit(number: int, figures: Path, expected: dict[int, list[bytes]]) -> None:
    held: dict[str, Any] = {}

    def in_memory(value: Any) -> Any:
        if isinstance(value, list):
            return [in_memory(one) for one in value]
        if not isinstance(value, dict):
            return value
        value = {key: in_memory(one) for key, one in value.items()}
        if "file" in value:
            name = value["file"]
            held.setdefault(name, rs.open((figures / name).read_bytes()))
            value["file"] = held[name].to_json()["file"]
        return value

    scene = in_memory(_scene(number, figures))
    assert held and all(one.in_memory for one in held.values())
    assert _bits(rs.render(rs.Scene.from_json(scene))) == expected[number]


@pytest.mark.parametrize("number", FIGURES)
def test_a_web_server_changes_no_bit(number: int, figures: Path, expected: dict[int, list[bytes]]) -> None:
    with served(figures) as (address, _), rs.Session(memory="128MiB") as session:
        assert _bits(session.render(rs.Scene.from_json(_scene(number, figures), address))) == expected[number]


@pytest.mark.parametrize("number", FIGURES)
def test_a_bucket_changes_no_bit(number: int, bucket: str | None, figures: Path, expected: dict[int, list[bytes]]) -> None:
    if bucket is None:
        pytest.skip("moto is not installed")
    with rs.Session(memory="128MiB") as session:
        assert _bits(session.render(rs.Scene.from_json(_scene(number, figures), bucket))) == expected[number]


@pytest.mark.parametrize("where", ["files", "a web server", "S3"])
@pytest.mark.parametrize("number", FIGURES)
def test_workers_change_no_bit(
    number: int, where: str, client: Any, bucket: str | None, figures: Path, expected: dict[int, list[bytes]]
) -> None:
    if where == "S3" and bucket is None:
        pytest.skip("moto is not installed")
    with served(figures) as (address, _):
        scene = rs.Scene.from_json(_scene(number, figures), {"files": figures, "a web server": address, "S3": bucket}[where])
        assert _bits(rs.render(scene, executor=client)) == expected[number]
