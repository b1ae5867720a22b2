"""Addresses, by a web server on this machine that sends ranges."""

from __future__ import annotations

import json
import pickle
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import served

import rayset as rs

SCENE = {"rayset": 1, "root": {"type": "cloud", "file": "cloud.rset"}}


@pytest.fixture
def address(tmp_path: Path) -> Iterator[str]:
    with served(tmp_path) as (address, _):
        yield address


def _points(count: int = 20_000, seed: int = 5) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=(count, 3))


def test_clouds_and_scenes_at_addresses_make_the_pictures_of_files(address: str, tmp_path: Path) -> None:
    cloud = rs.build(_points(), path=tmp_path / "cloud.rset")
    near = rs.render(cloud, size=64)
    remote = rs.open(f"{address}/cloud.rset")
    assert remote.points == cloud.points
    assert (rs.render(remote, size=64).linear == near.linear).all()
    (tmp_path / "scene.json").write_text(json.dumps(SCENE))
    pictures = [rs.render(rs.Scene.load(f"{place}/scene.json"), size=64).linear for place in (address, tmp_path)]
    assert (pictures[0] == pictures[1]).all()
    assert rs.render(rs.open(f"{address}/scene.json"), size=64).size == (64, 64)


def test_signed_addresses_are_opened_again_and_their_signatures_not_shown(tmp_path: Path) -> None:
    cloud = rs.build(_points(2000), path=tmp_path / "cloud.rset")
    rs.build_grid(np.random.default_rng(1).random((6, 6, 6)), path=tmp_path / "grid.rset")
    with served(tmp_path, "key=secret") as (address, _):
        remote = rs.open(f"{address}/cloud.rset?key=secret")
        # The scene of a cloud refers to it by its address.
        scene = rs.Scene.from_json({"rayset": 1, "root": remote.to_json()})
        pictures = [rs.render(one, size=48).linear for one in (remote, scene, pickle.loads(pickle.dumps(remote)))]
        assert (pictures[0] == rs.render(cloud, size=48).linear).all()
        assert (pictures[2] == pictures[0]).all() and pictures[1].shape == (48, 48, 4)
        assert remote.path == f"{address}/cloud.rset" and "secret" not in repr(remote)
        grid = rs.open(f"{address}/grid.rset?key=secret")
        assert rs.render(grid, size=16).size == (16, 16) and "secret" not in repr(grid)
        with pytest.raises(rs.InputError, match="access is denied"):
            rs.open(f"{address}/cloud.rset")


def test_points_at_an_address_are_built(address: str, tmp_path: Path) -> None:
    np.save(tmp_path / "points.npy", _points())
    built = [rs.build(f"{place}/points.npy", columns=["x", "y", "z"], path=tmp_path / name) for place, name in ((address, "remote.rset"), (tmp_path, "near.rset"))]
    assert built[0].points == 20_000
    assert (rs.render(built[0], size=64).linear == rs.render(built[1], size=64).linear).all()


def test_what_is_not_there_and_what_cannot_be_written_is_said(address: str, tmp_path: Path) -> None:
    with pytest.raises(OSError, match="no such object"):
        rs.open(f"{address}/nothing.rset")
    with pytest.raises(OSError, match="no such object"):
        rs.Scene.load(f"{address}/nothing.json")
    with pytest.raises(rs.BuildError, match="only read"):
        rs.build(_points(100), path=f"{address}/new.rset")
    with pytest.raises(ValueError, match="address"):
        rs.open(f"{address}/cloud.rset", cache="s3://bucket/cache")
    assert sorted(file.name for file in tmp_path.iterdir()) == []


def _picture(scene: rs.Scene, **options: Any) -> np.ndarray:
    return np.asarray(rs.render(scene, size=64, **options).linear)


def test_a_session_shows_what_is_at_an_address_now_and_asks_little(tmp_path: Path) -> None:
    with served(tmp_path) as (address, asked), rs.Session() as session:
        remote, near = rs.Scene.from_json(SCENE, address), rs.Scene.from_json(SCENE, tmp_path)
        seen = []
        for seed in (5, 6, 5):
            rs.build(_points(seed=seed), path=tmp_path / "cloud.rset")
            seen.append(_picture(remote, session=session))
            assert (seen[-1] == _picture(near)).all()
            asked.clear()
            assert (_picture(remote, session=session) == seen[-1]).all()
            assert asked == [("GET", "/cloud.rset")], "nothing is read again of what is the same"
        assert (seen[0] != seen[1]).any() and (seen[0] == seen[2]).all()


def test_what_was_opened_stays_what_it_is_and_says_so_when_it_is_gone(tmp_path: Path) -> None:
    with served(tmp_path) as (address, _), rs.Session() as session:
        rs.build(_points(), path=tmp_path / "cloud.rset")
        first = rs.open(f"{address}/cloud.rset")
        rs.build(_points(30_000, seed=6), path=tmp_path / "cloud.rset")
        second = rs.open(f"{address}/cloud.rset")
        assert (first.points, second.points) == (20_000, 30_000)
        with pytest.raises(rs.RaysetError, match=r"cloud\.rset"):
            session.render(first, size=64)
        assert session.render(second, size=64).size == (64, 64)


def test_workers_render_and_build_what_is_at_addresses(tmp_path: Path) -> None:
    distributed = pytest.importorskip("distributed")
    np.save(tmp_path / "points.npy", _points())
    cluster = distributed.LocalCluster(n_workers=2, threads_per_worker=1, processes=True, dashboard_address=":0", silence_logs=50)
    with served(tmp_path) as (address, _), cluster, distributed.Client(cluster) as client:
        remote, near = rs.Scene.from_json(SCENE, address), rs.Scene.from_json(SCENE, tmp_path)
        for seed in (5, 6):
            # The second time it is another object, which the sessions of workers have to see.
            cloud = rs.build(_points(seed=seed), path=tmp_path / "cloud.rset")
            opened = rs.open(f"{address}/cloud.rset")
            assert (_picture(remote, executor=client) == _picture(near)).all()
            assert (rs.render(opened, size=64, executor=client).linear == rs.render(cloud, size=64).linear).all()
            frames = rs.render_frames(opened, turntable=3, size=64, executor=client)
            here = rs.render_frames(cloud, turntable=3, size=64)
            assert all((a.linear == b.linear).all() for a, b in zip(frames, here, strict=True))
        built = [
            rs.build(f"{place}/points.npy", columns=["x", "y", "z"], path=tmp_path / name, executor=executor)
            for place, name, executor in ((address, "remote.rset", client), (tmp_path, "near.rset", None))
        ]
        assert built[0].points == built[1].points == 20_000
        assert (tmp_path / "remote.rset").read_bytes() == (tmp_path / "near.rset").read_bytes()
        rs.build(_points(seed=7), path=tmp_path / "cloud.rset")
        with pytest.raises(rs.ExecutorError, match="another object by now"):
            rs.render(opened, size=64, executor=client)
        for action in (lambda: rs.render(rs.Scene.from_json(SCENE, f"{address}/no"), executor=client), lambda: rs.build(f"{address}/no.npy", path=tmp_path / "no.rset", executor=client)):
            with pytest.raises((rs.RaysetError, OSError), match="no such object"):
                action()


def test_no_exception_shows_what_an_address_grants_access_with(tmp_path: Path) -> None:
    secret = "hunter2"
    with served(tmp_path, f"sig={secret}") as (address, _):
        (tmp_path / "damaged.rset").write_bytes(b"rayset")
        host = address.removeprefix("http://")
        for there in (
            f"http://user:{secret}@{host}/damaged.rset?sig={secret}",
            f"http://user:{secret}@{host}/none.laz?sig={secret}",
            f"http://user:{secret}@{host}/damaged.rset?other={secret}",
            f"http:/user:{secret}@{host}/none.laz?sig={secret}",
            f"http://user:{secret}/@{host}/none.laz?sig={secret}",
        ):
            wrong = [
                lambda: rs.open(there),
                lambda: rs.open([there, there]),
                lambda: rs.open(Path(there)),
                lambda: rs.Scene.load(there),
                lambda: rs.render(there, size=8),
                lambda: rs.build(there),
                lambda: rs.build(np.zeros((3, 3)), radius=1, path=there),
                lambda: rs.build(np.zeros((3, 3)), radius=there),
                lambda: rs.build(np.zeros((3, 3)), radius=1, path="a.rset", temp_dir=there),
                lambda: rs.render(rs.build(np.ones((3, 3)), radius=1), size=8).save(there),
                lambda: rs.render(rs.Scene.from_json({"rayset": 1, "root": {"type": "cloud", "file": there}}), size=8),
            ]
            for work in wrong:
                with pytest.raises(Exception) as raised:
                    work()
                said = [str(raised.value), repr(raised.value)]
                assert not any(secret in text for text in said), said
