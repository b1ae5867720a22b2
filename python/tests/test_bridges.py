"""Bridges to other packages: what comes over is what was there, number by number. Each test is skipped without its package."""

from __future__ import annotations

import math
import os
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import rayset as rs
from rayset import bridges

N = 200


def _places(count: int = N, seed: int = 1) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=(count, 3))


def _colors(count: int = N) -> np.ndarray:
    return np.random.default_rng(2).integers(0, 256, (count, 3)).astype("u1")


def _voxels(shape: tuple[int, int, int] = (4, 5, 6), kind: str = "f4") -> np.ndarray:
    return np.arange(math.prod(shape)).reshape(shape).astype(kind)


def _sorted(positions: Any, columns: Any) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """By coordinates: clouds have points in an order of their own."""
    positions = np.asarray(positions, dtype=float)
    order = np.lexsort(positions.T)
    return positions[order], {name: np.asarray(values)[order] for name, values in columns.items()}


def _same_places(found: np.ndarray, expected: np.ndarray) -> None:
    """Exact positions are offsets from a place in the midst of some points: their last bit may be another."""
    assert found.shape == expected.shape
    np.testing.assert_allclose(found, expected, rtol=1e-14, atol=1e-14)


def _holds(cloud: rs.Cloud, positions: Any, **columns: Any) -> None:
    """A cloud has these points and columns, and no columns besides those that were expected."""
    assert len(cloud) == len(positions)
    found = _sorted(*cloud.sample(1 << 20))
    expected = _sorted(positions, columns)
    _same_places(found[0], expected[0])
    for name, values in expected[1].items():
        assert np.array_equal(found[1][name], values), name
    assert set(found[1]) - {"radius", "weight"} == set(columns) - {"radius", "weight"}


def _bytes(color: np.ndarray) -> dict[str, np.ndarray]:
    return {name: color[:, k] for k, name in enumerate(("red", "green", "blue"))}


def _moved_by(grid: rs.Grid, *index: float) -> list[float]:
    """Where the voxel of an index (x, y, z) is."""
    return (grid.matrix @ [*index, 1.0]).tolist()


# pyvista and VTK


def test_a_mesh_of_pyvista_gives_its_points_and_all_point_data() -> None:
    pyvista = pytest.importorskip("pyvista")
    mesh = pyvista.PolyData(_places())
    mesh["RGB"] = _colors()
    mesh["T"] = np.arange(N, dtype="f4")
    mesh["kind"] = np.arange(N, dtype="u1") % 3
    mesh["big"] = np.arange(N, dtype="i8") - 7
    mesh["inside"] = np.arange(N) % 2 == 0
    mesh["v"] = _places(seed=3)
    mesh["radius"] = np.full(N, 0.25)
    mesh["tensor"] = np.zeros((N, 9))
    cloud = rs.bridges.from_pyvista(mesh, classes=["kind"], precision="exact")
    v = {f"v_{axis}": mesh["v"][:, k] for k, axis in enumerate("xyz")}
    _holds(
        cloud, mesh.points, T=mesh["T"], kind=mesh["kind"], big=mesh["big"], inside=mesh["inside"], radius=np.full(N, 0.25),
        **v, **_bytes(_colors()),
    )
    assert {name: one.type for name, one in cloud.attributes.items()} == {
        "T": "f32", "kind": "u8", "big": "i64", "inside": "u8", "v_x": "f64", "v_y": "f64", "v_z": "f64",
    }
    assert [name for name, one in cloud.attributes.items() if one.is_class] == ["kind", "inside"]


def test_what_the_caller_says_comes_before_what_a_mesh_has() -> None:
    pyvista = pytest.importorskip("pyvista")
    mesh = pyvista.PolyData(_places())
    mesh["RGB"], mesh["radius"] = _colors(), np.full(N, 0.25)
    cloud = bridges.from_pyvista(mesh, radius=0.5, color=255 - _colors(), attributes={"n": np.arange(N)}, precision="exact")
    _holds(cloud, mesh.points, n=np.arange(N), radius=np.full(N, 0.5), **_bytes(255 - _colors()))


def test_a_cloud_goes_to_pyvista_and_back() -> None:
    pyvista = pytest.importorskip("pyvista")
    given = {"T": np.arange(N, dtype="f4"), "kind": (np.arange(N) % 3).astype("u1")}
    cloud = rs.build(_places(), radius=0.25, color=_colors(), attributes=given, classes=["kind"], precision="exact")
    mesh = bridges.to_pyvista(cloud)
    assert isinstance(mesh, pyvista.PolyData)
    assert mesh["RGB"].dtype == np.uint8
    assert mesh["kind"].dtype == np.uint8
    assert mesh["T"].dtype == mesh["radius"].dtype == np.float32
    back = bridges.from_pyvista(mesh, classes=["kind"], precision="exact")
    _holds(back, _places(), **given, **_bytes(_colors()), radius=np.full(N, 0.25))
    assert back.attributes == cloud.attributes
    assert bridges.to_pyvista(rs.build(_places(5000), radius=0.1), most=500).n_points < 1000


def test_image_data_has_voxels_at_its_points() -> None:
    pyvista = pytest.importorskip("pyvista")
    image = pyvista.ImageData(dimensions=(6, 5, 4), spacing=(1, 2, 3), origin=(10, 20, 30))
    image.point_data["value"] = _voxels().ravel()
    grid = bridges.from_pyvista(image)
    assert np.array_equal(grid.to_numpy(), _voxels())
    assert np.array_equal(grid.matrix, [[1, 0, 0, 10], [0, 2, 0, 20], [0, 0, 3, 30]])


def test_image_data_has_voxels_in_the_middles_of_its_cells() -> None:
    pyvista = pytest.importorskip("pyvista")
    image = pyvista.ImageData(dimensions=(7, 6, 5), spacing=(1, 2, 3), origin=(10, 20, 30))
    image.point_data["other"] = np.zeros(7 * 6 * 5)
    image.cell_data["value"] = _voxels(kind="u1").ravel()
    grid = bridges.from_pyvista(image, scalars="value")
    assert np.array_equal(grid.to_numpy(), _voxels())
    assert np.array_equal(grid.matrix, [[1, 0, 0, 10.5], [0, 2, 0, 21], [0, 0, 3, 31.5]])
    del image.point_data["other"]
    image.set_active_scalars(None)
    assert np.array_equal(bridges.from_pyvista(image).to_numpy(), _voxels())


def test_image_data_that_is_turned_or_begins_elsewhere_is_where_its_points_are() -> None:
    pyvista = pytest.importorskip("pyvista")
    turn = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
    image = pyvista.ImageData(dimensions=(6, 5, 4), spacing=(1, 2, 3), origin=(10, 20, 30), direction_matrix=turn)
    image.offset = (2, 3, 4)
    image.point_data["value"] = _voxels().ravel()
    grid = bridges.from_pyvista(image)
    assert _moved_by(grid, 0, 0, 0) == image.points[0].tolist()
    assert _moved_by(grid, 1, 0, 0) == image.points[1].tolist()
    assert _moved_by(grid, 0, 1, 0) == image.points[6].tolist()
    assert _moved_by(grid, 5, 4, 3) == image.points[-1].tolist()
    image.cell_data["cells"] = np.arange(5 * 4 * 3, dtype="f4")
    centers = image.cell_centers().points
    cells = bridges.from_pyvista(image, scalars="cells")
    assert _moved_by(cells, 0, 0, 0) == centers[0].tolist()
    assert _moved_by(cells, 4, 3, 2) == centers[-1].tolist()


@pytest.mark.parametrize(
    "matrix", [[[1, 0, 0, 10], [0, 2, 0, 20], [0, 0, 3, 30]], [[0, -2, 0, 10], [1, 0, 0, 20], [0, 0, 3, 30]], np.diag([-1, 2, 3, 1])]
)
def test_a_grid_goes_to_pyvista_and_back(matrix: Any) -> None:
    pyvista = pytest.importorskip("pyvista")
    grid = rs.build_grid(_voxels(), matrix=matrix)
    image = bridges.to_pyvista(grid)
    assert isinstance(image, pyvista.ImageData)
    assert image.points[1].tolist() == _moved_by(grid, 1, 0, 0)
    assert image.points[-1].tolist() == _moved_by(grid, 5, 4, 3)
    back = bridges.from_pyvista(image)
    assert np.array_equal(back.to_numpy(), _voxels())
    assert np.array_equal(back.matrix, grid.matrix)


def test_a_data_set_of_vtk_is_read_as_one_of_pyvista() -> None:
    vtk = pytest.importorskip("vtk")
    pytest.importorskip("pyvista")
    from vtk.util.numpy_support import numpy_to_vtk, vtk_to_numpy

    points, mesh, image = vtk.vtkPoints(), vtk.vtkPolyData(), vtk.vtkImageData()
    points.SetData(numpy_to_vtk(_places(), deep=True))
    mesh.SetPoints(points)
    column = numpy_to_vtk(np.arange(N, dtype="f8"), deep=True)
    column.SetName("T")
    mesh.GetPointData().AddArray(column)
    cloud = bridges.from_vtk(mesh, precision="exact")
    _holds(cloud, _places(), T=np.arange(N))
    again = bridges.to_vtk(cloud)
    assert again.IsA("vtkPolyData")
    assert np.array_equal(np.sort(vtk_to_numpy(again.GetPointData().GetArray("T"))), np.arange(N))
    image.SetDimensions(6, 5, 4)
    image.SetSpacing(1, 2, 3)
    image.AllocateScalars(vtk.VTK_SHORT, 1)
    vtk_to_numpy(image.GetPointData().GetScalars())[:] = _voxels(kind="i2").ravel() - 50
    grid = bridges.from_vtk(image)
    assert np.array_equal(grid.to_numpy(), _voxels() - 50)
    assert np.array_equal(grid.matrix[:, :3], np.diag([1, 2, 3]))
    assert bridges.to_vtk(grid).IsA("vtkImageData")


def test_blocks_are_one_cloud() -> None:
    pyvista = pytest.importorskip("pyvista")
    blocks = pyvista.MultiBlock([pyvista.PolyData(_places(50, 1)), pyvista.PolyData(_places(70, 2))])
    _holds(bridges.from_pyvista(blocks, precision="exact"), blocks.combine().points)


def test_mistakes_with_image_data_say_what_to_do() -> None:
    pyvista = pytest.importorskip("pyvista")
    image = pyvista.ImageData(dimensions=(6, 5, 4))
    with pytest.raises(ValueError, match="scalars=None: the data have none"):
        bridges.from_pyvista(image)
    image["v"] = np.zeros((120, 2))
    with pytest.raises(ValueError, match=r"scalars='v': has 2 components, .* mesh\[\"v_x\"\] = mesh\[\"v\"\]\[:, 0\]"):
        bridges.from_pyvista(image)
    with pytest.raises(ValueError, match="scalars='w': the data have v"):
        bridges.from_pyvista(image, scalars="w")
    image["v_x"] = image["v"][:, 0]
    assert bridges.from_pyvista(image, scalars="v_x").shape == (4, 5, 6)


# Open3D


def test_a_point_cloud_of_open3d_gives_positions_colours_and_normals() -> None:
    o3d = pytest.importorskip("open3d")
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(_places()))
    _holds(bridges.from_open3d(cloud, precision="exact"), _places())
    cloud.colors = o3d.utility.Vector3dVector(_colors() / 255)
    cloud.normals = o3d.utility.Vector3dVector(_places(seed=3))
    normals = {f"normal_{axis}": _places(seed=3)[:, k] for k, axis in enumerate("xyz")}
    _holds(bridges.from_open3d(cloud, precision="exact"), _places(), **_bytes(_colors()), **normals)
    other = bridges.from_open3d(cloud, color=255 - _colors(), precision="exact")
    _holds(other, _places(), **_bytes(255 - _colors()), **normals)


@pytest.mark.parametrize("kind", ["u1", "f4"])
def test_a_tensor_cloud_of_open3d_gives_its_columns(kind: str) -> None:
    o3d = pytest.importorskip("open3d")
    cloud = o3d.t.geometry.PointCloud(o3d.core.Tensor(_places().astype("f4")))
    colors = _colors() if kind == "u1" else (_colors() / 255).astype("f4")
    cloud.point["colors"] = o3d.core.Tensor(colors)
    cloud.point["normals"] = o3d.core.Tensor(_places(seed=3).astype("f4"))
    cloud.point["T"] = o3d.core.Tensor(np.arange(N, dtype="f4").reshape(N, 1))
    made = bridges.from_open3d(cloud, precision="exact")
    normals = {f"normal_{axis}": _places(seed=3).astype("f4")[:, k] for k, axis in enumerate("xyz")}
    _holds(made, _places().astype("f4"), T=np.arange(N), **_bytes(_colors()), **normals)
    assert made.attributes["T"].type == "f32"


def test_a_cloud_goes_to_open3d_and_back() -> None:
    o3d = pytest.importorskip("open3d")
    made = bridges.to_open3d(rs.build(_places(), radius=0.1, color=_colors(), precision="exact"))
    assert isinstance(made, o3d.geometry.PointCloud)
    _holds(bridges.from_open3d(made, precision="exact"), _places(), **_bytes(_colors()))
    assert not bridges.to_open3d(rs.build(_places(), radius=0.1)).has_colors()


# LAS


def _las(path: Path, color: np.ndarray) -> Any:
    laspy = pytest.importorskip("laspy")
    header = laspy.LasHeader(point_format=2, version="1.2")
    header.scales, header.offsets = [0.01] * 3, [500000.0, 4000000.0, 0.0]
    las = laspy.LasData(header)
    las.x, las.y, las.z = (header.offsets + np.round(100 * _places(), 2)).T
    las.red, las.green, las.blue = color.T
    las.classification = np.arange(N) % 7
    las.intensity = np.arange(N) * 300
    las.write(str(path))
    return laspy.read(str(path))


def _las_is(cloud: rs.Cloud, las: Any) -> None:
    places = np.column_stack([las.x, las.y, las.z])
    _holds(cloud, places, classification=np.arange(N) % 7, intensity=np.arange(N) * 300, **_bytes(_colors()))
    assert cloud.attributes["classification"].is_class
    assert not cloud.attributes["intensity"].is_class
    assert (cloud.attributes["classification"].type, cloud.attributes["intensity"].type) == ("u8", "u16")


@pytest.mark.parametrize("name", ["a.las", "a.laz"])
@pytest.mark.parametrize("bits", [8, 16])
def test_points_of_laspy_have_positions_colours_and_classes_whole_or_in_chunks(tmp_path: Path, name: str, bits: int) -> None:
    las = _las(tmp_path / name, _colors().astype("u2") * (257 if bits == 16 else 1))
    _las_is(bridges.from_laspy(las, precision="exact"), las)
    chunks = bridges.laspy_chunks(tmp_path / name, chunk=64, color_bits=bits)
    _las_is(rs.build(chunks, classes=["classification"], precision="exact"), las)


def test_only_the_attributes_of_las_that_are_asked_for_are_taken(tmp_path: Path) -> None:
    las = _las(tmp_path / "a.las", _colors())
    cloud = bridges.from_laspy(las, ["intensity"], color=255 - _colors(), classes=["intensity"])
    assert list(cloud.attributes) == ["intensity"]
    assert cloud.attributes["intensity"].is_class
    with pytest.raises(ValueError, match="attributes: there is no 'height'; there are .*intensity"):
        bridges.from_laspy(las, ["height"])


# Tables


def _columns() -> dict[str, np.ndarray]:
    x, y, z = _places().T
    return {"x": x, "y": y, "z": z, "radius": np.full(N, 0.25), "n": np.arange(N, dtype="i4"), "ok": np.arange(N) % 2 == 0}


def _table_is(cloud: rs.Cloud) -> None:
    _holds(cloud, _places(), n=np.arange(N), ok=np.arange(N) % 2 == 0, radius=np.full(N, 0.25))
    assert cloud.attributes["n"].type == "i32"
    assert cloud.attributes["n"].is_class
    assert cloud.attributes["ok"].is_class


def _words() -> list[str]:
    return ["a", "b"] * (N // 2)


def test_a_frame_of_pandas_is_a_table() -> None:
    pandas = pytest.importorskip("pandas")
    frame = pandas.DataFrame({**_columns(), "name": _words(), "day": pandas.Timestamp("2020-01-01")})
    _table_is(rs.build(frame, classes=["n"], precision="exact"))
    frame["radius"] = pandas.array(frame["radius"], dtype="Float64")
    frame["n"] = pandas.array(frame["n"], dtype="Int32")
    _table_is(rs.build(frame, classes=["n"], precision="exact"))
    # What is missing is not a number.
    frame["n"] = pandas.array([None, *range(1, N)], dtype="Int64")
    positions, columns = _sorted(*rs.build(frame, precision="exact").sample(N))
    expected = _sorted(_places(), {"n": np.array([np.nan, *range(1, N)])})[1]["n"]
    assert np.array_equal(columns["n"], expected, equal_nan=True)


def test_a_file_that_pandas_reads_in_pieces_is_a_cloud(tmp_path: Path) -> None:
    pandas = pytest.importorskip("pandas")
    pandas.DataFrame({**_columns(), "name": _words()}).to_csv(tmp_path / "a.csv", index=False)
    pieces = pandas.read_csv(tmp_path / "a.csv", chunksize=64, dtype={"n": "i4"})
    _table_is(rs.build(pieces, classes=["n"], precision="exact"))


@pytest.mark.parametrize("form", ["eager", "lazy", "chunks"])
def test_a_frame_of_polars_is_a_table(form: str) -> None:
    polars = pytest.importorskip("polars")
    frame = polars.DataFrame({**_columns(), "name": _words()})
    given = {"eager": frame, "lazy": frame.lazy(), "chunks": frame.iter_slices(64)}[form]
    _table_is(rs.build(given, classes=["n"], precision="exact"))


def test_tables_and_batches_of_pyarrow_are_tables(tmp_path: Path) -> None:
    pyarrow = pytest.importorskip("pyarrow")
    dataset = pytest.importorskip("pyarrow.dataset")
    from pyarrow import parquet

    table = pyarrow.table({**_columns(), "name": _words()})
    _table_is(rs.build(table, classes=["n"], precision="exact"))
    _table_is(rs.build(table.combine_chunks().to_batches()[0], classes=["n"], precision="exact"))
    for k in range(4):
        parquet.write_table(table.slice(50 * k, 50), tmp_path / f"{k}.parquet", row_group_size=20)
    data = dataset.dataset(tmp_path)
    _table_is(rs.build(data.to_batches(), classes=["n"], precision="exact"))
    _table_is(rs.build(data.scanner().to_reader(), classes=["n"], precision="exact"))


def test_batches_of_pyarrow_that_a_filter_empties_are_passed_over(tmp_path: Path) -> None:
    dataset = pytest.importorskip("pyarrow.dataset")
    import pyarrow

    table = pyarrow.table({**_columns(), "where": np.arange(N)})
    data = dataset.InMemoryDataset(table.to_batches(max_chunksize=50))
    filtered = data.to_batches(filter=(dataset.field("where") < 20) | (dataset.field("where") >= 150))
    cloud = rs.build(filtered, precision="exact")
    keep = (np.arange(N) < 20) | (np.arange(N) >= 150)
    _same_places(_sorted(*cloud.sample(N))[0], _sorted(_places()[keep], {})[0])


def test_slices_of_h5py_in_a_generator_are_a_cloud(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["Coordinates"], file["T"] = _places().astype("f4"), np.arange(N, dtype="f8")

    def slices(keep: Any) -> Any:
        with h5py.File(tmp_path / "a.h5") as file:
            for at in range(0, N, 64):
                part = slice(at, at + 64)
                chosen = keep(file["T"][part])
                yield {"positions": file["Coordinates"][part][chosen], "T": file["T"][part][chosen]}

    _holds(rs.build(slices(lambda t: t >= 0), precision="exact"), _places().astype("f4"), T=np.arange(N))
    # Pieces of which nothing is kept, the first among them.
    kept = rs.build(slices(lambda t: (t >= 70) & (t < 110)), precision="exact")
    _holds(kept, _places()[70:110].astype("f4"), T=np.arange(70, 110))
    with pytest.raises(ValueError, match="yields no points"):
        rs.build(slices(lambda t: t < 0))


def test_a_group_of_h5py_is_a_table(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "a.h5", "w") as file:
        for name, values in _columns().items():
            file[name] = values
        _table_is(rs.build(file, classes=["n"], precision="exact"))


def test_a_class_that_no_table_has_is_a_mistake() -> None:
    with pytest.raises(ValueError, match="classes: there is no attribute 'kind'; there are n"):
        rs.build({**_columns()}, classes=["kind"])
    chunk = {"positions": _places(), "attributes": {"kind": np.arange(N)}}
    assert rs.build(iter([chunk]), classes=["kind"]).attributes["kind"].is_class


# Units


def _quantities(package: str) -> Any:
    """Makes a quantity of numbers and a unit."""
    if package == "astropy":
        units = pytest.importorskip("astropy.units")
        return lambda values, unit: values * units.Unit(unit)
    unyt = pytest.importorskip("unyt")
    return lambda values, unit: unyt.unyt_array(values, unit)


@pytest.mark.parametrize("package", ["astropy", "unyt"])
def test_radii_are_converted_to_the_unit_of_positions_and_units_are_kept(package: str) -> None:
    q = _quantities(package)
    given = {"T": q(np.arange(N, dtype="f4"), "K"), "ratio": q(np.ones(N), "dimensionless" if package == "unyt" else "")}
    cloud = rs.build(q(_places(), "Mpc"), radius=q(np.full(N, 250.0), "kpc"), attributes=given, precision="exact")
    _holds(cloud, _places(), T=np.arange(N), ratio=np.ones(N))
    assert cloud.radius == (0.25, 0.25)
    assert (cloud.attributes["T"].unit, cloud.attributes["T"].type) == ("K", "f32")
    assert cloud.attributes["ratio"].unit == ""


@pytest.mark.parametrize("package", ["astropy", "unyt"])
def test_axes_of_a_table_are_in_the_unit_of_the_first(package: str) -> None:
    q = _quantities(package)
    x, y, z = _places().T
    table = {"x": q(x, "Mpc"), "y": q(y * 1024, "kpc"), "z": q(z, "Mpc"), "radius": q(np.full(N, 250.0), "kpc")}
    cloud = rs.build(table, precision="exact")
    assert cloud.radius == (0.25, 0.25)
    found, _ = cloud.sample(N)
    assert np.allclose(found[np.argsort(found[:, 0])], np.column_stack([x, y * 1.024, z])[np.argsort(x)], rtol=1e-12, atol=0)


@pytest.mark.parametrize("package", ["astropy", "unyt"])
def test_mistakes_with_units_say_which(package: str) -> None:
    q = _quantities(package)
    with pytest.raises(ValueError, match="radius is in s, which is not a length in kpc"):
        rs.build(q(_places(), "kpc"), radius=q(np.ones(N), "s"))
    with pytest.raises(ValueError, match="radius is in kpc, and the positions have no unit; give them theirs"):
        rs.build(_places(), radius=q(np.ones(N), "kpc"))
    chunks = [{"positions": q(_places(), unit)} for unit in ("Mpc", "kpc")]
    with pytest.raises(ValueError, match="chunk 2: 'positions' is in kpc, in the first chunk in Mpc; convert it"):
        rs.build(iter(chunks))
    chunks = [{"positions": _places(), "T": values} for values in (q(np.ones(N), "K"), np.ones(N))]
    with pytest.raises(ValueError, match="chunk 2: 'T' is in no unit, in the first chunk in K; convert it"):
        rs.build(iter(chunks))


@pytest.mark.parametrize("kind", ["Table", "QTable"])
def test_a_table_of_astropy_has_units_and_masked_values(kind: str) -> None:
    tables = pytest.importorskip("astropy.table")
    from astropy import units as u

    x, y, z = _places().T
    mask = np.arange(N) % 10 == 0
    table = getattr(tables, kind)({"x": x * u.Mpc, "y": y * u.Mpc, "z": z * u.Mpc, "name": _words()})
    table["radius"] = np.full(N, 250.0) * u.kpc
    table["T"] = tables.MaskedColumn(np.arange(N, dtype="f8"), mask=mask, unit="K")
    table["n"] = tables.MaskedColumn(np.arange(N, dtype="i4"), mask=mask)
    table["kind"] = tables.MaskedColumn(np.arange(N, dtype="i4"), mask=False)
    cloud = rs.build(table, classes=["kind"], precision="exact")
    assert cloud.radius == (0.25, 0.25)
    assert {name: (one.type, one.unit) for name, one in cloud.attributes.items()} == {
        "T": ("f64", "K"), "n": ("f64", ""), "kind": ("i32", ""),
    }
    found = _sorted(*cloud.sample(N))[1]
    expected = _sorted(_places(), {"n": np.where(mask, np.nan, np.arange(N))})[1]["n"]
    assert np.array_equal(found["n"], expected, equal_nan=True)
    assert np.array_equal(found["T"], expected, equal_nan=True)


# FITS


def _cube(path: Path, data: np.ndarray, **header: Any) -> Path:
    fits = pytest.importorskip("astropy.io.fits")
    hdu = fits.PrimaryHDU(data)
    hdu.header.update(header)
    hdu.writeto(path)
    return path


def test_a_cube_in_fits_is_a_grid_where_its_header_says(tmp_path: Path) -> None:
    plain = bridges.from_fits(_cube(tmp_path / "plain.fits", _voxels(kind="i2") - 50))
    assert np.array_equal(plain.to_numpy(), _voxels() - 50)
    assert np.array_equal(plain.matrix, np.eye(3, 4))
    names = {f"{name}{k}": value for name, row in {
        "CDELT": (0.5, 2, -3), "CRPIX": (1, 2, 3), "CRVAL": (10, 20, 30), "CUNIT": ("kpc",) * 3,
    }.items() for k, value in enumerate(row, start=1)}
    path = _cube(tmp_path / "placed.fits", _voxels(), **names)
    grid = bridges.from_fits(path)
    assert np.array_equal(grid.to_numpy(), _voxels())
    assert np.array_equal(grid.matrix, [[0.5, 0, 0, 10], [0, 2, 0, 18], [0, 0, -3, 36]])
    from astropy.wcs import WCS

    assert np.allclose(WCS(str(path)).wcs_pix2world([[5, 4, 3]], 0)[0], 1 * np.array(_moved_by(grid, 5, 4, 3)))
    assert np.array_equal(bridges.from_fits(path, spacing=2).matrix, np.column_stack([2 * np.eye(3), np.zeros(3)]))


def test_a_cube_of_degrees_and_velocities_has_voxels_that_are_cubes(tmp_path: Path) -> None:
    pytest.importorskip("astropy")
    units = {"CDELT1": -0.001, "CDELT2": 0.001, "CDELT3": 0.5, "CUNIT1": "deg", "CUNIT2": "deg", "CUNIT3": "km/s", "CRVAL1": 83.0}
    grid = bridges.from_fits(_cube(tmp_path / "a.fits", _voxels(), **units))
    assert np.array_equal(grid.matrix, np.eye(3, 4))


def test_an_axis_of_one_pixel_is_left_out_with_its_step(tmp_path: Path) -> None:
    pytest.importorskip("astropy")
    steps = {"CDELT1": 1.0, "CDELT2": 2.0, "CDELT3": 7.0, "CDELT4": 3.0}
    grid = bridges.from_fits(_cube(tmp_path / "a.fits", _voxels()[:, None], **steps))
    assert np.array_equal(grid.to_numpy(), _voxels())
    assert np.array_equal(np.diag(grid.matrix), [1, 2, 3])


def test_a_compressed_cube_in_fits_is_a_grid(tmp_path: Path) -> None:
    fits = pytest.importorskip("astropy.io.fits")
    fits.HDUList([fits.PrimaryHDU(), fits.CompImageHDU(_voxels(kind="i2"))]).writeto(tmp_path / "a.fits")
    assert np.array_equal(bridges.from_fits(tmp_path / "a.fits").to_numpy(), _voxels())


def test_a_table_in_fits_is_a_cloud_with_units(tmp_path: Path) -> None:
    tables = pytest.importorskip("astropy.table")
    from astropy import units as u

    x, y, z = _places().T
    t = np.where(np.arange(N) == 5, np.nan, np.arange(N))
    table = tables.QTable({"X": x * u.Mpc, "Y": y * u.Mpc, "Z": z * u.Mpc, "radius": np.full(N, 250.0) * u.kpc, "T": t * u.K})
    table.write(tmp_path / "a.fits")
    cloud = bridges.from_fits(tmp_path / "a.fits", precision="exact")
    found = _sorted(*cloud.sample(N))
    expected = _sorted(_places(), {"T": t})
    _same_places(found[0], expected[0])
    assert np.array_equal(found[1]["T"], expected[1]["T"], equal_nan=True)
    assert cloud.radius == (0.25, 0.25)
    assert cloud.attributes["T"].unit == "K"


def test_fits_without_a_cube_says_what_it_has(tmp_path: Path) -> None:
    pytest.importorskip("astropy")
    path = _cube(tmp_path / "flat.fits", _voxels()[:1, None])
    with pytest.raises(ValueError, match="no table and no image of three axes; it has PRIMARY 1 x 1 x 5 x 6"):
        bridges.from_fits(path)
    with pytest.raises(ValueError, match="hdu=0: an image of 1 x 1 x 5 x 6, and a grid has three axes"):
        bridges.from_fits(path, hdu=0)


# Simulations


def _snapshot(path: Path, kernel: str | None = "Quartic spline (M5)", scalars: bool = False) -> Path:
    """A small snapshot as SWIFT writes them, in Mpc and 1e10 solar masses. SWIFT's numbers are arrays of one, which yt 4.4 makes numbers
    of in a way that NumPy 2.4 refuses: `scalars` are for yt."""
    h5py = pytest.importorskip("h5py")
    rng = np.random.default_rng(7)
    cgs = {"Unit length in cgs (U_L)": 3.08567758e24, "Unit mass in cgs (U_M)": 1.98841e43, "Unit time in cgs (U_t)": 3.08567758e19,
           "Unit temperature in cgs (U_T)": 1.0, "Unit current in cgs (U_I)": 1.0}
    with h5py.File(path, "w") as file:
        head = {
            "Code": np.bytes_("SWIFT"), "BoxSize": np.array([10.0] * 3), "Dimension": np.array([3]), "NumFilesPerSnapshot": np.array([1]),
            "NumPart_ThisFile": np.array([N, 0, 0, 0, 0, 0, 0]), "NumPart_Total": np.array([N, 0, 0, 0, 0, 0, 0]),
            "NumPart_Total_HighWord": np.zeros(7, dtype="i8"), "MassTable": np.zeros(7), "NumPartTypes": np.array([7]),
            "Redshift": np.array([0.0]), "Time": np.array([1.0]), "Scale-factor": np.array([1.0]), "Virtual": np.array([0]),
            "OutputType": np.bytes_("FullVolume"), "RunName": np.bytes_("test"), "SnapshotDate": np.bytes_("10:00:00 2026-01-01"),
        }
        groups: dict[str, dict[str, Any]] = {
            "Header": head, "Units": cgs, "InternalCodeUnits": cgs, "Policy": {"cosmological integration": np.array([0])},
            "Parameters": {}, "RuntimePars": {"PeriodicBoundariesOn": np.array([1])},
            "Cosmology": {"Cosmological run": np.array([0]), "Redshift": np.array([0.0]), "Scale-factor": np.array([1.0]),
                          "h": np.array([0.7]), "H0 [internal units]": np.array([70.0]), "Omega_lambda": np.array([0.7]),
                          "Omega_m": np.array([0.3])},
            "HydroScheme": {"Adiabatic index": np.array([5 / 3]), "Dimension": np.array([3])},
            "SubgridScheme": {}, "Code": {"Code": np.bytes_("SWIFT")},
        }
        if kernel is not None:
            groups["HydroScheme"]["Kernel function"] = np.bytes_(kernel)
        for name, attributes in groups.items():
            group = file.create_group(name)
            for key, value in attributes.items():
                array = value if isinstance(value, (np.ndarray, np.bytes_)) else np.array([value])
                group.attrs[key] = array[0] if scalars and array.shape == (1,) else array
        columns = {
            "Coordinates": (rng.random((N, 3)) * 10, {"U_L": 1.0}),
            "Velocities": (np.zeros((N, 3), dtype="f4"), {"U_L": 1.0, "U_t": -1.0}),
            "Masses": ((1 + rng.random(N)).astype("f4"), {"U_M": 1.0}),
            "SmoothingLengths": ((0.1 + rng.random(N)).astype("f4"), {"U_L": 1.0}),
            "Densities": (rng.random(N).astype("f4"), {"U_M": 1.0, "U_L": -3.0}),
            "Temperatures": (1e4 * rng.random(N).astype("f4"), {"U_T": 1.0}),
            "ParticleIDs": (np.arange(N), {}),
        }
        for name, (values, powers) in columns.items():
            data = file.create_dataset(f"PartType0/{name}", data=values)
            for unit in ("I", "L", "M", "T", "t"):
                data.attrs[f"U_{unit} exponent"] = np.array([powers.get(f"U_{unit}", 0.0)])
            factor = cgs["Unit length in cgs (U_L)"] ** powers.get("U_L", 0) * cgs["Unit mass in cgs (U_M)"] ** powers.get("U_M", 0)
            factor *= cgs["Unit time in cgs (U_t)"] ** powers.get("U_t", 0)
            for words in ("(not including cosmological corrections)", "(including cosmological corrections)"):
                kind = "CGS" if words.startswith("(not") else "physical CGS"
                data.attrs[f"Conversion factor to {kind} {words}"] = np.array([factor])
            data.attrs["a-scale exponent"] = np.array([0.0])
            data.attrs["h-scale exponent"] = np.array([0.0])
            data.attrs["Description"] = np.bytes_(name)
    return path


def _as_opened(cloud: rs.Cloud, path: Path | str, density: str) -> None:
    """A cloud has the points, radii and weights that rayset reads of the file. `density`, which both store, orders them: positions
    that are not stored exactly have an order of their own."""
    known = rs.open(path, cache=False)
    both = []
    for one, name in ((cloud, density), (known, next(name for name in known.attributes if name.startswith("Densit")))):
        positions, columns = one.sample(1 << 20)
        order = np.lexsort((columns["radius"], columns[name]))
        both.append((positions[order], columns[name][order], columns["radius"][order], columns["weight"][order]))
    found, expected = both
    assert len(np.unique(expected[1])) > 0.99 * len(expected[1])
    assert np.array_equal(found[1], expected[1])
    assert (np.abs(found[0] - expected[0]).max(axis=1) < 1e-3 * expected[2]).mean() > 0.99
    assert np.allclose(found[2], expected[2], rtol=1e-6, atol=0)
    assert np.allclose(found[3], expected[3], rtol=1e-5, atol=0)


@pytest.mark.parametrize(("kernel", "support"), [("Quartic spline (M5)", 2.018932), ("Wendland C2", 1.936492), (None, 1.825742)])
def test_gas_of_swiftsimio_is_what_the_program_reads(tmp_path: Path, kernel: str | None, support: float) -> None:
    swiftsimio = pytest.importorskip("swiftsimio")
    h5py = pytest.importorskip("h5py")
    path = _snapshot(tmp_path / "a.hdf5", kernel)
    gas = swiftsimio.load(str(path)).gas
    gas.smoothing_lengths.convert_to_units("kpc")
    cloud = bridges.from_swiftsimio(gas, precision="exact")
    with h5py.File(path) as file:
        part = {name: file[f"PartType0/{name}"][:] for name in file["PartType0"]}
    positions, columns = _sorted(*cloud.sample(N))
    expected = _sorted(part["Coordinates"], part)
    _same_places(positions, expected[0])
    assert np.allclose(columns["radius"], support * expected[1]["SmoothingLengths"], rtol=1e-6)
    radius = support * expected[1]["SmoothingLengths"].astype("f8")
    assert np.allclose(columns["weight"], expected[1]["Masses"] / (np.pi / 8 * radius**3), rtol=1e-5)
    assert np.array_equal(columns["temperatures"], expected[1]["Temperatures"])
    assert np.array_equal(columns["densities"], expected[1]["Densities"])
    assert cloud.attributes["temperatures"].unit == "K"
    assert "Mpc**3" in cloud.attributes["densities"].unit
    _as_opened(cloud, path, "densities")
    assert list(bridges.from_swiftsimio(gas, ["masses"], radius=0.5).attributes) == ["masses"]
    with pytest.raises(ValueError, match="attributes: there is no 'metallicity'; there are .*temperatures"):
        bridges.from_swiftsimio(gas, ["metallicity"])


def test_an_unknown_kernel_of_swift_is_a_mistake(tmp_path: Path) -> None:
    swiftsimio = pytest.importorskip("swiftsimio")
    gas = swiftsimio.load(str(_snapshot(tmp_path / "a.hdf5", "Septic spline"))).gas
    with pytest.raises(ValueError, match="the kernel 'Septic spline' of SWIFT is unknown, .* say kernel_support="):
        bridges.from_swiftsimio(gas)
    lengths = gas.smoothing_lengths.to_value("Mpc")
    assert bridges.from_swiftsimio(gas, kernel_support=2.0).radius == pytest.approx((2 * lengths.min(), 2 * lengths.max()))


def _yt() -> Any:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yt = pytest.importorskip("yt")
    yt.set_log_level(50)
    return yt


@pytest.mark.filterwarnings("ignore")
def test_a_snapshot_of_swift_by_yt_is_what_the_program_reads(tmp_path: Path) -> None:
    yt = _yt()
    path = _snapshot(tmp_path / "a.hdf5", scalars=True)
    cloud = bridges.from_yt(yt.load(str(path)), ["Densities"], precision="exact")
    assert len(cloud) == N
    _as_opened(cloud, path, "Densities")


@pytest.mark.filterwarnings("ignore")
def test_a_snapshot_of_gadget_by_yt_is_what_the_program_reads() -> None:
    yt = _yt()
    data = os.environ.get("RAYSET_TEST_DATA")
    path = Path(data or "/nowhere") / "particles" / "lcdm_gas_z0.hdf5"
    if not path.exists():
        pytest.skip("RAYSET_TEST_DATA names no folder with particles/lcdm_gas_z0.hdf5")
    snapshot = yt.load(str(path))
    cloud = bridges.from_yt(snapshot, ["density", "Density"], precision="exact")
    _as_opened(cloud, path, "Density")
    gas = snapshot.all_data()["PartType0", "density"]
    assert cloud.attributes["density"].unit == str(gas.units) == "code_mass/code_length**3"
    assert cloud.attributes["density"].range == pytest.approx((gas.value.min(), gas.value.max()), rel=1e-6)
    ball = snapshot.sphere("c", (10000, "code_length"))
    assert 0 < len(bridges.from_yt(ball)) == len(ball["PartType0", "particle_mass"]) < len(cloud)
    with pytest.raises(ValueError, match="particles='PartType4': the data set has PartType0, PartType1"):
        bridges.from_yt(snapshot, particles="PartType4")
    with pytest.raises(ValueError, match="attributes: there is no 'metals'; there are .*density"):
        bridges.from_yt(snapshot, ["metals"])


# Grids


def test_a_data_array_of_xarray_is_where_its_coordinates_are() -> None:
    xarray = pytest.importorskip("xarray")
    coords = {"level": [0.0, 10, 20, 30], "lat": np.linspace(50, 48, 5), "lon": np.arange(6, dtype="f4") * 0.1}
    grid = bridges.from_xarray(xarray.DataArray(_voxels(), coords, ["level", "lat", "lon"]))
    assert np.array_equal(grid.to_numpy(), _voxels())
    assert np.allclose(grid.matrix, [[0.1, 0, 0, 0], [0, -0.5, 0, 50], [0, 0, 10, 0]], rtol=1e-6)
    bare = bridges.from_xarray(xarray.DataArray(_voxels()))
    assert np.array_equal(bare.matrix, np.eye(3, 4))


def test_dimensions_named_x_y_and_z_are_these_in_any_order() -> None:
    xarray = pytest.importorskip("xarray")
    coords = {"x": np.arange(6) * 1.0, "y": np.arange(5) * 2.0, "z": np.arange(4) * 3.0}
    array = xarray.DataArray(_voxels(), coords, ["z", "y", "x"])
    for order in (("z", "y", "x"), ("x", "y", "z"), ("y", "z", "x")):
        grid = bridges.from_xarray(array.transpose(*order))
        assert np.array_equal(grid.to_numpy(), _voxels())
        assert np.array_equal(grid.matrix[:, :3], np.diag([1, 2, 3]))


def test_a_grid_goes_to_xarray_and_back() -> None:
    pytest.importorskip("xarray")
    grid = rs.build_grid(_voxels(), spacing=(0.5, 2, 3), origin=(10, -20, 30))
    array = bridges.to_xarray(grid)
    assert array.dims == ("z", "y", "x")
    assert float(array.sel(x=11.0, y=-18.0, z=33.0)) == _voxels()[1, 1, 2]
    back = bridges.from_xarray(array)
    assert np.array_equal(back.to_numpy(), _voxels())
    assert np.array_equal(back.matrix, grid.matrix)
    with pytest.raises(ValueError, match="the axes of this grid are not those of space; to_numpy and matrix have it"):
        bridges.to_xarray(rs.build_grid(_voxels(), matrix=[[1, 1, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]]))


def test_mistakes_with_xarray_say_what_to_do() -> None:
    xarray = pytest.importorskip("xarray")

    def array(**coords: Any) -> Any:
        return xarray.DataArray(_voxels(), coords, ["z", "y", "x"])

    with pytest.raises(ValueError, match="the coordinates along 'x' are not evenly spaced; array.interp brings them"):
        bridges.from_xarray(array(x=[0, 1, 2, 3, 4, 6]))
    with pytest.raises(ValueError, match="the coordinates along 'x' are not evenly spaced"):
        bridges.from_xarray(array(x=np.array([0, 1, 2, 3, 4, 6]) * 1e-9))
    with pytest.raises(ValueError, match="the coordinates along 'z' are of datetime64.* array.drop_vars"):
        bridges.from_xarray(array(z=np.arange("2020-01-01", "2020-01-05", dtype="datetime64[D]").astype("datetime64[ns]")))
    with pytest.raises(ValueError, match="expected three dimensions, and got .*array.isel"):
        bridges.from_xarray(array()[0])
    with pytest.raises(ValueError, match="there is one voxel along 'z', and a grid has two or more"):
        bridges.from_xarray(array()[:1])


def test_coordinates_in_single_precision_far_from_the_origin_are_even() -> None:
    xarray = pytest.importorskip("xarray")
    coords = {"x": (500_000 + 0.1 * np.arange(6)).astype("f4")}
    grid = bridges.from_xarray(xarray.DataArray(_voxels(), coords, ["z", "y", "x"]))
    assert grid.matrix[0, 0] == pytest.approx(0.1, rel=0.1)


class _Recorder:
    """An array that is read by slices, and says by which."""

    def __init__(self, array: Any) -> None:
        self.array, self.shape, self.dtype = array, array.shape, array.dtype
        self.slices: list[slice] = []

    def __getitem__(self, key: slice) -> Any:
        self.slices.append(key)
        return self.array[key]

    def __array__(self, *_: Any, **__: Any) -> Any:
        raise AssertionError("the whole array was read at once")


@pytest.mark.parametrize("package", ["zarr", "h5py", "xarray"])
def test_arrays_on_disk_become_grids_a_slab_at_a_time(tmp_path: Path, package: str) -> None:
    module = pytest.importorskip(package)
    voxels = _voxels((40, 256, 512))
    if package == "zarr":
        array = module.create_array(str(tmp_path / "a.zarr"), shape=voxels.shape, chunks=(8, 64, 64), dtype="f4")
        array[:] = voxels
    elif package == "h5py":
        array = module.File(tmp_path / "a.h5", "w").create_dataset("a", data=voxels, chunks=(8, 64, 64))
    else:
        array = module.DataArray(voxels)
    recorder = _Recorder(array)
    grid = rs.build_grid(recorder, spacing=(1, 2, 3))
    assert np.array_equal(grid.to_numpy(), voxels)
    assert np.array_equal(grid.matrix[:, :3], np.diag([1, 2, 3]))
    assert [one.start for one in recorder.slices] == [0, *(one.stop for one in recorder.slices[:-1])]
    assert len(recorder.slices) > 3
    assert max(one.stop - one.start for one in recorder.slices) * 256 * 512 * 4 <= 8 << 20
    assert np.array_equal(rs.build_grid(array).to_numpy(), voxels)


# Pictures


def _gas(**attributes: Any) -> rs.Cloud:
    return rs.build(_places(2000), radius=0.3, attributes=attributes or {"T": np.arange(2000, dtype="f4")})


@pytest.fixture
def pyplot(monkeypatch: pytest.MonkeyPatch) -> Any:
    matplotlib = pytest.importorskip("matplotlib")
    matplotlib.use("Agg")
    from matplotlib import pyplot

    yield pyplot
    pyplot.close("all")


def _bar(pyplot: Any) -> Any:
    """The axes of the colour bar."""
    axes = pyplot.gcf().axes
    assert len(axes) == 2
    return axes[1]


def test_a_picture_is_shown_as_it_is(pyplot: Any) -> None:
    image = rs.render(_gas(), size=(64, 48), look="surface")
    pyplot.rcParams["image.origin"] = "lower"
    shown = rs.imshow(image)
    pyplot.rcParams["image.origin"] = "upper"
    assert shown.origin == "upper"
    assert np.array_equal(shown.get_array(), image.rgba)
    assert len(pyplot.gcf().axes) == 1
    assert not shown.axes.axison
    assert rs.imshow(image, pyplot.figure().add_subplot(), alpha=0.5).get_alpha() == 0.5


def test_the_colour_bar_has_range_name_and_unit_of_the_map(pyplot: Any) -> None:
    u = pytest.importorskip("astropy.units")
    cloud = _gas(T=np.linspace(100, 300, 2000) * u.K)
    rs.imshow(rs.render(cloud, size=32, look="gas", color_by="T", colormap="plasma", value_range=(150, 250)))
    assert _bar(pyplot).get_ylabel() == "T [K]"
    assert _bar(pyplot).get_ylim() == (150, 250)
    from matplotlib import colormaps

    colors = _bar(pyplot)._colorbar.cmap([0.0, 0.25, 0.5, 1.0])
    assert np.allclose(colors, colormaps["plasma"]([0.0, 0.25, 0.5, 1.0]), atol=0.012)
    # Without a range of its own, a map goes over all values.
    pyplot.figure()
    rs.imshow(rs.render(cloud.styled(color="viridis", input="T", opacity=1.0), size=32), label="temperature")
    assert _bar(pyplot).get_ylabel() == "temperature"
    assert _bar(pyplot).get_ylim() == pytest.approx((100, 300))


def test_a_map_over_the_logarithm_has_a_logarithmic_colour_bar(pyplot: Any) -> None:
    image = rs.render(_gas(), size=32, look="gas", color_by="T", log=True, value_range=(1, 1000))
    rs.imshow(image)
    bar = _bar(pyplot)
    assert bar.get_yscale() == "log"
    assert bar.get_ylim() == pytest.approx((1, 1000))
    from matplotlib import colormaps

    assert np.allclose(bar._colorbar.cmap([0.0, 1 / 3, 1.0]), colormaps["viridis"]([0.0, 1 / 3, 1.0]), atol=0.012)
    pyplot.figure()
    rs.imshow(rs.render(_gas(), size=32, look="gas"))
    assert (_bar(pyplot).get_ylabel(), _bar(pyplot).get_yscale()) == ("density", "log")


def test_stops_in_linear_light_are_shown_as_screens_show_them(pyplot: Any) -> None:
    stops = [[0.25, [0.0, 0.0, 0.0]], [0.5, "#ff0000"], [0.75, [0.2158605, 1.0, 0.0]]]
    function = {"color": stops, "input": "z", "valueRange": [-2, 2], "opacity": {"extinction": 1}}
    rs.imshow(rs.render(_gas().styled(function), size=32))
    colors = _bar(pyplot)._colorbar.cmap([0.0, 0.5, 1.0])
    assert np.allclose(colors[:, :3], [[0, 0, 0], [1, 0, 0], [0.502, 1, 0]], atol=0.01)
    assert (_bar(pyplot).get_ylabel(), _bar(pyplot).get_ylim()) == ("z", (-2, 2))


def test_grids_and_transfers_have_colour_bars(pyplot: Any) -> None:
    grid = rs.build_grid(_voxels(), spacing=0.2)
    rs.imshow(rs.render(grid.styled(color="viridis", opacity=[(0, 0), (120, 1)]), size=32))
    assert (_bar(pyplot).get_ylabel(), _bar(pyplot).get_ylim()) == ("value", (0, 119))
    pyplot.figure()
    both = (_gas().styled(color="#ffffff", opacity=1.0) | rs.Sphere((0, 0, 0), 0.5)).with_transfer("T", color="turbo")
    rs.imshow(rs.render(both, size=32))
    assert (_bar(pyplot).get_ylabel(), _bar(pyplot).get_ylim()) == ("T", (0, 1999))
    pyplot.figure()
    rs.imshow(rs.render(grid, size=32), colorbar=False)
    assert len(pyplot.gcf().axes) == 1


def test_an_orthographic_camera_gives_coordinates_of_the_scene(pyplot: Any) -> None:
    """The bright pixels of a single point are at its coordinates."""
    place = np.array([1.5, -0.75, 2.0])
    cloud = rs.build(np.vstack([[place], place + 1e-3]), radius=0.2)
    y, z = (0, 1, 0), (0, 0, 1)
    for direction, up, names in (((0, 0, -1), y, "xy"), ((0, 1, 0), z, "xz"), ((0, 0, 1), y, "xy"), ((1, 0, 0), z, "yz")):
        eye = np.array([1.0, -1.0, 1.5]) - 10 * np.array(direction)
        camera = rs.Camera(tuple(eye), direction=direction, up=up, height=3.0)
        image = rs.render(cloud, camera=camera, size=(200, 100), background="none", look="surface")
        pyplot.figure()
        shown = rs.imshow(image)
        left, right, bottom, top = shown.get_extent()
        assert abs(right - left) == pytest.approx(6.0)
        assert abs(top - bottom) == pytest.approx(3.0)
        rows, columns = np.nonzero(image.opacity > 0.5)
        found = (left + (columns.mean() + 0.5) / 200 * (right - left), top + (rows.mean() + 0.5) / 100 * (bottom - top))
        assert found == pytest.approx([place["xyz".index(name)] for name in names], abs=0.03), direction
        assert (shown.axes.get_xlabel(), shown.axes.get_ylabel()) == tuple(names)


def test_other_orthographic_cameras_have_lengths_about_the_middle(pyplot: Any) -> None:
    cloud = _gas()
    camera = rs.Camera.fit(cloud, view="iso", orthographic=True)
    assert camera.height is not None
    shown = rs.imshow(rs.render(cloud, camera=camera, size=(80, 40), look="surface"))
    half = camera.height / 2
    assert shown.get_extent() == pytest.approx([-2 * half, 2 * half, -half, half])
    part = rs.render(cloud, camera=camera, size=(80, 40), look="surface", crop=(0, 0, 20, 20))
    assert not rs.imshow(part).axes.axison
    ball = rs.Scene(rs.Sphere((0, 0, 0), 1.0)).to_json()
    framed = rs.Scene.from_json({**ball, "camera": {"type": "orthographic", "direction": [0, 0, -1]}})
    assert rs.imshow(rs.render(framed, size=32)).get_array().shape == (32, 32, 4)
