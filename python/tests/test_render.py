"""Pictures: those of the program, whole and in parts, in any session and thread."""

from __future__ import annotations

import json
import os
import subprocess
import threading
from pathlib import Path

import numpy as np
import pytest
from conftest import points, program

import rayset as rs

REPOSITORY = Path(__file__).resolve().parents[2]


def _by_program(folder: Path, *arguments: str) -> bytes:
    name = program()
    if name is None:
        pytest.skip("the program is not installed")
    output = folder / "program.png"
    subprocess.run([name, "render", *arguments, "-o", str(output)], check=True, capture_output=True, cwd=folder)
    return output.read_bytes() if output.exists() else b""


def test_a_picture_is_an_array_and_shows_itself(cloud: rs.Cloud) -> None:
    image = rs.render(cloud, size=(64, 48))
    array = np.asarray(image)
    assert array.shape == (48, 64, 4) and array.dtype == np.uint8
    assert image.linear.shape == (48, 64, 4) and image.linear.dtype == np.float32
    assert image._repr_png_().startswith(b"\x89PNG")
    seen = image.opacity > 0.9
    assert seen.sum() > 200 and np.isfinite(image.depth[seen]).all() and np.isinf(image.depth[image.opacity == 0]).all()
    assert np.allclose(np.linalg.norm(image.normal[seen], axis=1), 1, atol=1e-3)
    assert set(np.unique(image.instance)) <= {0, 1}


def test_pictures_of_linear_light_say_if_they_were_composited_in_display_values(cloud: rs.Cloud, tmp_path: Path) -> None:
    for compositing, said in [("display", True), ("linear", False)]:
        path = tmp_path / f"{compositing}.exr"
        rs.render(cloud, size=(16, 12), look="gas", compositing=compositing).save(path)
        assert (b"composited in display values" in path.read_bytes()) == said


@pytest.mark.parametrize("look", [[], ["--look", "gas"], ["--look", "surface", "--color-by", "T", "--colormap", "magma"]])
def test_the_package_and_the_program_make_the_same_bytes(look: list[str], cloud: rs.Cloud, tmp_path: Path) -> None:
    cloud.save(tmp_path / "cloud.rset")
    expected = _by_program(tmp_path, "cloud.rset", "--size", "160x120", *look)
    options = {key.lstrip("-").replace("-", "_"): value for key, value in zip(look[::2], look[1::2])}
    rs.render(rs.open(tmp_path / "cloud.rset"), size=(160, 120), **options).save(tmp_path / "a.png")
    rs.render(cloud, size=(160, 120), **options).save(tmp_path / "b.png")
    assert (tmp_path / "a.png").read_bytes() == expected
    assert (tmp_path / "b.png").read_bytes() == expected


def test_scenes_of_solids_are_the_same_bytes_as_the_programs(tmp_path: Path) -> None:
    path = REPOSITORY / "examples" / "mirrors.json"
    scene = rs.Scene.load(path)
    expected = _by_program(tmp_path, str(path), "--size", "72x48")
    rs.render(scene, size=(72, 48)).save(tmp_path / "a.png")
    assert (tmp_path / "a.png").read_bytes() == expected


def test_a_grid_is_the_same_bytes_as_the_programs(tmp_path: Path) -> None:
    z, y, x = np.mgrid[-1:1:24j, -1:1:24j, -1:1:24j]
    grid = rs.build_grid(np.exp(-4 * (x * x + y * y + z * z)), spacing=0.1, path=tmp_path / "g.rset")
    expected = _by_program(tmp_path, "g.rset", "--size", "96x96")
    rs.render(grid, size=96).save(tmp_path / "a.png")
    assert (tmp_path / "a.png").read_bytes() == expected


def test_a_part_of_a_picture_is_the_same_pixels(cloud: rs.Cloud) -> None:
    whole = np.asarray(rs.render(cloud, size=100))
    part = np.asarray(rs.render(cloud, size=100, crop=(30, 20, 40, 50)))
    assert np.array_equal(part, whole[20:70, 30:70])


def test_no_session_changes_a_pixel(cloud: rs.Cloud, tmp_path: Path) -> None:
    cloud.save(tmp_path / "c.rset")
    on_disk = rs.open(tmp_path / "c.rset")
    expected = np.asarray(rs.render(cloud, size=64))
    for memory, threads in (("64MiB", 1), ("8MiB", 2), ("1GiB", 3)):
        with rs.Session(memory=memory, threads=threads) as session:
            assert np.array_equal(np.asarray(session.render(on_disk, size=64)), expected)
    assert np.array_equal(np.asarray(rs.render(on_disk, size=64, memory="32MiB", threads=1)), expected)


def test_a_progressive_picture_ends_as_the_whole_one(cloud: rs.Cloud) -> None:
    whole = rs.render(cloud, size=(90, 70))
    steps = list(rs.render(cloud, size=(90, 70), progressive=True))
    assert len(steps) >= 3 and all(step.size == (90, 70) for step in steps)
    assert np.array_equal(steps[-1].linear, whole.linear) and np.array_equal(steps[-1].depth, whole.depth)
    assert not np.array_equal(steps[0].linear, whole.linear)
    part = list(rs.render(cloud, size=(90, 70), crop=(11, 13, 31, 17), progressive=True))
    assert all(step.size == (31, 17) for step in part)
    assert np.array_equal(part[-1].linear, whole.linear[13:30, 11:42])


def test_a_scene_is_the_dictionary_that_it_came_from() -> None:
    scene = rs.Scene(
        rs.Sphere((0, 0, 0), 1, color="#c08040") - rs.Box((0, 0, 0), (2, 2, 2)),
        camera=rs.Camera((0, 1, 4), look_at=(0, 0, 0), fovy=40),
        lights=[rs.AmbientLight(0.5), rs.DirectionalLight((-1, -1, -1), shadow=False)],
        background="#202428",
        rendering={"unitDistance": 0.01},
        size=(64, 64),
    )
    document = scene.to_json()
    again = rs.Scene.from_json(json.dumps(document))
    assert again.to_json() == document
    assert np.array_equal(np.asarray(rs.render(again)), np.asarray(rs.render(scene)))


def test_a_scene_of_what_is_in_memory_comes_back_as_long_as_that_is_there() -> None:
    own = rs.build(points(300), radius=0.5)
    document = rs.Scene(own, size=24).to_json()
    expected = np.asarray(rs.render(own, size=24))
    assert np.array_equal(np.asarray(rs.render(rs.Scene.from_json(document))), expected)
    del own
    with pytest.raises(ValueError, match="in memory that is no more"):
        rs.Scene.from_json(document)


def test_operators_are_those_of_scenes() -> None:
    a, b, c = (rs.Sphere((k, 0, 0), 1) for k in range(3))
    assert [(a | b).to_json()["type"], (a & b).to_json()["type"], (a - b).to_json()["type"], (a + b).to_json()["type"]] == [
        "union",
        "intersection",
        "difference",
        "blend",
    ]
    assert len((a | b | c).to_json()["children"]) == 3
    assert (a - (b | c)).to_json()["children"][1]["type"] == "union"
    assert sum([a, b, c]).to_json()["type"] == "blend"
    assert (a | b).moved((1, 2, 3)).rotated("z", 90).to_json()["transform"] == [
        {"translate": [1.0, 2.0, 3.0]},
        {"rotate": {"axis": [0.0, 0.0, 1.0], "degrees": 90.0}},
    ]


def test_a_camera_goes_around_what_it_frames(cloud: rs.Cloud) -> None:
    front = rs.Camera.fit(cloud)
    sums = [rs.render(cloud, camera=front.orbited(90.0 * k), size=48, look="surface").opacity.sum() for k in range(4)]
    assert min(sums) > 0.8 * max(sums) > 200
    assert np.allclose(front.orbited(360).position, front.position)


def _is_whole(image: rs.Image) -> bool:
    """Nothing is cut off at an edge of the picture."""
    seen = image.opacity
    return bool(seen.max() > 0.5 and max(seen[0].max(), seen[-1].max(), seen[:, 0].max(), seen[:, -1].max()) < 0.05)


def test_every_picture_of_a_turntable_shows_all_of_a_thing_and_is_the_programs(tmp_path: Path) -> None:
    # A beam along x, whose end comes toward the eye.
    index = np.arange(8000)
    along, turn = index % 400 * 0.02, index // 400 * 0.314
    beam = rs.build(np.column_stack([along, 0.4 * np.cos(turn), 0.4 * np.sin(turn)]), path=tmp_path / "beam.rset")
    said = {"size": (72, 48), "samples": 1, "background": "none"}
    frames = list(rs.render_frames(beam, turntable=6, **said))
    assert all(map(_is_whole, frames))
    again = list(rs.render_frames(rs.Scene(beam, **said), turntable=6))
    assert all(np.array_equal(a, b) for a, b in zip(map(np.asarray, frames), map(np.asarray, again)))
    # A camera that somebody has chosen stays where it is.
    camera = rs.Camera.fit(beam, view="front", size=(72, 48))
    assert np.array_equal(
        np.asarray(next(rs.render_frames(beam, turntable=6, camera=camera, **said))), np.asarray(rs.render(beam, camera=camera, **said))
    )
    box = rs.Scene.from_json({"rayset": 1, "image": {"size": [72, 48]}, "root": {"type": "box", "size": [1, 1, 8]}})
    assert all(map(_is_whole, rs.render_frames(box, turntable=6)))
    _by_program(tmp_path, "beam.rset", "--turntable", "6", "--size", "72x48", "--samples", "1", "--background", "none")
    for number, frame in enumerate(frames):
        frame.save(tmp_path / "a.png")
        assert (tmp_path / "a.png").read_bytes() == (tmp_path / f"program.{number:04}.png").read_bytes(), number


def test_what_is_cut_away_is_not_seen(cloud: rs.Cloud) -> None:
    camera = rs.Camera.fit(cloud)
    whole = rs.render(cloud, camera=camera, size=64).opacity.sum()
    cut = rs.render(cloud - rs.Box((0, -9, -9), (9, 9, 9)), camera=camera, size=64).opacity.sum()
    nothing = rs.render(cloud & rs.Box((20, 20, 20), (21, 21, 21)), camera=camera, size=64).opacity.sum()
    assert 0.2 * whole < cut < 0.8 * whole and nothing == 0


def test_what_is_seen_fills_the_frame(cloud: rs.Cloud) -> None:
    inside, beyond = rs.Sphere((0, 0, 0), 1, color="#ff0000"), rs.Sphere((12, 0, 0), 1, color="#ff0000")
    for target in (cloud, cloud - inside, cloud | inside, cloud & rs.Box((-9, -9, -9), (0, 9, 9)), cloud | beyond, cloud.moved((50, 0, 0))):
        seen = rs.render(target, size=96, look="surface").opacity > 0.3
        rows, columns = np.flatnonzero(seen.any(axis=1)), np.flatnonzero(seen.any(axis=0))
        assert max(np.ptp(rows), np.ptp(columns)) > 48, target
        edge = seen[0].any() or seen[-1].any() or seen[:, 0].any() or seen[:, -1].any()
        assert not edge, target


def test_saved_scenes_take_along_what_is_in_memory(cloud: rs.Cloud, tmp_path: Path) -> None:
    scene = rs.Scene(cloud - rs.Box((0, 0, 0), (9, 9, 9)), size=48)
    scene.save(tmp_path / "scene.json")
    expected = np.asarray(rs.render(scene))
    assert np.array_equal(np.asarray(rs.render(rs.Scene.load(tmp_path / "scene.json"))), expected)
    by_program = _by_program(tmp_path, "scene.json")
    rs.render(scene).save(tmp_path / "a.png")
    assert (tmp_path / "a.png").read_bytes() == by_program


def test_open_takes_files_folders_lists_and_bytes(tmp_path: Path) -> None:
    for k in range(3):
        np.save(tmp_path / f"part{k}.npy", points(500, seed=k))
    all_of_them = rs.open(str(tmp_path / "part*.npy"), cache=tmp_path / "kept")
    assert len(all_of_them) == 1500
    assert len(rs.open([tmp_path / "part0.npy", tmp_path / "part1.npy"], cache=False)) == 1000
    assert len(rs.open((tmp_path / "part0.npy").read_bytes())) == 500
    assert len(list((tmp_path / "kept").iterdir())) == 1


def test_any_volume_of_a_series_is_opened(tmp_path: Path) -> None:
    series = np.arange(3 * 4 * 5 * 6, dtype="i2").reshape(3, 4, 5, 6)
    np.save(tmp_path / "series.npy", series)
    for index in (None, 0, 1, 2):
        grid = rs.open(tmp_path / "series.npy", volume_index=index, cache=False)
        assert np.array_equal(grid.to_numpy(), series[index or 0])
    data = (tmp_path / "series.npy").read_bytes()
    assert np.array_equal(rs.open(data, volume_index=1).to_numpy(), series[1])
    with pytest.raises(rs.InputError, match="the file has 3 volumes"):
        rs.open(tmp_path / "series.npy", volume_index=3, cache=False)
    with pytest.raises(ValueError, match="volume_index=-1: expected 0 to"):
        rs.open(tmp_path / "series.npy", volume_index=-1)
    with pytest.raises(TypeError, match="volume_index='1': expected a whole number"):
        rs.open(tmp_path / "series.npy", volume_index="1")  # type: ignore[arg-type]


def test_four_threads_render_at_once_and_each_is_right(cloud: rs.Cloud) -> None:
    cameras = [rs.Camera.fit(cloud).orbited(40.0 * k, about=(0, 0, 0)) for k in range(4)]
    expected = [np.asarray(rs.render(cloud, camera=camera, size=64)) for camera in cameras]
    found: dict[int, np.ndarray] = {}

    def work(k: int) -> None:
        for _ in range(3):
            found[k] = np.asarray(rs.render(cloud, camera=cameras[k], size=64))

    threads = [threading.Thread(target=work, args=(k,)) for k in range(4)]
    [thread.start() for thread in threads]
    [thread.join() for thread in threads]
    assert all(np.array_equal(found[k], expected[k]) for k in range(4))


def test_a_forked_process_has_a_session_of_its_own(cloud: rs.Cloud) -> None:
    expected = np.asarray(rs.render(cloud, size=32))
    reads, writes = os.pipe()
    child = os.fork()
    if child == 0:
        same = np.array_equal(np.asarray(rs.render(cloud, size=32)), expected)
        os.write(writes, b"same" if same else b"other")
        os._exit(0)
    os.waitpid(child, 0)
    assert os.read(reads, 9) == b"same"
    os.close(reads)
    os.close(writes)


def test_the_viewer_serves_the_scene(cloud: rs.Cloud) -> None:
    if program() is None:
        pytest.skip("the program is not installed")
    with rs.Scene(cloud, size=32).view(memory="128MiB") as viewer:
        assert viewer.address.startswith("http://127.0.0.1:")
        assert viewer.process.poll() is None
        folder = Path(viewer._folder.path)
        assert folder.exists()
    assert viewer.process.poll() is not None and not folder.exists()
