"""Work by the workers of dask.distributed: the same bytes as here, whoever dies meanwhile, and nothing left behind."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
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
    with _cluster(request.param) as cluster, distributed.Client(cluster) as connected:
        yield connected


@pytest.fixture
def two() -> Iterator[Any]:
    """Two workers of one test's own, which it may change and kill."""
    with _cluster(2) as cluster, distributed.Client(cluster) as connected:
        yield connected


def _cluster(workers: int) -> Any:
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


def _scene(kind: str, folder: Path) -> rs.Scene:
    cloud = rs.open(folder / "cloud.rset")
    if kind == "opaque":
        return rs.Scene(cloud, look="surface", color_by="T", ambient_occlusion=0.5, size=SIZE)
    if kind == "translucent":
        return rs.Scene(cloud, look="gas", color_by="T", size=SIZE)
    if kind == "solids":
        root = (cloud - rs.Box((0.5, 0, 0), (2, 2, 2))) | rs.Sphere((1.5, 0, 0), 0.8, color="#c8ccd4").with_material(diffuse=0.2, reflectance=0.7)
        return rs.Scene(root, lights=[rs.AmbientLight(0.4), rs.DirectionalLight((-0.5, -1, -1), 0.8)], tone_mapping="filmic", exposure=0.5, size=SIZE)
    return rs.Scene(rs.open(folder / "grid.rset"), size=SIZE)


def _are_same(a: rs.Image, b: rs.Image) -> bool:
    layers = all(np.array_equal(getattr(a, name), getattr(b, name)) for name in ("linear", "depth", "normal", "albedo", "instance", "samples"))
    return layers and a._repr_png_() == b._repr_png_()


@pytest.mark.parametrize("kind", ["opaque", "translucent", "solids", "volume"])
def test_a_picture_has_the_bytes_of_one_process(kind: str, client: Any, folder: Path) -> None:
    scene, told = _scene(kind, folder), list[tuple[str, int, int]]()
    image = rs.render(scene, executor=client, progress=lambda *step: told.append(step))
    assert _are_same(image, rs.render(scene))
    done = [step[1] for step in told]
    assert told[-1] == ("tracing", SIZE[0] * SIZE[1], SIZE[0] * SIZE[1]) and done == sorted(done) and len(done) > 3


def test_a_crop_has_the_bytes_of_one_process(client: Any, folder: Path) -> None:
    scene = _scene("solids", folder)
    crop = (11, 7, 50, 40)
    image = rs.render(scene, crop=crop, executor=client)
    assert image.size == (50, 40) and _are_same(image, rs.render(scene, crop=crop))


def test_frames_come_in_order_with_the_bytes_of_one_process(client: Any, folder: Path) -> None:
    scene, told = _scene("translucent", folder), list[Any]()
    here = list(rs.render_frames(scene, turntable=7))
    there = list(rs.render_frames(scene, turntable=7, executor=client, progress=lambda *step: told.append(step)))
    assert len(here) == len(there) == 7 and all(map(_are_same, here, there))
    assert not _are_same(here[0], here[3])
    assert told == [("frames", k, 7) for k in range(1, 8)]
    cameras = [image.scene.camera for image in here[2:4]]
    assert all(map(_are_same, rs.render_frames(scene, cameras, executor=client), here[2:4]))
    assert _are_same(rs.render(scene, camera=cameras[0]), here[2])


def test_frames_are_not_begun_far_ahead_and_stop_when_they_are_left(client: Any, folder: Path) -> None:
    frames = rs.render_frames(_scene("opaque", folder), turntable=500, executor=client)
    next(frames)
    begun = len(client.futures)
    frames.close()  # type: ignore[attr-defined]
    threads = sum(client.nthreads().values())
    assert begun <= 2 * threads + 3
    assert _is_soon(lambda: not client.futures and not any(client.processing().values()))


def test_pages_and_sessions_stay_between_tasks(two: Any, folder: Path) -> None:
    def read() -> dict[str, tuple[int, int]]:
        def of_worker() -> tuple[int, int]:
            from rayset._executor import worker

            (_, session), = worker._sessions.values()
            return id(session), int(session.statistics()["points"]["bytes_read"])

        return two.run(of_worker)

    scene = _scene("translucent", folder)
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


def _deadly(function: str, marker: str, delay: float, step: str | None) -> None:
    """On a worker: the next task of that function dies so long after it has begun, once of all workers."""
    from rayset._executor import worker

    original = getattr(worker, function)

    def wrapped(*arguments: Any) -> Any:
        if step is not None and step not in arguments:
            return original(*arguments)
        try:
            handle = os.open(marker, os.O_CREAT | os.O_EXCL)
        except FileExistsError:
            return original(*arguments)
        os.close(handle)
        threading.Timer(delay, os.kill, (os.getpid(), signal.SIGKILL)).start()
        try:
            return original(*arguments)
        finally:
            # Not in the middle.
            Path(marker).write_text("late")

    setattr(worker, function, wrapped)


def _was_killed(marker: Path) -> bool:
    return marker.exists() and marker.read_text() == ""


def test_a_worker_that_dies_at_a_share_does_not_matter(two: Any, folder: Path, tmp_path: Path) -> None:
    scene = rs.Scene(rs.open(folder / "cloud.rset"), look="gas", size=(480, 360), samples=4)
    two.run(_deadly, "render_share", str(tmp_path / "dead"), 0.1, None)
    image = rs.render(scene, executor=two)
    assert _was_killed(tmp_path / "dead")
    assert _are_same(image, rs.render(scene))


@pytest.mark.parametrize("step", ["read", "spacing-measure", "scatter", "order", "merge"])
def test_a_worker_that_dies_at_a_build_does_not_matter(step: str, two: Any, folder: Path, tmp_path: Path) -> None:
    out, dead = tmp_path / "out", tmp_path / "dead"
    out.mkdir()
    options: dict[str, Any] = {"columns": ["x", "y", "z"]}
    rs.build(folder / "a.npy", path=out / "here.rset", **options)
    two.run(_deadly, *(("merge", str(dead), 0.005, None) if step == "merge" else ("build_step", str(dead), 0.01, step)))
    rs.build(folder / "a.npy", path=out / "there.rset", executor=two, **options)
    assert _was_killed(dead)
    assert (out / "there.rset").read_bytes() == (out / "here.rset").read_bytes()
    assert sorted(os.listdir(out)) == ["here.rset", "there.rset"]


def test_a_task_that_ends_every_worker_is_an_error_that_says_so(two: Any, folder: Path) -> None:
    def deadly() -> None:
        from rayset._executor import worker

        worker.render_share = lambda *_: os.kill(os.getpid(), signal.SIGKILL)  # type: ignore[assignment,return-value]

    class Everywhere(distributed.WorkerPlugin):  # type: ignore[misc]
        def setup(self, worker: Any) -> None:
            deadly()

    two.register_plugin(Everywhere())
    with pytest.raises(rs.ExecutorError, match="has ended each of several workers"):
        rs.render(_scene("opaque", folder), executor=two)


class _Own:
    """Scheduler and workers that are processes of their own, so that each can be killed."""

    def __init__(self, folder: Path, workers: int = 1) -> None:
        self.folder = folder
        self.file = folder / "scheduler.json"
        seen = os.pathsep.join(map(str, (Path(__file__).parent, Path(rs.__file__).parents[1])))
        environment = {**os.environ, "PYTHONPATH": seen, "DASK_DISTRIBUTED__COMM__TIMEOUTS__CONNECT": "5s"}
        self.scheduler = self._start(environment, "scheduler", "--port", "0", "--no-dashboard")
        options = ["--nthreads", "1", "--no-nanny", "--no-dashboard", "--death-timeout", "20"]
        self.workers = [self._start(environment, "worker", *options) for _ in range(workers)]

    def _start(self, environment: dict[str, str], *arguments: str) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", "distributed.cli.dask_" + arguments[0], "--scheduler-file", str(self.file), *arguments[1:]]
        return subprocess.Popen(command, cwd=self.folder, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)

    def __enter__(self) -> _Own:
        return self

    def __exit__(self, *_: object) -> None:
        for process in [*self.workers, self.scheduler]:
            process.kill()
            process.wait()


def _slow() -> None:
    """On a worker: every part of a step takes a second longer."""
    from rayset._executor import worker

    original = worker.build_step

    def wrapped(*arguments: Any) -> Any:
        outcome = original(*arguments)
        time.sleep(1)
        return outcome

    worker.build_step = wrapped  # type: ignore[assignment]


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGSTOP], ids=["killed", "stopped"])
def test_a_scheduler_that_is_gone_is_an_error_in_time(how: signal.Signals, folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    with _Own(tmp_path) as own, distributed.Client(scheduler_file=str(own.file), timeout=30) as client:
        client.wait_for_workers(1, timeout=60)
        client.run(_slow)
        gone: list[float] = []

        def told(doing: str, done: int, total: int) -> None:
            if doing == "read":
                gone.append(time.monotonic())
                own.scheduler.send_signal(how)

        with pytest.raises(rs.ExecutorError, match="scheduler at tcp://"):
            rs.build(folder / "a.npy", columns=["x", "y", "z"], path=out / "out.rset", executor=client, timeout=4, progress=told)
        assert gone and time.monotonic() - gone[0] < 4 + 5
        assert _is_soon(lambda: os.listdir(out) == []), os.listdir(out)
        own.scheduler.send_signal(signal.SIGKILL)
        own.workers[0].wait(timeout=60)
        assert os.listdir(out) == []


def test_no_workers_are_an_error_in_time(folder: Path) -> None:
    begun = time.monotonic()
    with _cluster(0) as cluster, distributed.Client(cluster) as client:
        with pytest.raises(rs.ExecutorError, match="no workers for 1 s"):
            rs.render(_scene("opaque", folder), executor=client, timeout=1)
    assert time.monotonic() - begun < 10


BUILD = """
import sys, distributed, rayset as rs
if __name__ == "__main__":
    with distributed.Client(scheduler_file=sys.argv[1]) as client:
        rs.build(sys.argv[2], columns=["x", "y", "z"], path=sys.argv[3], executor=client, progress=lambda *step: print(*step, flush=True))
"""


def test_what_a_killed_client_leaves_the_next_build_removes(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    script = tmp_path / "build.py"
    script.write_text(BUILD)
    with _Own(tmp_path) as own, distributed.Client(scheduler_file=str(own.file), timeout=30) as client:
        client.wait_for_workers(1, timeout=60)
        client.run(_slow)
        arguments = [sys.executable, str(script), str(own.file), str(folder / "a.npy"), str(out / "out.rset")]
        process = subprocess.Popen(arguments, stdout=subprocess.PIPE)
        assert process.stdout is not None and process.stdout.readline().startswith(b"read")
        process.kill()
        process.wait()
        process.stdout.close()
        left = os.listdir(out)
        assert len(left) == 1 and left[0].startswith(".out.rset.rayset-parts-")
        rs.build(folder / "a.npy", columns=["x", "y", "z"], path=out / "out.rset", executor=client)
        assert os.listdir(out) == ["out.rset"]


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
    assert time.monotonic() - begun < 5
    assert _is_soon(lambda: not any(client.processing().values()))
    with pytest.raises(RuntimeError, match="enough"):
        rs.build(folder / "a.npy", columns=["x", "y", "z"], path=tmp_path / "out.rset", executor=client, progress=enough)
    assert os.listdir(tmp_path) == []
    # Threads of workers are free.
    assert set(client.run(_is_idle).values()) == {True}


def _is_idle() -> bool:
    from rayset._executor import worker

    return not worker._running


def _is_soon(holds: Callable[[], bool]) -> bool:
    end = time.monotonic() + 20
    while not holds():
        if time.monotonic() > end:
            return False
        time.sleep(0.05)
    return True


def test_what_workers_do_not_see_is_said(client: Any, folder: Path, tmp_path: Path, cloud: rs.Cloud) -> None:
    with pytest.raises(ValueError, match="in the memory of this process.*rs.build"):
        rs.render(cloud, executor=client)
    with pytest.raises(TypeError, match="in the memory of this process"):
        rs.build(points(), path=tmp_path / "out.rset", executor=client)
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
    scene = _scene("opaque", folder)
    with pytest.raises(TypeError, match="expected a client of dask.distributed"):
        rs.render(scene, executor=4)
    for options in ({"threads": 2}, {"session": rs.Session()}, {"progressive": True}):
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

    scene = _scene("opaque", folder)
    best = rs.render(scene, executor=two)
    two.run(old, workers=[min(two.nthreads())])
    lowest = rs.render(scene, executor=two)
    name = next(name for name, fused in _native.instructions() if not fused)
    with rs.Session(_simd=name) as session:
        assert _are_same(lowest, session.render(scene))
    assert not np.array_equal(lowest.linear, best.linear)


def test_workers_of_other_versions_are_named(two: Any, folder: Path) -> None:
    def other() -> None:
        from rayset import _native

        _native.__version__ = "0.0.9"

    worker = min(two.nthreads())
    two.run(other, workers=[worker])
    with pytest.raises(rs.ExecutorError, match=rf"versions of rayset.*{worker}\): 0\.0\.9"):
        rs.render(_scene("opaque", folder), executor=two)
