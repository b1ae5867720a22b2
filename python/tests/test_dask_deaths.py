"""Workers, schedulers and clients that die: the same bytes, or an error in time, and nothing left behind."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import pytest
from clusters import are_same, cluster_of, distributed, folder, is_soon, scene_of, two  # noqa: F401

import rayset as rs


def _deadly(function: str, marker: str, delay: float, step: str | None) -> None:
    """On a worker: the next task of that function dies so long after it has begun, once of all workers; if its work is done sooner,
    it dies before it can say so."""
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
        timer = threading.Timer(delay, os.kill, (os.getpid(), signal.SIGKILL))
        timer.start()
        try:
            return original(*arguments)
        finally:
            timer.join()

    setattr(worker, function, wrapped)


def test_a_worker_that_dies_at_a_share_does_not_matter(two: Any, folder: Path, tmp_path: Path) -> None:
    scene = rs.Scene(rs.open(folder / "cloud.rset"), look="gas", size=(480, 360), samples=4)
    two.run(_deadly, "render_share", str(tmp_path / "dead"), 0.05, None)
    image = rs.render(scene, executor=two)
    assert (tmp_path / "dead").exists()
    assert are_same(image, rs.render(scene))


def test_a_worker_that_dies_at_a_frame_does_not_matter(two: Any, folder: Path, tmp_path: Path) -> None:
    scene = rs.Scene(rs.open(folder / "cloud.rset"), look="gas", size=(320, 240), samples=2)
    two.run(_deadly, "render_share", str(tmp_path / "dead"), 0.05, None)
    there = list(rs.render_frames(scene, turntable=5, executor=two))
    assert (tmp_path / "dead").exists()
    assert all(map(are_same, there, rs.render_frames(scene, turntable=5))) and len(there) == 5


@pytest.mark.parametrize("step", ["read", "spacing-measure", "scatter", "order", "merge"])
def test_a_worker_that_dies_at_a_build_does_not_matter(step: str, two: Any, folder: Path, tmp_path: Path) -> None:
    out, dead = tmp_path / "out", tmp_path / "dead"
    out.mkdir()
    options: dict[str, Any] = {"columns": ["x", "y", "z"]}
    rs.build(folder / "a.npy", path=out / "here.rset", **options)
    two.run(_deadly, *(("merge", str(dead), 0.005, None) if step == "merge" else ("build_step", str(dead), 0.005, step)))
    rs.build(folder / "a.npy", path=out / "there.rset", executor=two, **options)
    assert dead.exists()
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
        rs.render(scene_of("opaque", folder), executor=two)


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
    """On a worker: every part of a step, and every share, takes a second longer."""
    from rayset._executor import worker

    def slowed(original: Any) -> Any:
        def wrapped(*arguments: Any) -> Any:
            outcome = original(*arguments)
            time.sleep(1)
            return outcome

        return wrapped

    worker.build_step = slowed(worker.build_step)  # type: ignore[assignment]
    worker.render_share = slowed(worker.render_share)  # type: ignore[assignment]


@pytest.mark.parametrize("work", ["build", "picture", "passes", "frames"])
@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGSTOP], ids=["killed", "stopped"])
def test_a_scheduler_that_is_gone_is_an_error_in_time(how: signal.Signals, work: str, folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    scene = scene_of("opaque", folder)
    with _Own(tmp_path) as own, distributed.Client(scheduler_file=str(own.file), timeout=30) as client:
        client.wait_for_workers(1, timeout=60)
        client.run(_slow)
        gone: list[float] = []

        def told(doing: str, done: int, total: int) -> None:
            if doing in ("read", "tracing", "frames") and not gone:
                gone.append(time.monotonic())
                own.scheduler.send_signal(how)

        options: dict[str, Any] = {"executor": client, "timeout": 4}
        with pytest.raises(rs.ExecutorError, match="scheduler at tcp://"):
            if work == "build":
                rs.build(folder / "a.npy", columns=["x", "y", "z"], path=out / "out.rset", progress=told, **options)
            elif work == "picture":
                rs.render(scene, progress=told, **options)
            elif work == "frames":
                list(rs.render_frames(scene, turntable=9, progress=told, **options))
            else:
                for _ in rs.render(scene, progressive=True, **options):
                    told("tracing", 0, 1)
        # Other work on the machine delays whatever is measured here.
        assert gone and time.monotonic() - gone[0] < 4 + 30
        assert is_soon(lambda: not any(thread.name == "rayset-pulse" for thread in threading.enumerate()))
        assert is_soon(lambda: os.listdir(out) == []), os.listdir(out)
        own.scheduler.send_signal(signal.SIGKILL)
        own.workers[0].wait(timeout=120)
        assert os.listdir(out) == []


def test_no_workers_are_an_error_in_time(folder: Path) -> None:
    begun = time.monotonic()
    with cluster_of(0) as cluster, distributed.Client(cluster) as client:
        with pytest.raises(rs.ExecutorError, match="no workers for 1 s"):
            rs.render(scene_of("opaque", folder), executor=client, timeout=1)
    assert time.monotonic() - begun < 40


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
