"""What is too large is an exception, and what is read cannot be taken away; what killed processes leave is removed by the next."""

from __future__ import annotations

import os
import subprocess
import sys
import textwrap
from pathlib import Path

import numpy as np
import pytest
from conftest import points

import rayset as rs


def _run(script: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """Runs a script in a process of its own, which may have 24 GiB of addresses."""
    limit = "import resource\nresource.setrlimit(resource.RLIMIT_AS, (24 << 30, 24 << 30))\n"
    text = limit + "import numpy as np\nimport rayset as rs\n" + textwrap.dedent(script)
    return subprocess.run([sys.executable, "-c", text], cwd=folder, capture_output=True, text=True, timeout=300)


@pytest.mark.skipif(sys.platform != "linux", reason="bounds a process as Linux does")
@pytest.mark.parametrize(
    "words",
    [
        "rs.render(cloud, size=(70000, 70000))",
        "rs.render(cloud, size=(1 << 20, 1 << 20))",
        "rs.render(cloud, size=(70000, 70000), layers=False)",
        "rs.render(cloud, size=(1 << 20, 70000), crop=(0, 0, 1 << 20, 60000))",
        "next(rs.render(cloud, size=(1 << 20, 1 << 20), progressive=True))",
        "list(rs.render_frames(cloud, turntable=1 << 31, size=8))",
        "rs.build(np.broadcast_to(np.zeros(3), (1 << 40, 3)), radius=1)",
    ],
)
def test_what_no_memory_has_room_for_is_an_exception(words: str, tmp_path: Path) -> None:
    ended = _run(
        f"""
        cloud = rs.build(np.random.default_rng(1).normal(size=(1000, 3)), radius=0.1)
        try:
            {words}
        except (MemoryError, ValueError) as error:
            print(type(error).__name__, error)
        assert rs.render(cloud, size=8).size == (8, 8)
        """,
        tmp_path,
    )
    assert ended.returncode == 0, (ended.returncode, ended.stderr)
    if "turntable" not in words:
        assert "MemoryError" in ended.stdout and "iB of memory" in ended.stdout, ended.stdout
    assert ended.stdout, "nothing was raised"


@pytest.mark.skipif(sys.platform != "linux", reason="bounds a process as Linux does")
def test_a_picture_that_leaves_no_room_for_its_copies_can_still_be_used(tmp_path: Path) -> None:
    ended = _run(
        """
        cloud = rs.build(np.random.default_rng(1).normal(size=(1000, 3)), radius=0.1)
        image = rs.render(cloud, size=(2000, 2000), layers=True, memory="256MiB")
        import resource
        used = int(open("/proc/self/statm").read().split()[0]) * 4096
        resource.setrlimit(resource.RLIMIT_AS, (used + (4 << 20), 24 << 30))
        wrong = 0
        for work in (lambda: image.linear, lambda: image.normal, lambda: image.save("a.png"), lambda: image.save("a.exr")):
            try:
                work()
            except MemoryError:
                wrong += 1
        print("refused", wrong)
        """,
        tmp_path,
    )
    assert ended.returncode == 0, (ended.returncode, ended.stderr)
    # What is recycled may have room; nothing ends the process.
    assert ended.stdout in ("refused 1\n", "refused 2\n", "refused 3\n", "refused 4\n"), ended.stdout


def test_an_array_that_is_read_cannot_be_resized() -> None:
    where, whole = points(20_000), points(20_000)
    heights = where[:, 0].copy()

    def told(array: np.ndarray) -> None:
        def shrink(*_: object) -> None:
            array.resize(30, refcheck=False)

        shape = array.shape
        with pytest.raises(ValueError, match="cannot resize"):
            rs.build(where if array is not whole else whole[::2], radius=0.1, progress=shrink,
                     attributes={"height": heights} if array is not whole else None)
        assert array.shape == shape

    told(where)
    told(heights)
    # That of which it is a part.
    told(whole)
    # Another shape of the same numbers takes nothing away.
    def turn(*_: object) -> None:
        where.shape = (3, 20_000)

    cloud = rs.build(where, radius=0.1, progress=turn)
    assert len(cloud) == 20_000
    where.resize(30, refcheck=False)


@pytest.mark.skipif(os.name != "posix", reason="kills processes")
def test_what_killed_processes_left_is_removed_by_the_next(tmp_path: Path) -> None:
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    text = tmp_path / "points.xyz"
    text.write_text("0 0 0\n1 1 1\n0 1 0\n2 0 1\n")
    script = """
        import numpy as np, rayset as rs, sys, time
        kept = rs.build_grid(np.random.default_rng(1).random((20, 20, 20)))
        cloud = rs.open(sys.argv[2], cache=False)
        print("made", flush=True)
        time.sleep(float(sys.argv[1]))
    """

    def start(seconds: str) -> subprocess.Popen[str]:
        command = [sys.executable, "-c", textwrap.dedent(script), seconds, str(text)]
        environment = os.environ | {"TMPDIR": str(temporary)}
        process = subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True)
        assert process.stdout is not None and process.stdout.readline() == "made\n"
        return process

    def left() -> set[str]:
        return {path.name for path in temporary.iterdir()}

    for end in (subprocess.Popen.kill, subprocess.Popen.terminate):
        killed = start("600")
        before = left()
        assert before
        end(killed)
        killed.wait()
        assert left() == before
        # One that goes on keeps what is its own.
        other = start("600")
        others = left()
        assert not before & others, "what was left is still there"
        third = start("0")
        third.wait()
        assert left() == others
        other.kill()
        other.wait()
        start("0").wait()
        assert not left()
