"""Wrong use: every mistake is an exception whose message says what to do. The messages are in `mistakes.txt`, which
`python tests/test_mistakes.py --bless` writes."""

from __future__ import annotations

import json
import multiprocessing
import os
import pickle
import re
import sys
import tempfile
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import rayset as rs

GOLDEN = Path(__file__).with_name("mistakes.txt")
N = 200


def _places() -> Any:
    return np.random.default_rng(1).normal(size=(N, 3))


def _cloud() -> rs.Cloud:
    return rs.build(_places(), radius=0.3, attributes={"T": np.arange(N, dtype="f4")})


def _chunks(*chunks: Any) -> Any:
    return iter(chunks)


def _raises(what: Any) -> Any:
    yield _places()
    raise what


def _closed() -> Any:
    session = rs.Session(memory="64MiB", threads=1)
    session.close()
    return session


def _raising_progress(*_: object) -> None:
    raise RuntimeError("the callback has failed")


def _in_fork() -> None:
    """Uses a session of the parent in a forked child, and raises what that raises."""
    session = rs.Session(memory="64MiB", threads=1)
    cloud = _cloud()
    parent, child = multiprocessing.Pipe()

    def work() -> None:
        try:
            session.render(cloud, size=8)
            child.send("nothing was raised")
        except Exception as error:
            child.send((type(error).__name__, str(error)))

    process = multiprocessing.get_context("fork").Process(target=work)
    process.start()
    name, words = parent.recv()
    process.join()
    raise getattr(rs, name)(words)


def _in_thread() -> None:
    """What is raised in another thread than the main one."""
    raised: list[BaseException] = []

    def work() -> None:
        try:
            rs.render(_cloud(), look="gass", size=8)
        except BaseException as error:
            raised.append(error)

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    raise raised[0]


def _damaged() -> Any:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "damaged.rset"
        _cloud().save(path)
        data = bytearray(path.read_bytes())
        data[20000] ^= 1
        path.write_bytes(data)
        rs.render(rs.open(path), size=8)


def _file(name: str, content: bytes) -> Callable[[], Any]:
    def opened() -> Any:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / name
            path.write_bytes(content)
            return rs.open(path)

    return opened


def _overwritten() -> Any:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.rset"
        _cloud().save(path)
        rs.open(path).save(path)


SCENE: dict[str, Any] = {"rayset": 1, "root": {"type": "sphere", "radius": 1}}

MISTAKES: dict[str, Callable[[], Any]] = {
    # Shapes and types of arrays.
    "positions, transposed": lambda: rs.build(_places().T),
    "positions of two coordinates": lambda: rs.build(_places()[:, :2]),
    "positions with columns behind them": lambda: rs.build(np.zeros((N, 6))),
    "positions of one axis": lambda: rs.build(np.zeros(30)),
    "no positions": lambda: rs.build(np.zeros((0, 3))),
    "positions that are words": lambda: rs.build(np.array([["a", "b", "c"]])),
    "complex positions": lambda: rs.build(_places() + 1j),
    "positions that are a list of different lengths": lambda: rs.build([[1, 2, 3], [4, 5]]),
    "positions that are None": lambda: rs.build(None),
    "positions that are a path": lambda: rs.build("points.npy"),
    "all positions NaN": lambda: rs.build(np.full((N, 3), np.nan)),
    "NaN where they are to be raised": lambda: rs.build(np.vstack([_places(), [[np.nan, 0, 0]]]), radius=1, invalid="raise"),
    "positions too large to be stored": lambda: rs.build(_places() * 1e30, radius=1),
    "radius of another length": lambda: rs.build(_places(), radius=np.ones(N - 1)),
    "radius that is 0": lambda: rs.build(_places(), radius=0),
    "radius that is negative": lambda: rs.build(_places(), radius=-1.0),
    "radius that is NaN": lambda: rs.build(_places(), radius=float("nan")),
    "radii that are all 0": lambda: rs.build(_places(), radius=np.zeros(N)),
    "radius by the name of a column that is not there": lambda: rs.build(_places(), radius="h"),
    "weight that is a word": lambda: rs.build(_places(), weight="mass"),
    "attributes that are a list": lambda: rs.build(_places(), attributes=[np.ones(N)]),  # type: ignore[arg-type]
    "an attribute of another length": lambda: rs.build(_places(), attributes={"T": np.ones(3)}),
    "an attribute of vectors": lambda: rs.build(_places(), attributes={"v": np.ones((N, 3))}),
    "an attribute of words": lambda: rs.build(_places(), attributes={"name": np.array(["a"] * N)}),
    "an attribute of a name that is taken": lambda: rs.build(_places(), attributes={"radius": np.ones(N)}),
    "an attribute without a name": lambda: rs.build(_places(), attributes={"": np.ones(N)}),
    "colours of 0 to 255 as floats": lambda: rs.build(_places(), color=np.full((N, 3), 200.0)),
    "colours of another length": lambda: rs.build(_places(), color=np.zeros((3, 3), dtype="u1")),
    "colours with one channel": lambda: rs.build(_places(), color=np.zeros(N)),
    "classes that are no attributes": lambda: rs.build(_places(), classes=["kind"]),
    "classes that are floats": lambda: rs.build(_places(), attributes={"T": np.ones(N)}, classes=["T"]),
    "classes that are a word": lambda: rs.build(_places(), classes="kind"),
    # Options of builds.
    "memory that is no size": lambda: rs.build(_places(), memory="8 apples"),
    "memory that is negative": lambda: rs.build(_places(), memory=-1),
    "memory that is a float": lambda: rs.build(_places(), memory=1e9),  # type: ignore[arg-type]
    "memory that is too small": lambda: rs.build(_places(), memory="1MiB", path="/tmp/never.rset"),
    "no threads": lambda: rs.build(_places(), threads=0),
    "invalid that is unknown": lambda: rs.build(_places(), invalid="drop"),
    "precision that is a word": lambda: rs.build(_places(), precision="double"),
    "progress that cannot be called": lambda: rs.build(_places(), progress="yes"),  # type: ignore[arg-type]
    "an output in a folder that is not there": lambda: rs.build(_places(), path="/nowhere/a.rset"),
    "an argument that is unknown": lambda: rs.build(_places(), radii=1),  # type: ignore[call-arg]
    # Chunks.
    "an iterator without chunks": lambda: rs.build(_chunks()),
    "a chunk without a column of the first": lambda: rs.build(_chunks({"positions": _places(), "T": np.ones(N)}, {"positions": _places()})),
    "a chunk of a wider type": lambda: rs.build(_chunks({"positions": _places(), "T": np.ones(N, "f4")}, {"positions": _places(), "T": np.ones(N)})),
    "a chunk that is no points": lambda: rs.build(_chunks(_places(), 7)),
    "chunks beside arrays": lambda: rs.build(_chunks(_places()), attributes={"T": np.ones(N)}),
    "an iterator that raises": lambda: rs.build(_raises(KeyError("Coordinates"))),
    "a callback that raises": lambda: rs.build((np.random.default_rng(k).normal(size=(20000, 3)) for k in range(100)), progress=_raising_progress),
    "a table without positions": lambda: rs.build({"a": np.ones(3), "b": np.ones(3)}),
    # Grids.
    "voxels of two axes": lambda: rs.build_grid(np.zeros((4, 4))),
    "voxels of one slice": lambda: rs.build_grid(np.zeros((1, 4, 4))),
    "complex voxels": lambda: rs.build_grid(np.zeros((4, 4, 4), dtype=complex)),
    "a spacing of 0": lambda: rs.build_grid(np.zeros((4, 4, 4)), spacing=0.0),
    # Files.
    "a file that is not there": lambda: rs.open("/nowhere/site.rset"),
    "a file of an unknown kind": _file("points.bin2", b"what is this? nothing that is known"),
    "a file that is cut off": _file("cut.rset", b"RAYSET"),
    "a damaged page": _damaged,
    "bytes that are nothing": lambda: rs.open(b"12345678"),
    "a pattern that matches nothing": lambda: rs.open("/nowhere/*.laz"),
    "an empty list of files": lambda: rs.open([]),
    "open of a number": lambda: rs.open(7),
    "saving over what is open": _overwritten,
    # Scenes and pictures.
    "a look that is unknown": lambda: rs.render(_cloud(), look="gass", size=8),
    "an option that is unknown": lambda: rs.render(_cloud(), colourmap="viridis", size=8),
    "an attribute that is not there": lambda: rs.render(_cloud(), color_by="temperature", size=8),
    "a look for voxels": lambda: rs.render(_cloud(), look="volume", size=8),
    "a look for solids": lambda: rs.render(rs.Sphere((0, 0, 0), 1), look="gas", size=8),
    "a look for a scene": lambda: rs.render(rs.Scene.from_json(SCENE), look="gas", size=8),
    "a size of 0": lambda: rs.render(_cloud(), size=(0, 100)),
    "a crop beyond the picture": lambda: rs.render(_cloud(), size=64, crop=(60, 60, 10, 10)),
    "a crop of two numbers": lambda: rs.render(_cloud(), size=64, crop=(60, 60)),
    "65 samples": lambda: rs.render(_cloud(), samples=65),
    "rendering an array": lambda: rs.render(_places()),
    "a camera that is a dictionary": lambda: rs.render(_cloud(), camera={"position": (0, 0, 3)}),  # type: ignore[call-overload]
    "a camera without a direction": lambda: rs.Camera((0, 0, 3)),
    "a camera whose up is 0": lambda: rs.Camera((0, 0, 3), look_at=(0, 0, 0), up=(0, 0, 0)),
    "a camera that looks along its up": lambda: rs.render(_cloud(), size=8, camera=rs.Camera((0, 0, 3), direction=(0, 0, 1), up=(0, 0, 1))),
    "a camera of two numbers": lambda: rs.Camera((0, 3), look_at=(0, 0, 0)),
    "fitting an array": lambda: rs.Camera.fit(_places()),
    "a view that is unknown": lambda: rs.Camera.fit(_cloud(), view="above"),
    "a box inside out": lambda: rs.Box((1, 1, 1), (0, 0, 0)),
    "a ball without a radius": lambda: rs.Sphere((0, 0, 0), 0),
    "a solid with an unknown style": lambda: rs.Sphere((0, 0, 0), 1, colour="#ffffff"),
    "a colour that is none": lambda: rs.render(rs.Sphere((0, 0, 0), 1, color="reddish"), size=8),
    "an operator with a number": lambda: _cloud() - 1,  # type: ignore[operator]
    "a cap on a union": lambda: (_cloud() | rs.Sphere((0, 0, 0), 1)).with_cap("#ffffff"),
    "a flat transform": lambda: rs.render(_cloud().scaled((1, 1, 0)), size=8),
    "a scene that is no JSON": lambda: rs.Scene.from_json("{"),
    "a scene with an unknown key": lambda: rs.render(rs.Scene.from_json({**SCENE, "camra": {}}), size=8),
    "a scene without a root": lambda: rs.render(rs.Scene.from_json({"rayset": 1}), size=8),
    "a scene whose file is not there": lambda: rs.render(rs.Scene.from_json({"rayset": 1, "root": {"type": "cloud", "file": "/nowhere.rset"}}), size=8),
    "lights that are a word": lambda: rs.render(_cloud(), lights="sun", size=8),
    "a picture in another format": lambda: rs.render(_cloud(), size=8).save("a.jpg"),
    "depth of a picture without layers": lambda: rs.render(_cloud(), size=8, layers=False).depth,
    "a budget that is too small for a scene": lambda: rs.Session(memory=1000, threads=1).render(_cloud(), size=8),
    # Sessions, threads, processes.
    "a closed session": lambda: _closed().render(_cloud(), size=8),
    "a session that is a number": lambda: rs.render(_cloud(), session=2),  # type: ignore[call-overload]
    "a session and a budget": lambda: rs.render(_cloud(), session=_closed(), memory="1GiB"),
    "pickling a cloud in memory": lambda: pickle.dumps(_cloud()),
    "pickling a session": lambda: pickle.dumps(_closed()),
    "a session after a fork": _in_fork,
    "a mistake in another thread": _in_thread,
}


def said(name: str) -> str:
    """The exception of a mistake: its class and its words, without what differs from run to run."""
    try:
        MISTAKES[name]()
    except BaseException as error:
        words = f"{type(error).__name__}: {error}"
        words = re.sub(r"/tmp/[A-Za-z0-9_./-]*", "/tmp/…", words)
        words = words.replace(os.path.realpath(tempfile.gettempdir()), "/tmp")
        words = re.sub(r"memory:\d+", "memory:N", words)
        words = re.sub(r"0x[0-9a-f]+", "0x…", words)
        # Bytes of memory, which are others with every table of the program: two megabytes and some.
        words = re.sub(r"needs at least 2\d{6}\b", "needs at least 2…", words)
        # Python 3.13 has ideas of its own.
        words = re.sub(r"\. Did you mean '\w+'\?$", "", words)
        return words.replace("\n", " ")
    return "nothing was raised"


def listing() -> str:
    return "".join(f"{name}\n    {said(name)}\n" for name in MISTAKES)


def test_every_mistake_has_the_words_that_were_agreed_on() -> None:
    assert len(MISTAKES) >= 60
    found, expected = listing().splitlines(), GOLDEN.read_text(encoding="utf-8").splitlines()
    differ = [f"{a}\n  where\n{b}" for a, b in zip(found, expected) if a != b]
    assert not differ and len(found) == len(expected), "\n".join(differ)


def test_no_mistake_goes_unnoticed_or_is_an_internal_error() -> None:
    for line in GOLDEN.read_text(encoding="utf-8").splitlines():
        assert "nothing was raised" not in line and "internal" not in line and "Panic" not in line, line


if __name__ == "__main__":
    if "--bless" in sys.argv:
        GOLDEN.write_text(listing(), encoding="utf-8")
    else:
        print(json.dumps(list(MISTAKES)), file=sys.stdout)
