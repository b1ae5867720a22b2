"""A thousand of anything leaves memory, threads, descriptors and temporary files as they were."""

from __future__ import annotations

import gc
import os
import tempfile
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import points

import rayset as rs

pytestmark = pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="counts by /proc")

#: Bytes that memory may seem to grow by: what an allocator keeps varies.
SLACK = 6 << 20


@pytest.fixture(autouse=True)
def own_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Temporary files of other programs are not counted."""
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr(tempfile, "tempdir", None)


def _state() -> tuple[int, int, int, int]:
    gc.collect()
    status = Path("/proc/self/status").read_text()
    resident = int(status.split("VmRSS:")[1].split()[0]) << 10
    threads = int(status.split("Threads:")[1].split()[0])
    files = len([name for name in os.listdir(tempfile.gettempdir()) if name.startswith("rayset-")])
    return resident, threads, len(os.listdir("/proc/self/fd")), files


def _stays(action: Callable[[int], Any], times: int) -> None:
    """Does it some times to fill caches and pools, then many times. What leaks grows every time; what an allocator keeps does not."""
    for k in range(times // 4):
        action(k)
    states = [_state()]
    while len(states) < 4:
        for k in range(times):
            action(k)
        states.append(_state())
        # Fewer may be left: servers of other tests close their connections when nothing has come for a while.
        assert all(now <= then for now, then in zip(states[-1][1:], states[0][1:], strict=True)), states
        if states[-1][0] <= states[-2][0] + SLACK:
            return
    pytest.fail(f"memory grew three times: {states}")


def test_a_thousand_renders(cloud: rs.Cloud) -> None:
    _stays(lambda k: rs.render(cloud, size=24, samples=1, camera=rs.Camera((0, 0, 9 + k / 100), look_at=(0, 0, 0))), 1000)


def test_two_hundred_builds_and_their_pictures() -> None:
    p = points(500)
    _stays(lambda k: rs.render(rs.build(p + k, radius=0.5), size=8), 200)


def test_two_hundred_cancelled_builds(tmp_path: Path) -> None:
    p = np.random.default_rng(1).random((30_000, 3))

    def cancelled(k: int) -> None:
        def chunks() -> Any:
            yield p
            if k % 2:
                yield p
            raise StopAsyncIteration

        with pytest.raises(StopAsyncIteration):
            rs.build(chunks(), radius=0.01, memory="16MiB", path=tmp_path / "never.rset" if k % 3 else None)

    _stays(cancelled, 200)
    assert not list(tmp_path.iterdir())


def test_two_hundred_abandoned_iterators(cloud: rs.Cloud) -> None:
    def abandoned(k: int) -> None:
        pictures = rs.render(cloud, size=200, samples=4, progressive=True)
        if k % 2:
            next(pictures)
        del pictures

    _stays(abandoned, 200)


def test_two_hundred_sessions(cloud: rs.Cloud) -> None:
    # Servers of tests before this one may have threads that wait for their clients yet.
    before = set(threading.enumerate())

    def session(k: int) -> None:
        with rs.Session(memory="64MiB", threads=2) as one:
            one.render(cloud, size=8)

    _stays(session, 200)
    assert set(threading.enumerate()) <= before


def test_two_hundred_grids_and_files(tmp_path: Path) -> None:
    values = np.random.default_rng(1).random((6, 6, 6))
    rs.build(points(300), radius=0.5, path=tmp_path / "c.rset")

    def opened(_: int) -> None:
        rs.render(rs.build_grid(values), size=8)
        rs.render(rs.open(tmp_path / "c.rset"), size=8)

    _stays(opened, 200)
