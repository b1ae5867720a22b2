"""Arrays of any layout, and chunks of them, become the same cloud."""

from __future__ import annotations

import gc
import logging
import subprocess
from pathlib import Path

import numpy as np
import pytest
from conftest import points, program

import rayset as rs

COUNT = 3000


def _identity(positions: object, **options: object) -> str:
    return rs.build(positions, radius=0.2, **options).identity  # type: ignore[arg-type]


LAYOUTS = {
    "Fortran order": np.asfortranarray,
    "every second row": lambda p: np.repeat(p, 2, axis=0)[::2],
    "backwards twice": lambda p: p[::-1].copy()[::-1],
    "columns of a wider array": lambda p: np.column_stack([p[:, :1] * 9, p, p])[:, 1:4],
    "columns the other way round": lambda p: p[:, ::-1].copy()[:, ::-1],
    "big-endian": lambda p: p.astype(">f8"),
    "a list": lambda p: p.tolist(),
    "a masked array": lambda p: np.ma.masked_array(p, mask=False),
    "a field that is not aligned": lambda p: _packed(p),
}


def _packed(p: np.ndarray) -> np.ndarray:
    record = np.zeros(len(p), dtype=[("flag", "u1"), ("p", "<f8", 3)])
    record["p"] = p
    return record["p"]


@pytest.mark.parametrize("layout", LAYOUTS)
def test_the_layout_of_an_array_does_not_matter(layout: str) -> None:
    p = points(COUNT)
    assert _identity(LAYOUTS[layout](p)) == _identity(p)


def test_arrays_that_may_not_be_written_are_read() -> None:
    p = points(COUNT)
    expected = _identity(p)
    p.flags.writeable = False
    assert _identity(p) == expected


def test_arrays_in_the_layouts_of_the_engine_are_not_copied() -> None:
    import tracemalloc

    p = points(400_000).astype("f4")
    for array in (p, np.asfortranarray(p), p[::2], p[::-1]):
        gc.collect()
        tracemalloc.start()
        rs.build(array, radius=0.01, path=None, memory="64MiB")
        _, peak = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        # NumPy tells tracemalloc of what it allocates; a copy would be 2 to 5 MB.
        assert peak < 1_000_000, peak


@pytest.mark.parametrize("size", [1, 7, 1000, COUNT])
def test_chunks_of_any_size_are_the_cloud_of_the_whole_array(size: int) -> None:
    p, t = points(COUNT), np.arange(COUNT, dtype="i8")
    p, t = (p[:50], t[:50]) if size == 1 else (p, t)
    chunks = ({"positions": p[k : k + size], "T": t[k : k + size]} for k in range(0, len(p), size))
    assert _identity(chunks) == _identity(p, attributes={"T": t})


def test_chunks_may_be_empty_and_arrays_alone() -> None:
    p = points(COUNT)
    assert _identity(iter([p[:0], p[:100], p[:0], p[100:]])) == _identity(p)


def test_a_file_and_memory_have_the_same_cloud(tmp_path: Path) -> None:
    p = points(COUNT)
    on_disk = rs.build(p, radius=0.2, path=tmp_path / "a.rset")
    in_memory = rs.build(p, radius=0.2)
    assert on_disk.identity == in_memory.identity
    assert on_disk.path == str(tmp_path / "a.rset") and in_memory.path is None
    in_memory.save(tmp_path / "b.rset")
    assert (tmp_path / "b.rset").read_bytes() == (tmp_path / "a.rset").read_bytes()
    assert rs.open((tmp_path / "b.rset").read_bytes()).identity == on_disk.identity


def test_a_file_gets_the_aggregates_of_the_program(tmp_path: Path) -> None:
    p = points(COUNT)
    made = {lod: rs.build(p, path=tmp_path / f"{lod}.rset", lod=lod) for lod in (None, False, True)}
    by_default, without, with_them = ((tmp_path / f"{lod}.rset").read_bytes() for lod in made)
    assert by_default == without and len(with_them) > len(without), "by default, only those of much gas"
    if (own := program()) is not None:
        subprocess.run([own, "lod", tmp_path / "False.rset", "-o", tmp_path / "b.rset"], check=True, capture_output=True)
        assert (tmp_path / "b.rset").read_bytes() == with_them
    np.save(tmp_path / "p.npy", p)
    of_file = []
    for lod in (False, True):
        rs.build(tmp_path / "p.npy", columns=["x", "y", "z"], path=tmp_path / "c.rset", lod=lod)
        of_file.append((tmp_path / "c.rset").stat().st_size)
    assert of_file[1] - of_file[0] == len(with_them) - len(without)
    rs.build(iter([p[:1000], p[1000:]]), path=tmp_path / "d.rset", lod=True)
    assert (tmp_path / "d.rset").read_bytes() == with_them


def test_much_gas_gets_aggregates_by_default(tmp_path: Path) -> None:
    p = points(200_000).astype("f4")
    smoothed = {"radius": np.full(len(p), 0.1, "f4"), "weight": np.ones(len(p), "f4")}
    sizes = []
    for lod in (None, False):
        rs.build(p, **smoothed, path=tmp_path / "a.rset", lod=lod)
        sizes.append((tmp_path / "a.rset").stat().st_size)
    assert sizes[0] > sizes[1]


def test_who_gives_too_little_memory_for_aggregates_has_the_cloud_without_them(tmp_path: Path) -> None:
    p = points(COUNT)
    rs.build(p, path=tmp_path / "without.rset", lod=False)
    without = (tmp_path / "without.rset").read_bytes()
    with pytest.raises(rs.MemoryBudgetError, match="is built, but has no aggregates.* bytes of memory are too few"):
        rs.build(p, path=tmp_path / "a.rset", memory="16MiB", lod=True)
    assert (tmp_path / "a.rset").read_bytes() == without
    assert sorted(each.name for each in tmp_path.glob("*")) == ["a.rset", "without.rset"]


def test_points_without_aggregates_are_built_and_said(tmp_path: Path) -> None:
    with pytest.warns(rs.RaysetWarning, match="has no aggregates"):
        rs.build(points(50), radius=0.5, weight=-1, path=tmp_path / "a.rset", lod=True)
    assert rs.open(tmp_path / "a.rset").points == 50
    with pytest.raises(TypeError, match="lod: say path="):
        rs.build(points(50), lod=True)
    with pytest.raises(TypeError, match="lod='auto': expected True"):
        rs.build(points(50), path=tmp_path / "b.rset", lod="auto")  # type: ignore[arg-type]


@pytest.mark.parametrize("kind", ["u1", "i1", "u2", "i2", "u4", "i4", "u8", "i8", "f4", "f8"])
def test_columns_keep_their_type_and_their_values(kind: str) -> None:
    values = np.arange(100).astype(kind)
    cloud = rs.build(points(100), radius=1, attributes={"v": values}, precision="exact")
    column = cloud.attributes["v"]
    assert column.type == {"u": "u", "i": "i", "f": "f"}[kind[0]] + str(8 * int(kind[1]))
    _, columns = cloud.sample(100)
    assert sorted(columns["v"]) == sorted(values)


def test_large_integers_and_times_are_exact() -> None:
    ids = np.arange(50, dtype="u8") + 2**60
    times = 1.3e9 + np.arange(50) * 1e-6
    cloud = rs.build(points(50), radius=1, attributes={"id": ids, "time": times})
    assert cloud.attributes["time"].range == (times[0], times[-1])


def test_exact_positions_come_back_bit_for_bit() -> None:
    p = points(500) * 1e6 + 4e6
    cloud = rs.build(p, radius=100.0, precision="exact")
    back, _ = cloud.sample(500)
    assert np.array_equal(np.sort(back, axis=0), np.sort(p, axis=0))


def test_points_that_are_not_numbers_are_left_out_with_a_warning() -> None:
    p = points(100)
    p[3, 1], p[7] = np.nan, np.inf
    radius = np.ones(100)
    radius[11] = 0.0
    with pytest.warns(rs.RaysetWarning, match="skipped 3 points: 2 have no usable position, 1 have no positive radius"):
        cloud = rs.build(p, radius=radius)
    assert (len(cloud), cloud.skipped) == (97, 3)


def test_masked_points_are_left_out() -> None:
    p = np.ma.masked_array(points(100), mask=False)
    p.mask[5] = True
    with pytest.warns(rs.RaysetWarning, match="skipped 1 points"):
        assert len(rs.build(p, radius=1)) == 99


def test_colours_are_those_that_were_given() -> None:
    bytes_ = np.random.default_rng(2).integers(0, 256, (64, 3), dtype="u1")
    of_bytes = rs.build(points(64), radius=1, color=bytes_)
    of_floats = rs.build(points(64), radius=1, color=bytes_ / 255.0)
    of_words = rs.build(points(64), radius=1, color=bytes_.astype("u2") * 257)
    with_alpha = rs.build(points(64), radius=1, color=np.column_stack([bytes_, bytes_[:, 0]]))
    for cloud in (of_bytes, of_floats, of_words, with_alpha):
        _, columns = cloud.sample(64)
        found = np.column_stack([columns[name] for name in ("red", "green", "blue")])
        assert np.array_equal(np.sort(found, axis=0), np.sort(bytes_, axis=0))


def test_booleans_are_classes() -> None:
    cloud = rs.build(points(50), radius=1, attributes={"inside": np.arange(50) % 2 == 0})
    assert cloud.attributes["inside"].is_class


def test_a_structured_array_is_a_table() -> None:
    record = np.zeros(60, dtype=[("x", "f4"), ("y", "f4"), ("z", "f4"), ("T", "f8"), ("name", "U3")])
    record["x"], record["y"], record["z"] = points(60).T
    record["T"] = np.arange(60)
    cloud = rs.build(record, radius=1)
    assert list(cloud.attributes) == ["T"]


def test_stops_of_a_map_may_be_in_linear_light() -> None:
    cloud = rs.build(points(200), radius=0.5)
    styled = cloud.styled(opacity="clamp", color=[(0, (0.0, 0.0, 0.0)), (1, "#ff8000")], input="density", value_range=(0, 1))
    assert rs.render(styled, size=16).opacity.max() > 0.5


def test_progress_is_told_from_the_thread_that_builds() -> None:
    import threading

    told: list[tuple[str, int, int, bool]] = []
    here = threading.get_ident()
    rs.build(points(300_000), progress=lambda what, done, total: told.append((what, done, total, threading.get_ident() == here)))
    assert told and all(from_here for *_, from_here in told)
    assert {what for what, *_ in told} <= {"reading", "spacing", "building", "writing"}


@pytest.mark.parametrize("kind", ["u1", "i1", "u2", "i2", "i4", "f4", "f8", "?"])
def test_voxels_come_back_as_they_were(kind: str) -> None:
    values = (np.arange(5 * 6 * 7) % 2 if kind == "?" else np.arange(5 * 6 * 7) % 100).reshape(5, 6, 7).astype(kind)
    grid = rs.build_grid(values, spacing=(1, 2, 3), origin=(10, 20, 30))
    assert grid.shape == (5, 6, 7)
    assert np.array_equal(grid.to_numpy(), values.astype("f4"))
    assert grid.bounds == ((10.0, 20.0, 30.0), (16.0, 30.0, 42.0))
    fortran = rs.build_grid(np.asfortranarray(values), spacing=(1, 2, 3), origin=(10, 20, 30))
    assert fortran.identity == grid.identity


def test_a_grid_in_a_temporary_file_takes_it_along() -> None:
    grid = rs.build_grid(np.random.default_rng(1).random((8, 8, 8)))
    assert grid.path is not None
    path = Path(grid.path)
    image = rs.render(grid, size=16)
    assert path.exists()
    del grid, image
    gc.collect()
    assert not path.exists()


def test_a_damaged_file_of_a_folder_is_left_out_and_said(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    rows = "".join(f"{i} {i * i % 7} 0\n" for i in range(30))
    head = "ply\nformat ascii 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\nend_header\n"
    (tmp_path / "tiles").mkdir()
    (tmp_path / "tiles" / "a.ply").write_text(head.format(30) + rows)
    (tmp_path / "tiles" / "torn.ply").write_text(head.format(40) + rows)
    for cloud in (lambda: rs.build(str(tmp_path / "tiles")), lambda: rs.open(tmp_path / "tiles", cache=tmp_path / "cache")):
        caplog.clear()
        with caplog.at_level(logging.INFO, logger="rayset"):
            assert len(cloud()) == 30
        assert any("left out 1 of 2 files as damaged" in record.message and "torn.ply" in record.message for record in caplog.records)
    with pytest.raises(rs.RaysetError, match="torn.ply"):
        rs.build([str(tmp_path / "tiles" / "a.ply"), str(tmp_path / "tiles" / "torn.ply")])


def _ellipsoids(count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Positions, semi-axes, quaternions, and the matrices that take the unit ball to the ellipsoids."""
    random = np.random.default_rng(8)
    lengths = random.uniform(0.05, 0.5, (count, 3))
    q = random.normal(size=(count, 4))
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    x, y, z, w = q.T
    turns = np.stack([
        1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w),
        2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w),
        2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y),
    ], axis=1).reshape(count, 3, 3)
    return random.uniform(0, 3, (count, 3)), lengths, q, turns * lengths[:, None, :]


def test_shapes_are_those_of_matrices_or_of_semi_axes_and_quaternions() -> None:
    where, lengths, quaternions, matrices = _ellipsoids(60)
    roots = matrices @ (matrices / lengths[:, None, :]).transpose(0, 2, 1)  # symmetric: the same ellipsoids
    assert np.allclose(roots, roots.transpose(0, 2, 1))
    expected = _picture(rs.build(where, shape=(lengths, quaternions)))
    assert expected.std() > 5
    for shape in (matrices, roots, matrices.astype("f4"), (lengths * 1.0, -quaternions)):
        assert np.abs(_picture(rs.build(where, shape=shape)) - expected).max() <= 2
    assert np.abs(_picture(rs.build(where, radius=lengths.max(axis=1))) - expected).max() > 20
    twice = rs.build(where, shape=matrices, radius=2 * lengths.max(axis=1))
    assert np.abs(_picture(twice) - _picture(rs.build(where, shape=2 * matrices))).max() <= 2
    with pytest.warns(rs.RaysetWarning, match="skipped 1 points"):
        rs.build(where, shape=np.where(np.arange(60)[:, None, None] == 7, np.nan, matrices))


def _sheet(seed: int) -> np.ndarray:
    """Points at random on a square, with so much noise that neighbours do not say which way it faces."""
    random = np.random.default_rng(seed)
    return np.column_stack([random.uniform(0, 1, (COUNT, 2)), random.normal(0, 0.03, COUNT)])


def _picture(cloud: rs.Cloud) -> np.ndarray:
    return np.asarray(rs.render(cloud, size=(96, 64), samples=1)).astype(int)


def test_normals_turn_discs_and_are_not_kept() -> None:
    where = _sheet(3)
    up, across = (np.broadcast_to(axis, where.shape) for axis in ([0.0, 0.0, 1.0], [2.0, 0.0, 0.0]))
    cloud = rs.build(where, normals=up, attributes={"T": where[:, 0]})
    assert list(cloud.attributes) == ["T"]
    pictures = [_picture(rs.build(where, normals=normals)) for normals in (up, -3 * up, across)]
    assert np.array_equal(pictures[0], pictures[1])
    assert np.abs(pictures[0] - pictures[2]).mean() > 5
    table = {"x": where[:, 0], "y": where[:, 1], "z": where[:, 2], "nx": up[:, 0], "ny": up[:, 1], "nz": up[:, 2], "T": where[:, 0]}
    assert np.array_equal(_picture(rs.build(table)), pictures[0])
    assert list(rs.build(table).attributes) == ["T"]
    # What the argument says goes before the columns of a table.
    assert np.array_equal(_picture(rs.build(table, normals=across)), pictures[2])
    hidden = np.ma.masked_array(up, mask=True)
    assert np.array_equal(_picture(rs.build(where, normals=hidden)), _picture(rs.build(where)))


def test_shapes_of_a_fluid_are_measured() -> None:
    where = _sheet(4)
    fluid, automatic, balls = (_picture(rs.build(where, shape=shape)) for shape in ("fluid", "auto", "round"))
    assert np.abs(fluid - automatic).max() > 50
    assert np.abs(fluid - balls).max() > 50


WRONG_SHAPES = {
    "no such rule": ({"shape": "disc"}, "expected \"auto\", \"fluid\""),
    "one matrix": ({"shape": np.eye(3)}, r"got the shape \(3, 3\)"),
    "rows of different lengths": ({"shape": [[1], [1, 2]]}, "different lengths"),
    "radii of a fluid": ({"shape": "fluid", "radius": np.ones(60)}, "radii are measured"),
    "few normals": ({"normals": np.ones((5, 3))}, "expected 60 rows"),
    "twice": ({"normals": np.ones((60, 3)), "attributes": {"nx": np.ones(60)}}, "'nx' is given by normals="),
    "shapes twice": ({"shape": np.tile(np.eye(3), (60, 1, 1)), "attributes": {"rotation_x": np.ones(60)}}, "given by shape="),
}


@pytest.mark.parametrize("wrong", WRONG_SHAPES)
def test_wrong_shapes_are_refused_with_what_was_expected(wrong: str) -> None:
    arguments, said = WRONG_SHAPES[wrong]
    with pytest.raises(ValueError, match=said):
        rs.build(points(60), **arguments)


def test_flat_matrices_are_thin_discs_and_masked_ones_no_points() -> None:
    where, lengths, _, matrices = _ellipsoids(60)
    flat = matrices * np.array([1.0, 1.0, 0.0])
    assert len(rs.build(where, shape=flat)) == 60
    mask = np.zeros(matrices.shape, dtype=bool)
    mask[:20] = True
    with pytest.warns(rs.RaysetWarning, match="skipped 20 points"):
        rs.build(where, shape=np.ma.masked_array(matrices, mask=mask))
    columns = {f"semi_axis_{k + 1}": lengths[:, k] for k in range(3)} | {f"rotation_{axis}": np.ones(60) for axis in "xyzw"}
    table = {"x": where[:, 0], "y": where[:, 1], "z": where[:, 2]} | columns
    assert rs.build(table).radius == pytest.approx((lengths.max(axis=1).min(), lengths.max()), rel=1e-6)
    assert list(rs.build(table).attributes) == []
