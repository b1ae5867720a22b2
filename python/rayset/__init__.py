"""Ray-traces point clouds larger than memory, as volumes, inside a memory budget that holds.

>>> import numpy as np
>>> import rayset as rs
>>> positions = np.random.default_rng(1).normal(size=(10_000, 3))
>>> cloud = rs.build(positions, attributes={"distance": np.linalg.norm(positions, axis=1)})
>>> len(cloud)
10000
>>> image = rs.render(cloud - rs.Box((0, 0, 0), (4, 4, 4)), look="gas", size=(64, 64))
>>> image.shape
(64, 64, 4)
"""

from . import bridges
from ._build import build, build_grid
from ._errors import (
    BuildError,
    Cancelled,
    ExecutorError,
    InputError,
    MemoryBudgetError,
    RaysetError,
    RaysetWarning,
    RenderError,
    SceneError,
)
from ._frames import render_frames
from ._image import Image
from ._native import __version__, colormaps
from ._objects import (
    Attribute,
    Box,
    Cloud,
    Cone,
    Cylinder,
    Ellipsoid,
    Grid,
    HalfSpace,
    Noise,
    Object,
    Sphere,
    Torus,
    blend,
    intersection,
    union,
)
from ._open import open
from ._parts import (
    AmbientLight,
    Camera,
    DirectionalLight,
    Headlight,
    Light,
    Material,
    PointLight,
    Preset,
    TransferFunction,
)
from ._render import render
from ._scene import Scene, Viewer
from ._session import Session
from .bridges import imshow

__all__ = [
    "AmbientLight",
    "Attribute",
    "Box",
    "BuildError",
    "Camera",
    "Cancelled",
    "Cloud",
    "Cone",
    "Cylinder",
    "DirectionalLight",
    "Ellipsoid",
    "ExecutorError",
    "Grid",
    "HalfSpace",
    "Headlight",
    "Image",
    "InputError",
    "Light",
    "Material",
    "MemoryBudgetError",
    "Noise",
    "Object",
    "PointLight",
    "Preset",
    "RaysetError",
    "RaysetWarning",
    "RenderError",
    "Scene",
    "SceneError",
    "Session",
    "Sphere",
    "Torus",
    "TransferFunction",
    "Viewer",
    "__version__",
    "blend",
    "bridges",
    "build",
    "build_grid",
    "colormaps",
    "imshow",
    "intersection",
    "open",
    "render",
    "render_frames",
    "union",
]
