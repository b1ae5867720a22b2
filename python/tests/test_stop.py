"""Everything can be stopped, and leaves nothing behind."""

from __future__ import annotations

import os
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import numpy as np
import pytest

import rayset as rs

#: How late a call may return, in seconds. What it takes is a few hundredths; machines that test are busy.
LATEST = 1.0

BEGIN = """
    import os, signal, sys, threading, time
    import numpy as np
    import rayset as rs
    rng = np.random.default_rng(1)
    def interrupt(after):
        def work():
            time.sleep(after)
            global sent
            sent = time.perf_counter()
            os.kill(os.getpid(), signal.SIGINT)
        threading.Thread(target=work, daemon=True).start()
"""
WORK = {
    "a build in memory": "rs.build(rng.random((4_000_000, 3)))",
    "a build to a file": "rs.build(rng.random((4_000_000, 3)), path='out.rset', memory='48MiB')",
    "a build of chunks": "rs.build((rng.random((100_000, 3)) for _ in range(10_000)), path='out.rset', memory='48MiB')",
    "an input that is built": "rs.open('big.npy', cache='cache')",
    "a render": "rs.render(rs.build(rng.random((20_000, 3))), size=3000, samples=8)",
    "an iterator of pictures": "list(rs.render(rs.build(rng.random((20_000, 3))), size=3000, samples=8, progressive=True))",
}


def _python(code: str, folder: Path) -> subprocess.CompletedProcess[str]:
    text = textwrap.dedent(code)
    package = str(Path(rs.__file__).parents[1])
    paths = os.pathsep.join([package, os.environ.get("PYTHONPATH", "")])
    environment = {**os.environ, "PYTHONPATH": paths, "TMPDIR": str(folder / "tmp"), "XDG_CACHE_HOME": str(folder / "home")}
    (folder / "tmp").mkdir(exist_ok=True)
    return subprocess.run(
        [sys.executable, "-c", text], cwd=folder, env=environment, capture_output=True, text=True, timeout=120
    )


@pytest.mark.parametrize("what", WORK)
def test_ctrl_c_ends_it_at_once_and_leaves_nothing(what: str, tmp_path: Path) -> None:
    code = textwrap.dedent(BEGIN) + textwrap.dedent(
        f"""
        np.save('big.npy', rng.random((4_000_000, 3))) if 'big.npy' in {WORK[what]!r} else None
        interrupt(0.35)
        try:
            {WORK[what]}
            print('it was finished')
        except KeyboardInterrupt:
            print('late', time.perf_counter() - sent)
        print('works', len(rs.build(rng.random((100, 3)))))
        """
    )
    run = _python(code, tmp_path)
    assert "works 100" in run.stdout, run.stdout + run.stderr
    late = float(run.stdout.split("late ")[1].split()[0])
    assert late < LATEST, late
    left = {p.name for p in tmp_path.rglob("*")} - {"tmp", "home", "cache", "big.npy"}
    assert not left, left


def test_a_callback_that_raises_ends_a_build_and_leaves_nothing(tmp_path: Path) -> None:
    def progress(*_: object) -> None:
        raise LookupError("enough")

    with pytest.raises(LookupError, match="enough"):
        rs.build(np.random.default_rng(1).random((2_000_000, 3)), path=tmp_path / "out.rset", progress=progress)
    assert not list(tmp_path.glob("*.rset*"))


def test_pictures_that_nobody_waits_for_are_not_finished() -> None:
    cloud = rs.build(np.random.default_rng(1).random((20_000, 3)))
    started = time.perf_counter()
    with rs.render(cloud, size=4000, samples=8, progressive=True) as pictures:
        next(pictures)
    assert time.perf_counter() - started < 30
    assert list(pictures) == []
