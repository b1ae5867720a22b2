"""Pictures."""

from __future__ import annotations

import os
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import _arguments, _native


class Image:
    """A picture: 8-bit red, green, blue and alpha as an array (``np.asarray(img)``), linear light and layers besides.

    It shows itself in a notebook.
    """

    def __init__(self, picture: _native.Picture, scene: Any = None) -> None:
        self._picture = picture
        #: The scene that was rendered.
        self.scene = scene

    @property
    def size(self) -> tuple[int, int]:
        """Width and height."""
        return self._picture.size

    @property
    def shape(self) -> tuple[int, int, int]:
        """Height, width and channels of the array."""
        width, height = self._picture.size
        return height, width, 4

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        array = self._picture.rgba8()
        return array if dtype is None else array.astype(dtype)

    @property
    def rgba(self) -> NDArray[np.uint8]:
        """As a PNG has it: red, green, blue and alpha, as screens show them."""
        return self._picture.rgba8()

    @property
    def linear(self) -> NDArray[np.float32]:
        """Red, green, blue and alpha in linear light before exposure, multiplied by alpha."""
        return self._picture.linear()

    def _layer(self, name: str) -> NDArray[Any]:
        layer = self._picture.layer(name)
        if layer is None:
            raise AttributeError(f"this picture has no {name}; render it with layers=True")
        return layer  # type: ignore[no-any-return]

    @property
    def depth(self) -> NDArray[np.float32]:
        """Distance from the eye, in units of the scene; infinite where there is nothing."""
        return self._layer("depth")

    @property
    def opacity(self) -> NDArray[np.float32]:
        """The part of the background that is hidden, 0 to 1."""
        return self._layer("opacity")

    @property
    def normal(self) -> NDArray[np.float32]:
        """Mean shading vectors, of length one or zero."""
        return self._layer("normal")

    @property
    def albedo(self) -> NDArray[np.float32]:
        """Mean colours without light, linear."""
        return self._layer("albedo")

    @property
    def instance(self) -> NDArray[np.uint32]:
        """The leaf of the scene that is seen most, counted from 1; 0 where there is none."""
        return self._layer("instance")

    @property
    def samples(self) -> NDArray[np.uint32]:
        """Numbers of samples that are not transparent."""
        return self._layer("samples")

    @property
    def lod_error(self) -> NDArray[np.float32]:
        """By how much opacities are off at most because of what is seen from afar, in 95 of 100 pixels; 0 where nothing is."""
        return self._layer("lod_error")

    def save(self, path: _arguments.PathLike) -> None:
        """Writes a PNG (``.png``), or an OpenEXR with all layers (``.exr``): the files of the program."""
        where = _arguments.file(path, "path")
        suffix = os.path.splitext(where)[1].lower()
        if suffix not in (".png", ".exr"):
            raise ValueError(f"path={_native.shown(where)!r}: the name of a picture ends in .png or .exr")
        if suffix == ".exr" and not self._picture.has_layers:
            raise ValueError("an OpenEXR holds the layers; render with layers=True")
        self._picture.save(where)

    def to_pil(self) -> Any:
        """As an image of Pillow."""
        from PIL import Image as Pillow

        return Pillow.fromarray(self.rgba, "RGBA")

    def _repr_png_(self) -> bytes:
        return self._picture.png()

    def __repr__(self) -> str:
        width, height = self.size
        return f"<rayset.Image {width} x {height}{', with layers' if self._picture.has_layers else ''}>"
