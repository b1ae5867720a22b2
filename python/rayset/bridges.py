"""To and from other packages. Each is imported when it is used, and none is needed otherwise.

Tables of pandas, polars, pyarrow and astropy go into :func:`rayset.build` as they are, arrays of zarr, h5py, dask and xarray into
:func:`rayset.build_grid`; quantities of astropy and unyt keep their units. What is here is for what needs more than that.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import _arguments, _arrays
from ._build import build, build_grid
from ._image import Image
from ._objects import Cloud, Grid

#: Radius of compact support in smoothing lengths of SWIFT, by kernel (Dehnen and Aly 2012, table 1).
_SWIFT_SUPPORT = {"Cubic spline": 1.825742, "Quartic spline": 2.018932, "Quintic spline": 2.195775,
                  "Wendland C2": 1.936492, "Wendland C4": 2.207940, "Wendland C6": 2.449490}


def from_pyvista(mesh: Any, **options: Any) -> Cloud | Grid:
    """A cloud of the points of a mesh of pyvista or VTK (``PolyData``, ``UnstructuredGrid``, …) with its point data, or a grid of an
    ``ImageData``: of its active scalars, or those that ``scalars=`` names. `options` go to :func:`build` or :func:`build_grid`.
    Vectors become columns ``name_x``, ``name_y``, ``name_z``; ``RGB``, ``RGBA``, ``color`` and ``colors`` are colours; ``radius`` and
    ``weight`` are those. Voxels are the points of an ``ImageData``, or the middles of its cells, whichever has the scalars."""
    import pyvista

    mesh = pyvista.wrap(mesh)
    if isinstance(mesh, pyvista.ImageData):
        return _grid_of_image_data(mesh, options)
    mesh = mesh.combine() if isinstance(mesh, pyvista.MultiBlock) else mesh
    columns: dict[str, Any] = {}
    for name in mesh.point_data:
        values = np.asarray(mesh.point_data[name])
        if name.lower() in ("rgb", "rgba", "color", "colors") and values.ndim == 2 and values.shape[1] in (3, 4):
            columns["color"] = values
        elif values.dtype.kind in "buif":
            columns |= _components(name, values)
    return build({"positions": np.asarray(mesh.points), **columns}, **options)


def _components(name: str, values: NDArray[Any]) -> dict[str, Any]:
    """A column, or one for each axis of vectors; what has more components has no place in a cloud."""
    if values.ndim == 1 or values.shape[1] == 1:
        return {name: values.reshape(len(values))}
    return {f"{name}_{axis}": values[:, k] for k, axis in enumerate("xyz")} if values.shape[1:] == (3,) else {}


def _grid_of_image_data(mesh: Any, options: dict[str, Any]) -> Grid:
    import pyvista

    name = options.pop("scalars", None) or mesh.active_scalars_name or next(iter([*mesh.point_data, *mesh.cell_data]), None)
    on_points = name in mesh.point_data
    if name is None or not (on_points or name in mesh.cell_data):
        raise ValueError(f"scalars={name!r}: the data have {', '.join([*mesh.point_data, *mesh.cell_data]) or 'none'}")
    values = np.asarray(mesh.point_data[name] if on_points else mesh.cell_data[name])
    if values.ndim != 1:
        advice = f"mesh[\"{name}_x\"] = mesh[\"{name}\"][:, 0]; then scalars=\"{name}_x\""
        raise ValueError(f"scalars={name!r}: has {values.shape[1]} components, and a grid has one value for each voxel; choose one: {advice}")
    size = np.maximum(np.array(mesh.dimensions) - (0 if on_points else 1), 1)
    # Of indices that count from the extent of VTK, which need not begin at 0.
    matrix = np.array(pyvista.array_from_vtkmatrix(mesh.GetIndexToPhysicalMatrix()), dtype=float)[:3]
    matrix[:, 3] += matrix[:, :3] @ (np.array(mesh.extent[::2]) + (0.0 if on_points else 0.5))
    return build_grid(values.reshape(size[::-1]), matrix=matrix, **options)


def to_pyvista(data: Cloud | Grid, most: int = 1_000_000) -> Any:
    """A grid as an ``ImageData``, or a sample of about `most` points of a cloud as a ``PolyData``, with all columns in their types."""
    import pyvista

    if isinstance(data, Grid):
        matrix = data.matrix
        spacing = np.linalg.norm(matrix[:, :3], axis=0)
        z, y, x = data.shape
        image = pyvista.ImageData(dimensions=(x, y, z), spacing=spacing, origin=matrix[:, 3])
        turn = matrix[:, :3] / spacing
        if not np.array_equal(turn, np.eye(3)):
            image.direction_matrix = turn
        image.point_data["value"] = data.to_numpy().ravel()
        return image
    positions, columns = data.sample(most)
    mesh = pyvista.PolyData(positions)
    if data.has_color:
        mesh.point_data["RGB"] = _colors(columns).astype(np.uint8)
    for name, values in columns.items():
        if name not in ("red", "green", "blue"):
            mesh.point_data[name] = values.astype(_type_of(data, name))
    return mesh


def _colors(columns: Mapping[str, NDArray[Any]]) -> NDArray[Any]:
    """Rows of red, green and blue, 0 to 255."""
    return np.column_stack([columns[name] for name in ("red", "green", "blue")])


def _type_of(cloud: Cloud, name: str) -> np.dtype[Any]:
    """The type of a column, of which samples are all in double precision."""
    kind = cloud.attributes[name].type if name in cloud.attributes else "f32"
    return np.dtype(f"{kind[0]}{int(kind[1:]) // 8}")


def from_vtk(data: Any, **options: Any) -> Cloud | Grid:
    """As :func:`from_pyvista`, of a data set of VTK."""
    return from_pyvista(data, **options)


def to_vtk(data: Cloud | Grid, most: int = 1_000_000) -> Any:
    """As :func:`to_pyvista`: what that gives is a data set of VTK."""
    return to_pyvista(data, most)


def from_open3d(cloud: Any, **options: Any) -> Cloud:
    """A cloud of a ``PointCloud`` of Open3D (old or tensor), with its colours and normals; the tensor kind has other columns, too."""
    columns: dict[str, Any] = {}
    if hasattr(cloud, "point"):
        found = {name: cloud.point[name].cpu().numpy() for name in cloud.point}
        positions = found.pop("positions")
        if "colors" in found:
            columns["color"] = found.pop("colors")
    else:
        positions = np.asarray(cloud.points)
        if cloud.has_colors():
            columns["color"] = np.asarray(cloud.colors)
        found = {"normals": np.asarray(cloud.normals)} if cloud.has_normals() else {}
    for name, values in found.items():
        columns |= _components("normal" if name == "normals" else name, values)
    return build({"positions": positions, **columns}, **options)


def to_open3d(cloud: Cloud, most: int = 1_000_000) -> Any:
    """A sample of about `most` points and their colours as a ``PointCloud`` of Open3D, which has no other columns."""
    import open3d

    positions, columns = cloud.sample(most)
    made = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(positions))
    if cloud.has_color:
        made.colors = open3d.utility.Vector3dVector(_colors(columns) / 255.0)
    return made


def laspy_chunks(
    path: _arguments.PathLike, attributes: Sequence[str] | None = None, chunk: int = 1_000_000, color_bits: int = 16
) -> Iterator[dict[str, Any]]:
    """The points of a LAS or LAZ file by laspy, in chunks for :func:`build`: positions in double precision, colours if the file
    has them, and `attributes`, by default classification and intensity. Say ``classes=["classification"]`` to :func:`build`, and
    ``color_bits=8`` of files whose colours end at 255, against the specification: a chunk does not know those that follow.
    (:func:`open` reads such files by itself, and faster; this is for what is to be changed on the way.)"""
    import laspy

    with laspy.open(str(_arguments.path(path, "path"))) as reader:
        for points in reader.chunk_iterator(chunk):
            yield _las_columns(points, attributes, color_bits)


def from_laspy(las: Any, attributes: Sequence[str] | None = None, **options: Any) -> Cloud:
    """A cloud of the points of a ``LasData``, with its colours and `attributes`, by default classification (as classes) and intensity."""
    columns = _las_columns(las, attributes, None)
    options.setdefault("classes", [name for name in ("classification",) if name in columns])
    return build(columns, **options)


def _las_columns(points: Any, attributes: Sequence[str] | None, color_bits: int | None) -> dict[str, Any]:
    names = list(points.point_format.dimension_names)
    found: dict[str, Any] = {"positions": np.column_stack([points.x, points.y, points.z])}
    if "red" in names:
        color = np.column_stack([points.red, points.green, points.blue]).astype(np.uint16)
        # Many writers store bytes, where 16 bits are specified.
        bits = color_bits or (8 if color.max(initial=0) <= 255 else 16)
        found["color"] = color.astype(np.uint8) if bits == 8 else color
    return found | {name: np.array(points[name]) for name in _chosen(attributes, ("classification", "intensity"), names)}


def _chosen(wanted: Sequence[str] | None, usual: Sequence[str], known: Collection[str]) -> list[str]:
    """The columns that were asked for; without a word, the usual ones that are there."""
    if wanted is None:
        return [name for name in usual if name in known]
    for name in wanted:
        if name not in known:
            raise ValueError(f"attributes: there is no {name!r}; there are {', '.join(sorted(known))}")
    return list(wanted)


def from_yt(source: Any, attributes: Sequence[str] | None = None, particles: str = "PartType0", **options: Any) -> Cloud:
    """A cloud of the particles of a data set or a data object of yt, as :func:`open` makes it of a snapshot: positions and radii of
    support in ``code_length``, weights with which the field is the density of mass, and `attributes` (fields of `particles`; the
    density by default) with their units. All of it is in memory at once."""
    ad = source.all_data() if hasattr(source, "all_data") else source
    if particles not in ad.ds.particle_types_raw:
        raise ValueError(f"particles={particles!r}: the data set has {', '.join(ad.ds.particle_types_raw) or 'none'}")
    known = {name for kind, name in [*ad.ds.field_list, *ad.ds.derived_field_list] if kind == particles}
    positions = ad[particles, "particle_position"].to("code_length")
    radius = ad[particles, "smoothing_length"].to("code_length") if "smoothing_length" in known else None
    mass = ad[particles, "particle_mass"].to("code_mass") if "particle_mass" in known else None
    support = options.pop("kernel_support", None) or (_swift_support(ad.ds.parameters["hydro"]) if ad.ds.dataset_type == "swift" else 1.0)
    columns = {name: ad[particles, name] for name in _chosen(attributes, ("density",), known)}
    return build({"positions": positions, **columns, **_field(positions, radius, support, mass, options)}, **options)


def from_swiftsimio(gas: Any, attributes: Sequence[str] | None = None, **options: Any) -> Cloud:
    """A cloud of the particles of one type of a snapshot of swiftsimio (``data.gas``), as :func:`open` makes it: positions as they
    are (comoving), radii of support, weights with which the field is the density of mass, and `attributes` (densities and
    temperatures by default) with their units. ``kernel_support`` is the radius of support in smoothing lengths of kernels unknown here."""
    names = _chosen(attributes, ("densities", "temperatures"), set(gas.group_metadata.field_names))
    radius, mass = getattr(gas, "smoothing_lengths", None), getattr(gas, "masses", None)
    support = options.pop("kernel_support", None) or _swift_support(gas.metadata.hydro_scheme)
    columns = {name: getattr(gas, name) for name in names} | _field(gas.coordinates, radius, support, mass, options)
    return build({"positions": gas.coordinates, **columns}, **options)


def _swift_support(hydro: Mapping[str, Any]) -> float:
    """SWIFT's smoothing length is twice the standard deviation of the kernel, and not its radius of support."""
    name = hydro.get("Kernel function", "Cubic spline")
    name = name.decode() if isinstance(name, bytes) else str(name)
    for known, support in _SWIFT_SUPPORT.items():
        if name.startswith(known):
            return support
    raise ValueError(f"the kernel {name!r} of SWIFT is unknown, and so is the radius of its support; say kernel_support=")


def _field(positions: Any, smoothing: Any, support: float, mass: Any, options: Mapping[str, Any]) -> dict[str, Any]:
    """Radii, and weights m/(π/8·r³) as readers of snapshots have them: the field of cubic splines is then the density of mass."""
    if smoothing is None or options.get("radius") is not None:
        return {}
    radius = support * _arrays.plain(smoothing, "radius", _arrays.unit_of(positions)).astype(np.float64)
    weight = {} if mass is None else {"weight": _arrays.plain(mass, "weight") / (math.pi / 8 * radius**3)}
    return {"radius": radius, **weight}


def from_xarray(array: Any, **options: Any) -> Grid:
    """A grid of a ``DataArray`` of three dimensions, at its coordinates, which are evenly spaced. Dimensions named x, y and z are
    these in any order; others are z, y and x in theirs. Arrays of dask are computed a slab at a time."""
    if len(array.dims) != 3:
        raise ValueError(f"expected three dimensions, and got {array.dims}; select one of the others first, as in array.isel(time=0)")
    if set(array.dims) == {"x", "y", "z"}:
        array = array.transpose("z", "y", "x")
    spacing, origin = [], []
    for name in reversed(array.dims):
        found = np.asarray(array[name])
        if found.dtype.kind not in "uif":
            raise ValueError(f"the coordinates along {name!r} are of {found.dtype}, and no places; array.drop_vars({name!r}) counts instead")
        values = found.astype(float)
        if len(values) < 2:
            raise ValueError(f"there is one voxel along {name!r}, and a grid has two or more along each axis")
        step = (values[-1] - values[0]) / (len(values) - 1)
        # The coordinates of many files are in single precision.
        slack = 1e-3 * abs(step) + 4 * float(np.spacing(np.float32(np.abs(values).max()))) * (found.dtype.itemsize <= 4)
        if not step or not np.allclose(np.diff(values), step, rtol=0, atol=slack):
            raise ValueError(f"the coordinates along {name!r} are not evenly spaced; array.interp brings them onto even ones")
        spacing.append(float(step))
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
    """A grid of an image cube in FITS, or a cloud of a table with columns x, y and z, by astropy: the first in the file, or `hdu`.
    Axes of one unit place voxels where the header says (``CRVAL``, ``CRPIX``, ``CDELT``); degrees beside a velocity have no common
    length, and become voxels that are as deep as wide. ``spacing``, ``origin`` or ``matrix`` say otherwise."""
    from astropy.io import fits
    from astropy.table import Table

    def is_table(one: Any) -> bool:  # Compressed images are stored in tables.
        return isinstance(one, (fits.BinTableHDU, fits.TableHDU)) and not isinstance(one, fits.CompImageHDU)

    def axes(one: Any) -> list[int]:  # Numbers of those that have more than one pixel; of an array, the last is the first.
        return [k for k, size in enumerate(reversed(one.shape), start=1) if size > 1]

    with fits.open(str(_arguments.path(path, "path"))) as file:
        usable = [one for one in file if is_table(one) or len(axes(one)) == 3]
        if hdu is None and not usable:
            there = ", ".join(f"{one.name or 'an image'} {' x '.join(map(str, one.shape)) or 'without data'}" for one in file)
            raise ValueError(f"{path}: no table and no image of three axes; it has {there}")
        chosen = file[hdu] if hdu is not None else usable[0]
        if is_table(chosen):
            return build(Table.read(chosen), **options)
        if len(axes(chosen)) != 3:
            raise ValueError(f"{path}, hdu={hdu!r}: an image of {' x '.join(map(str, chosen.shape)) or 'no data'}, and a grid has three axes")
        if not options.keys() & {"spacing", "origin", "matrix"}:
            options["matrix"] = _fits_matrix(chosen.header, axes(chosen))
        return build_grid(np.squeeze(chosen.data), **options)


def _fits_matrix(header: Any, axes: Sequence[int]) -> NDArray[np.float64]:
    """Where voxels are, from the linear part of the coordinates in a header."""
    steps = [float(header.get(f"CDELT{k}", header.get(f"CD{k}_{k}", 1.0))) or 1.0 for k in axes]
    sizes = np.abs(steps)
    if len({str(header.get(f"CUNIT{k}", "")).strip() for k in axes}) > 1 or sizes.max() > 1e3 * sizes.min():
        return np.eye(3, 4)
    first = [float(header.get(f"CRVAL{k}", 0.0)) + (1 - float(header.get(f"CRPIX{k}", 1.0))) * step for k, step in zip(axes, steps)]
    return np.column_stack([np.diag(steps), first])


def imshow(image: Image, ax: Any = None, *, label: str | None = None, colorbar: bool = True, **options: Any) -> Any:
    """Shows a picture in axes of matplotlib, and the colour bar of what its map shows. Returns the artist.
    Of an orthographic camera the axes are in units of the scene: along x, y or z if the camera's are, and else about the middle
    of the picture."""
    import matplotlib.pyplot as plt

    axes, (extent, names) = ax if ax is not None else plt.gca(), _extent(image)
    shown = axes.imshow(np.asarray(image), **{"extent": extent, "origin": "upper", **options})
    if extent is None:
        axes.set_axis_off()
    axes.set(xlabel=axes.get_xlabel() or names[0], ylabel=axes.get_ylabel() or names[1])
    bar = _color_map(image) if colorbar else None
    if bar is not None:
        from matplotlib.cm import ScalarMappable
        from matplotlib.colors import LinearSegmentedColormap, LogNorm, Normalize

        name, stops, (low, high) = bar
        places = np.array([at for at, _ in stops])
        values, norm = low + places * (high - low), Normalize(low, high)
        # The engine's maps are linear: one over the logarithm has stops at even ratios.
        if low > 0 and len(stops) > 2 and np.ptp(np.diff(np.log(values))) < 1e-6 * math.log(high / low):
            places, norm = np.linspace(0, 1, len(stops)), LogNorm(low, high)
        colors = LinearSegmentedColormap.from_list("rayset", list(zip(places, [color for _, color in stops])), 1024)
        axes.figure.colorbar(ScalarMappable(norm, colors), ax=axes, label=label if label is not None else name)
    return shown


def _extent(image: Image) -> tuple[tuple[float, float, float, float] | None, tuple[str, str]]:
    """Left, right, bottom and top, and which axes of space these are along; ``None`` of a perspective, which has none, and of a part."""
    scene = image.scene.to_json() if image.scene is not None else {}
    camera = scene.get("camera", {})
    whole = tuple(scene.get("image", {}).get("size", image.size))
    if camera.get("type") != "orthographic" or not {"height", "position"} <= camera.keys() or whole != image.size:
        return None, ("", "")
    eye = np.array(camera["position"], dtype=float)
    forward = np.array(camera["direction"] if "direction" in camera else np.array(camera["lookAt"]) - eye, dtype=float)
    right = np.cross(forward, camera.get("up", (0.0, 1.0, 0.0)))
    ways = [way / np.linalg.norm(way) for way in (right, np.cross(right, forward))]
    high = 0.5 * camera["height"]
    wide = high * image.size[0] / image.size[1]
    across, along = (int(np.argmax(np.abs(way))) for way in ways)
    x, y = ways[0][across], ways[1][along]
    if min(abs(x), abs(y)) < 1 - 1e-12:
        return (-wide, wide, -high, high), ("", "")
    (x0, y0), x, y = (eye[across], eye[along]), math.copysign(wide, x), math.copysign(high, y)
    return (x0 - x, x0 + x, y0 - y, y0 + y), ("xyz"[across], "xyz"[along])


def _color_map(image: Image) -> tuple[str, list[tuple[float, Any]], tuple[float, float]] | None:
    """What the outermost map of a scene shows, with its unit; the stops of its colours; its range."""
    from ._scene import _nodes

    scene = image.scene
    for node in _nodes(scene.to_json()["root"] if scene is not None else {}):
        own = node.get("transferFunction", {})
        for transfer in [*reversed(node.get("transfers", [])), own]:
            if (stops := _stops(transfer.get("color"))) is not None:
                name = transfer.get("input", "opacity" if transfer is not own else "value" if node["type"] == "grid" else "density")
                (low, high), unit = _range_and_unit(scene, node.get("file"), name)
                limits = transfer.get("valueRange", (low, high if high > low else low + 1))
                return f"{name} [{unit}]" if unit else name, stops, limits
    return None


def _range_and_unit(scene: Any, file: str | None, name: str) -> tuple[tuple[float, float], str]:
    """Over which values a map goes if it does not say so, and their unit."""
    for held in [scene._data[file]] if file in scene._data else scene._data.values():
        if isinstance(held, Cloud) and name in held.attributes:
            return held.attributes[name].range, held.attributes[name].unit
        if isinstance(held, Grid) and name == "value":
            return held.range, ""
    return (0.0, 1.0), ""


def _stops(color: Any) -> list[tuple[float, Any]] | None:
    """A map as matplotlib wants it: stops that begin at 0 and end at 1; ``None`` of a colour, which is no map."""
    from . import _native

    if isinstance(color, str) and not color.startswith("#") and color != "points":
        colors = _native.colormap(color, 256)
        return [(k / (len(colors) - 1), one) for k, one in enumerate(colors)]
    if not isinstance(color, list) or not color or not isinstance(color[0], list):
        return None
    stops = [(float(at), shown if isinstance(shown, str) else _screen(shown)) for at, shown in color]
    return [*([(0.0, stops[0][1])] if stops[0][0] > 0 else []), *stops, *([(1.0, stops[-1][1])] if stops[-1][0] < 1 else [])]


def _screen(linear: Any) -> tuple[float, ...]:
    """Linear light as screens show it (sRGB)."""
    c = np.clip(np.array(linear, dtype=float), 0.0, 1.0)
    return tuple(np.where(c <= 0.0031308, 12.92 * c, 1.055 * c ** (1 / 2.4) - 0.055).tolist())
