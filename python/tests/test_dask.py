"""Work by the workers of dask.distributed: the same bytes as here, and nothing left behind."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from clusters import SIZE, are_same, client, distributed, folder, is_soon, scene_of, two  # noqa: F401
from conftest import points

import rayset as rs


@pytest.mark.parametrize("kind", ["opaque", "translucent", "solids", "volume"])
def test_a_picture_has_the_bytes_of_one_process(kind: str, client: Any, folder: Path) -> None:
    scene, told = scene_of(kind, folder), list[tuple[str, int, int]]()
    image = rs.render(scene, executor=client, progress=lambda *step: told.append(step))
    assert are_same(image, rs.render(scene))
    done = [step[1] for step in told]
    assert told[-1] == ("tracing", SIZE[0] * SIZE[1], SIZE[0] * SIZE[1]) and done == sorted(done) and len(done) > 3


def test_a_crop_has_the_bytes_of_one_process(client: Any, folder: Path) -> None:
    scene = scene_of("solids", folder)
    crop = (11, 7, 50, 40)
    image = rs.render(scene, crop=crop, executor=client)
    assert image.size == (50, 40) and are_same(image, rs.render(scene, crop=crop))


def test_shares_that_take_longest_come_first_and_change_no_byte(two: Any, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from rayset._executor import tasks, worker

    begun, original = [], tasks.Tasks.submit

    def submit(self: Any, label: Any, what: str, function: Any, *arguments: Any, **more: Any) -> None:
        if function is worker.render_share and len(arguments) == 2:
            begun.append(arguments[1])
        original(self, label, what, function, *arguments, **more)

    monkeypatch.setattr(tasks.Tasks, "submit", submit)
    # The cloud is in a corner, and the rest of the picture is empty.
    scene = rs.Scene(rs.open(folder / "cloud.rset").moved((5, 4, 0)), camera=rs.Camera(position=(0, 0, 16), look_at=(0, 0, 0), fovy=50), look="gas", size=(300, 260))
    image = rs.render(scene, executor=two)
    assert sorted(begun) == [(number, 8) for number in range(1, 9)]
    assert begun[:4] == [(number, 8) for number in range(1, 5)]
    samples = [0] * 9
    for number, left, top in _squares(begun[4:], image):
        samples[number] += int(image.samples[top : top + 32, left : left + 32].sum())
    left = [samples[number] for number, _ in begun[4:]]
    assert max(left) > 1.2 * min(left) and left[0] > left[-1]
    assert are_same(image, rs.render(scene))


def _squares(shares: list[tuple[int, int]], image: rs.Image) -> Iterator[tuple[int, int, int]]:
    """The squares of some shares, as the engine has them: what costs only there costs those shares."""
    from rayset import _native

    width, height = image.size
    columns, rows = -(-width // 32), -(-height // 32)
    for j in range(rows):
        for i in range(columns):
            costs = [float(k == j * columns + i) for k in range(columns * rows)]
            of_share = _native.share_costs(costs, [0, 0, width, height], 32, shares[0][1])
            yield of_share.index(max(of_share)) + 1, 32 * i, 32 * j


def test_progress_is_told_from_within_shares(two: Any, folder: Path) -> None:
    def often() -> None:
        from rayset._executor import worker

        worker._TELLING = 0.0

    two.run(often)
    told = list[int]()
    scene = rs.Scene(rs.open(folder / "cloud.rset"), look="gas", size=(480, 360), samples=4)
    rs.render(scene, executor=two, progress=lambda _, done, total: told.append(done))
    assert told == sorted(set(told)) and told[-1] == 480 * 360
    assert any(done * 8 % (480 * 360) for done in told), "not only whole shares of eight"


@pytest.mark.parametrize("crop", [None, (11, 7, 150, 140)], ids=["whole", "crop"])
def test_pictures_come_coarse_first_and_end_with_the_picture(crop: Any, client: Any, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from rayset._executor import pictures

    monkeypatch.setattr(pictures, "_PAUSE", 0)
    scene = rs.Scene(rs.open(folder / "cloud.rset"), look="gas", color_by="T", size=(200, 160))
    expected = rs.render(scene, crop=crop)
    shown = list(rs.render(scene, crop=crop, progressive=True, executor=client))
    assert are_same(shown[-1], expected)
    assert len(shown) > 2 and all(image.size == expected.size for image in shown)
    right = [int((image.linear == expected.linear).all(axis=2).sum()) for image in shown]
    assert right == sorted(right) and right[0] < right[-2] < right[-1], "shares take the place of squares"
    assert all((image.opacity > 0).sum() > 0.5 * (expected.opacity > 0).sum() for image in shown)


def test_pictures_that_nobody_waits_for_are_not_finished(client: Any, folder: Path) -> None:
    shown = rs.render(rs.open(folder / "cloud.rset"), look="gas", size=1500, samples=16, progressive=True, executor=client)
    assert next(shown).size == (1500, 1500)
    begun = time.monotonic()
    shown.close()
    assert time.monotonic() - begun < 30
    assert is_soon(lambda: not client.futures and not any(client.processing().values()))
    assert next(shown, None) is None


def test_frames_come_in_order_with_the_bytes_of_one_process(client: Any, folder: Path) -> None:
    scene, told = scene_of("translucent", folder), list[Any]()
    here = list(rs.render_frames(scene, turntable=7))
    there = list(rs.render_frames(scene, turntable=7, executor=client, progress=lambda *step: told.append(step)))
    assert len(here) == len(there) == 7 and all(map(are_same, here, there))
    assert not are_same(here[0], here[3])
    assert told == [("frames", k, 7) for k in range(1, 8)]
    cameras = [image.scene.camera for image in here[2:4]]
    assert all(map(are_same, rs.render_frames(scene, cameras, executor=client), here[2:4]))
    assert are_same(rs.render(scene, camera=cameras[0]), here[2])


def test_frames_are_not_begun_far_ahead_and_stop_when_they_are_left(client: Any, folder: Path) -> None:
    frames = rs.render_frames(scene_of("opaque", folder), turntable=500, executor=client)
    next(frames)
    begun = len(client.futures)
    frames.close()  # type: ignore[attr-defined]
    threads = sum(client.nthreads().values())
    assert begun <= 2 * threads + 3
    assert is_soon(lambda: not client.futures and not any(client.processing().values()))


def test_pages_and_sessions_stay_between_tasks(two: Any, folder: Path) -> None:
    def read() -> dict[str, tuple[int, int]]:
        def of_worker() -> tuple[int, int]:
            from rayset._executor import worker

            (_, session), = worker._sessions.values()
            return id(session), int(session.statistics()["points"]["bytes_read"])

        return two.run(of_worker)

    scene = scene_of("translucent", folder)
    rs.render(scene, executor=two)
    before = read()
    rs.render(scene, executor=two)
    assert read() == before and any(count for _, count in before.values())


def test_a_build_has_the_bytes_of_one_process(client: Any, folder: Path, tmp_path: Path) -> None:
    files, told = [folder / "a.npy", folder / "b.npy"], list[Any]()
    for radius in (None, 0.05):
        here = rs.build(files, columns=["x", "y", "z"], radius=radius, path=tmp_path / "here.rset")
        options: dict[str, Any] = {"columns": ["x", "y", "z"], "radius": radius, "executor": client, "progress": lambda *step: told.append(step)}
        there = rs.build(files, path=tmp_path / "there.rset", **options)
        assert len(there) == len(here) == 400_000
        assert (tmp_path / "there.rset").read_bytes() == (tmp_path / "here.rset").read_bytes()
        assert sorted(os.listdir(tmp_path)) == ["here.rset", "there.rset"]
    names = list(dict.fromkeys(step[0] for step in told))
    assert names[0] == "read" and names[-2:] == ["order", "merge"] and "spacing-measure" in names
    assert all(done <= total for _, done, total in told)


def test_a_build_of_arrays_has_the_bytes_of_one_process(client: Any, tmp_path: Path) -> None:
    where = points(60_001, 4)
    where[7] = np.nan
    options: dict[str, Any] = {
        "radius": np.abs(where[:, 1]) * 0.01 + 0.01,
        "color": np.clip(np.abs(np.nan_to_num(where)), 0, 1),
        "attributes": {"T": where[:, 0].astype("f4"), "kind": (where[:, 2] > 0).astype("u1")},
        "classes": ["kind"],
    }
    table = {"x": where[:, 0], "y": where[:, 1], "z": where[:, 2]}
    for given, more in ((where, options), (table, {}), (where.astype("f4")[1::2], {"radius": 0.05})):
        made = []
        for name, executor in (("here.rset", None), ("there.rset", client)):
            with pytest.warns(rs.RaysetWarning, match="1 have no usable position"):
                made.append(rs.build(given, path=tmp_path / name, executor=executor, **more))
        assert len(made[0]) == len(made[1]) > 29_000
        assert (tmp_path / "there.rset").read_bytes() == (tmp_path / "here.rset").read_bytes()
        assert sorted(os.listdir(tmp_path)) == ["here.rset", "there.rset"]
    for name, executor in (("here.rset", None), ("there.rset", client)):
        rs.build(points(5000), path=tmp_path / name, executor=executor, lod=True)
    assert (tmp_path / "there.rset").read_bytes() == (tmp_path / "here.rset").read_bytes()
    few = rs.build(points(1), radius=1, path=tmp_path / "few.rset", executor=client)
    assert len(few) == 1


def test_stopping_ends_tasks_and_leaves_nothing(client: Any, folder: Path, tmp_path: Path) -> None:
    def enough(doing: str, done: int, total: int) -> None:
        if doing in ("tracing", "count"):
            raise RuntimeError("enough")

    cloud = rs.open(folder / "cloud.rset")
    with pytest.raises(RuntimeError, match="enough"):
        rs.render(cloud, look="gas", size=500, samples=4, executor=client, progress=enough)
    # Shares of this take many seconds each, and are ended from within.
    threading.Timer(1, os.kill, (os.getpid(), signal.SIGINT)).start()
    begun = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        rs.render(cloud, look="gas", size=1500, samples=16, executor=client)
    assert time.monotonic() - begun < 30
    assert is_soon(lambda: not any(client.processing().values()))
    with pytest.raises(RuntimeError, match="enough"):
        rs.build(folder / "a.npy", columns=["x", "y", "z"], path=tmp_path / "out.rset", executor=client, progress=enough)
    assert os.listdir(tmp_path) == []
    # Threads of workers are free.
    assert set(client.run(_is_idle).values()) == {True}


def _is_idle() -> bool:
    from rayset._executor import worker

    return not worker._running


def test_what_workers_do_not_see_is_said(client: Any, folder: Path, tmp_path: Path, cloud: rs.Cloud) -> None:
    with pytest.raises(ValueError, match="in the memory of this process.*rs.build"):
        rs.render(cloud, executor=client)
    with pytest.raises(TypeError, match="iterator of chunks is in this process"):
        rs.build(iter([points()]), path=tmp_path / "out.rset", executor=client)
    with pytest.raises(TypeError, match="path="):
        rs.build(folder / "a.npy", executor=client)
    missing = rs.Scene.from_json({"rayset": 1, "root": {"type": "cloud", "file": str(tmp_path / "missing.rset")}})
    said = []
    for options in ({}, {"executor": client}):
        with pytest.raises(rs.SceneError) as caught:
            rs.render(missing, **options)
        said.append(str(caught.value))
    assert said[1].startswith(said[0]) and "(worker " in said[1]
    with pytest.raises(FileNotFoundError, match="missing.npy"):
        rs.build(tmp_path / "missing.npy", path=tmp_path / "out.rset", executor=client)
    assert os.listdir(tmp_path) == []


def test_a_file_that_goes_away_meanwhile_is_said_with_the_worker(client: Any, folder: Path, tmp_path: Path) -> None:
    copy = tmp_path / "cloud.rset"
    copy.write_bytes((folder / "cloud.rset").read_bytes())
    frames = rs.render_frames(rs.open(copy), turntable=40, size=SIZE, executor=client)
    next(frames)
    copy.unlink()
    with pytest.raises(rs.RaysetError, match=r"cloud\.rset.*\(worker "):
        list(frames)


def test_mistakes_in_a_call_are_said(client: Any, folder: Path) -> None:
    scene = scene_of("opaque", folder)
    with pytest.raises(TypeError, match="expected a client of dask.distributed"):
        rs.render(scene, executor=4)
    for options in ({"threads": 2}, {"session": rs.Session()}):
        with pytest.raises(TypeError, match=next(iter(options))):
            rs.render(scene, executor=client, **options)
    with pytest.raises(rs.MemoryBudgetError, match="worker "):
        rs.render(scene, executor=client, memory="1MiB")
    with pytest.raises(TypeError, match="cameras or turntable"):
        rs.render_frames(scene, [], turntable=3)


def test_workers_agree_on_the_lowest_class_of_instructions(two: Any, folder: Path) -> None:
    from rayset import _native

    if {fused for _, fused in _native.instructions()} != {True, False}:
        pytest.skip("this processor has one class of instructions")

    def old() -> None:
        from rayset import _native

        without = [(name, fused) for name, fused in _native.instructions() if not fused]
        _native.instructions = lambda: without

    scene = scene_of("opaque", folder)
    best = rs.render(scene, executor=two)
    two.run(old, workers=[min(two.nthreads())])
    lowest = rs.render(scene, executor=two)
    name = next(name for name, fused in _native.instructions() if not fused)
    with rs.Session(_simd=name) as session:
        assert are_same(lowest, session.render(scene))
    assert not np.array_equal(lowest.linear, best.linear)


def test_workers_of_other_versions_are_named(two: Any, folder: Path) -> None:
    def other() -> None:
        from rayset import _native

        _native.__version__ = "0.0.9"

    worker = min(two.nthreads())
    two.run(other, workers=[worker])
    with pytest.raises(rs.ExecutorError, match=rf"versions of rayset.*{worker}\): 0\.0\.9"):
        rs.render(scene_of("opaque", folder), executor=two)
