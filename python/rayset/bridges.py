"""To and from other packages. Each is imported when it is used, and none is needed otherwise.

Tables of pandas, polars, pyarrow and astropy go into :func:`rayset.build` as they are, arrays of zarr, h5py, dask and xarray into
:func:`rayset.build_grid`; quantities of astropy and unyt keep their units. What is here is for what needs more than that.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from . import _arguments
from ._build import build, build_grid
from ._image import Image
from ._objects import Cloud, Grid


def from_pyvista(mesh: Any, **options: Any) -> Cloud | Grid:
    """A cloud of the points of a mesh of pyvista or VTK (``PolyData``, ``UnstructuredGrid``, …) with its point data, or a grid of an
    ``ImageData``: of its active scalars, or those that ``scalars=`` names. `options` go to :func:`build` or :func:`build_grid`."""
    import pyvista

    mesh = pyvista.wrap(mesh)
    if isinstance(mesh, pyvista.ImageData):
        return _grid_of_image_data(mesh, options)
    attributes = {}
    color = options.pop("color", None)
    for name in mesh.point_data:
        values = np.asarray(mesh.point_data[name])
        if color is None and name.lower() in ("rgb", "rgba", "colors") and values.ndim == 2:
            color = values
        elif values.ndim == 1 and values.dtype.kind in "buif" and name not in ("radius", "weight"):
            attributes[name] = values
        elif values.ndim == 1 and name in ("radius", "weight"):
            options.setdefault(name, values)
    return build(np.asarray(mesh.points), color=color, attributes={**attributes, **options.pop("attributes", {})}, **options)


def _grid_of_image_data(mesh: Any, options: dict[str, Any]) -> Grid:
    name = options.pop("scalars", None) or mesh.active_scalars_name or next(iter(mesh.point_data), None)
    on_points = name in mesh.point_data
    if name is None or not (on_points or name in mesh.cell_data):
        raise ValueError(f"scalars={name!r}: the data have {', '.join([*mesh.point_data, *mesh.cell_data]) or 'none'}")
    values = np.asarray(mesh.point_data[name] if on_points else mesh.cell_data[name])
    size = np.array(mesh.dimensions) - (0 if on_points else 1)
    if values.ndim != 1:
        raise ValueError(f"scalars={name!r}: has {values.shape[1]} components; a grid has one value for each voxel")
    spacing, origin = np.array(mesh.spacing, dtype=float), np.array(mesh.origin, dtype=float)
    turn = np.array(getattr(mesh, "direction_matrix", np.eye(3)), dtype=float)
    first = origin + turn @ (spacing * (0.0 if on_points else 0.5))
    matrix = np.column_stack([turn * spacing, first])
    return build_grid(values.reshape(size[::-1]), matrix=matrix, **options)


def to_pyvista(data: Cloud | Grid, most: int = 1_000_000) -> Any:
    """A grid as an ``ImageData``, or a sample of about `most` points of a cloud as a ``PolyData``, with all columns."""
    import pyvista

    if isinstance(data, Grid):
        matrix = data.matrix
        spacing = np.linalg.norm(matrix[:, :3], axis=0)
        z, y, x = data.shape
        image = pyvista.ImageData(dimensions=(x, y, z), spacing=spacing, origin=matrix[:, 3])
        turn = matrix[:, :3] / spacing
        if not np.allclose(turn, np.eye(3)):
            image.direction_matrix = turn
        image.point_data["value"] = data.to_numpy().ravel()
        return image
    positions, columns = data.sample(most)
    mesh = pyvista.PolyData(positions)
    colors = [columns.pop(name) for name in ("red", "green", "blue") if name in columns]
    for name, values in columns.items():
        mesh.point_data[name] = values
    if len(colors) == 3:
        mesh.point_data["RGB"] = np.column_stack(colors).astype(np.uint8)
    return mesh


def from_vtk(data: Any, **options: Any) -> Cloud | Grid:
    """As :func:`from_pyvista`, of a data set of VTK."""
    return from_pyvista(data, **options)


def to_vtk(data: Cloud | Grid, most: int = 1_000_000) -> Any:
    """As :func:`to_pyvista`: what that gives is a data set of VTK."""
    return to_pyvista(data, most)


def from_open3d(cloud: Any, **options: Any) -> Cloud:
    """A cloud of a ``PointCloud`` of Open3D (old or tensor), with its colours."""
    if hasattr(cloud, "point"):
        found = {name: cloud.point[name].numpy() for name in cloud.point}
        positions = found.pop("positions")
        color = found.pop("colors", None)
        for axis, values in zip("xyz", found.pop("normals", np.empty((0, 3))).T):
            if len(values):
                found[f"normal_{axis}"] = values
        attributes = {name: values.reshape(len(positions)) for name, values in found.items() if values.size == len(positions)}
        return build(positions, color=color, attributes={**attributes, **options.pop("attributes", {})}, **options)
    color = np.asarray(cloud.colors) if cloud.has_colors() else None
    return build(np.asarray(cloud.points), color=options.pop("color", color), **options)


def to_open3d(cloud: Cloud, most: int = 1_000_000) -> Any:
    """A sample of about `most` points as a ``PointCloud`` of Open3D."""
    import open3d

    positions, columns = cloud.sample(most)
    made = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(positions))
    if cloud.has_color:
        colors = np.column_stack([columns[name] for name in ("red", "green", "blue")]) / 255.0
        made.colors = open3d.utility.Vector3dVector(colors)
    return made


def laspy_chunks(path: _arguments.PathLike, attributes: Sequence[str] = ("classification", "intensity"), chunk: int = 1_000_000) -> Iterator[Any]:
    """The points of a LAS or LAZ file by laspy, in chunks for :func:`build`: positions in double precision, colours if the file
    has them, and `attributes`. (:func:`open` reads such files by itself, and faster; this is for what is to be changed on the way.)"""
    import laspy

    with laspy.open(str(_arguments.path(path, "path"))) as reader:
        names = set(reader.header.point_format.dimension_names)
        for points in reader.chunk_iterator(chunk):
            found: dict[str, Any] = {"positions": np.column_stack([points.x, points.y, points.z])}
            if "red" in names:
                found["color"] = np.column_stack([points.red, points.green, points.blue]).astype(np.uint16)
            found |= {name: np.array(points[name]) for name in attributes if name in names}
            yield found


def from_laspy(las: Any, attributes: Sequence[str] = ("classification", "intensity"), **options: Any) -> Cloud:
    """A cloud of the points of a ``LasData``."""
    names = set(las.point_format.dimension_names)
    positions = np.column_stack([las.x, las.y, las.z])
    color = np.column_stack([las.red, las.green, las.blue]).astype(np.uint16) if "red" in names else None
    found = {name: np.array(las[name]) for name in attributes if name in names}
    classes = tuple(name for name in ("classification",) if name in found)
    return build(positions, color=color, attributes=found, classes=classes, **options)


def from_yt(source: Any, field: tuple[str, str] = ("gas", "density"), particles: str = "PartType0", **options: Any) -> Cloud:
    """A cloud of the particles of a data set or a data object of yt: positions and smoothing lengths of `particles` in ``code_length``,
    masses as weights, `field` as an attribute, with its unit."""
    ad = source.all_data() if hasattr(source, "all_data") else source
    positions = ad[particles, "particle_position"].to("code_length")
    known = {name for kind, name in ad.ds.derived_field_list if kind == particles} | {name for kind, name in ad.ds.field_list if kind == particles}
    radius = ad[particles, "smoothing_length"].to("code_length") if "smoothing_length" in known else None
    attributes = {field[1]: ad[particles, field[1]]} if field[1] in known else {}
    options.setdefault("radius", radius)
    return build(positions, attributes={**attributes, **options.pop("attributes", {})}, **options)


def from_swiftsimio(gas: Any, attributes: Sequence[str] = ("densities", "temperatures"), **options: Any) -> Cloud:
    """A cloud of the particles of one type of a snapshot of swiftsimio (``data.gas``): comoving positions, smoothing lengths with
    their compact support as radii, masses as weights, and `attributes` with their units."""
    # SWIFT's smoothing length is a standard deviation of the kernel; its support is this factor (Wendland C2) times it.
    support = options.pop("kernel_support", 1.936492)
    radius = gas.smoothing_lengths * support if hasattr(gas, "smoothing_lengths") else None
    found = {name: getattr(gas, name) for name in attributes if hasattr(gas, name)}
    options.setdefault("radius", radius)
    if hasattr(gas, "masses"):
        masses = np.asarray(gas.masses)
        options.setdefault("weight", masses / masses.mean())
    return build(gas.coordinates, attributes=found, **options)


def from_xarray(array: Any, **options: Any) -> Grid:
    """A grid of a ``DataArray`` of three dimensions, at its coordinates, which are evenly spaced; an order of dimensions ``z, y, x``."""
    if len(array.dims) != 3:
        raise ValueError(f"expected three dimensions, and got {array.dims}; select one of the others first")
    spacing, origin = [], []
    for name in reversed(array.dims):
        values = np.asarray(array[name], dtype=float) if name in array.coords else np.arange(array.sizes[name], dtype=float)
        steps = np.diff(values)
        if not len(steps) or not np.allclose(steps, steps.mean(), rtol=1e-3):
            raise ValueError(f"the coordinates along {name!r} are not evenly spaced; array.interp brings them onto even ones")
        spacing.append(float(steps.mean()))
        origin.append(float(values[0]))
    return build_grid(array, matrix=np.column_stack([np.diag(spacing), origin]), **options)


def to_xarray(grid: Grid) -> Any:
    """A grid as a ``DataArray``, if its axes are those of space."""
    import xarray

    matrix = grid.matrix
    if not np.allclose(matrix[:, :3], np.diag(np.diag(matrix[:, :3]))):
        raise ValueError("the axes of this grid are not those of space; to_numpy and matrix have it as it is")
    sizes = dict(zip("zyx", grid.shape))
    coords = {axis: matrix[k, 3] + matrix[k, k] * np.arange(sizes[axis]) for k, axis in enumerate("xyz")}
    return xarray.DataArray(grid.to_numpy(), dims=("z", "y", "x"), coords=coords, name="value")


def from_fits(path: _arguments.PathLike, hdu: int | str | None = None, **options: Any) -> Cloud | Grid:
    """A grid of an image cube in FITS, or a cloud of a table with columns x, y and z, by astropy."""
    from astropy.io import fits
    from astropy.table import Table

    with fits.open(str(_arguments.path(path, "path"))) as file:
        usable = [one for one in file if (isinstance(one, fits.BinTableHDU) or np.ndim(one.data) >= 3)]
        if hdu is None and not usable:
            raise ValueError(f"{path}: no table and no image of three axes; it has {', '.join(one.name or 'PRIMARY' for one in file)}")
        chosen = file[hdu] if hdu is not None else usable[0]
        if isinstance(chosen, fits.BinTableHDU):
            return build(Table.read(chosen), **options)
        cube = np.squeeze(chosen.data)
        header = chosen.header
        steps = [abs(float(header.get(f"CDELT{k}", 1.0))) or 1.0 for k in (1, 2, 3)]
        # Celestial degrees beside a velocity: voxels as long as they are wide show more than that.
        steps = steps if max(steps) < 1e3 * min(steps) else [1.0] * 3
        return build_grid(cube, spacing=options.pop("spacing", steps), **options)


def imshow(image: Image, ax: Any = None, *, label: str | None = None, colorbar: bool = True, **options: Any) -> Any:
    """Shows a picture in axes of matplotlib, with the extent of an orthographic camera in units of the scene, and the colour bar of
    what its map shows. Returns the artist."""
    import matplotlib.pyplot as plt

    axes = ax if ax is not None else plt.gca()
    extent = _extent(image)
    shown = axes.imshow(np.asarray(image), extent=extent, **options)
    if extent is None:
        axes.set_axis_off()
    bar = _color_map(image) if colorbar else None
    if bar is not None:
        from matplotlib.cm import ScalarMappable
        from matplotlib.colors import LinearSegmentedColormap, Normalize

        name, colors, (low, high) = bar
        mappable = ScalarMappable(Normalize(low, high), LinearSegmentedColormap.from_list("rayset", colors, 256))
        axes.figure.colorbar(mappable, ax=axes, label=label if label is not None else name)
    return shown


def _extent(image: Image) -> tuple[float, float, float, float] | None:
    """Left, right, bottom and top about what the camera looks at; ``None`` of a perspective, which has none."""
    camera = image.scene.to_json().get("camera", {}) if image.scene is not None else {}
    if camera.get("type") != "orthographic":
        return None
    width, height = image.size
    half = 0.5 * camera["height"]
    return (-half * width / height, half * width / height, -half, half)


def _color_map(image: Image) -> tuple[str, list[Any], tuple[float, float]] | None:
    """What the first map of a scene shows, its colours and its range."""
    from . import _native
    from ._scene import _nodes

    for node in _nodes(image.scene.to_json().get("root", {}) if image.scene is not None else {}):
        transfer = node.get("transferFunction", {})
        color, limits = transfer.get("color"), transfer.get("valueRange")
        if limits is None or color is None:
            continue
        if isinstance(color, list) and color and isinstance(color[0], list):
            return transfer.get("input", "value"), [(float(at), shown) for at, shown in _ends(color)], tuple(limits)
        if isinstance(color, str) and not color.startswith("#") and color != "points":
            colors = _native.colormap(color, 64)
            return transfer.get("input", "value"), [tuple(one) for one in colors], tuple(limits)
    return None


def _ends(stops: list[list[Any]]) -> list[list[Any]]:
    """Stops that begin at 0 and end at 1, as matplotlib wants them."""
    stops = sorted(stops, key=lambda stop: stop[0])
    return [[0.0, stops[0][1]], *[stop for stop in stops if 0 < stop[0] < 1], [1.0, stops[-1][1]]]
