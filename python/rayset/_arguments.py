"""Arguments in the forms in which people give them."""

from __future__ import annotations

import math
import numbers
import os
import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, TypeAlias, Union

from . import _native

Vector: TypeAlias = Sequence[float]
"""Three numbers."""
Color: TypeAlias = Union[str, Sequence[float]]
"""``"#c8b090"`` as screens show it, or three numbers of linear light."""
PathLike: TypeAlias = Union[str, "os.PathLike[str]"]


def memory_bytes(value: int | str | None) -> int | None:
    """A number of bytes: ``"8GiB"``, ``8 << 30``; ``None`` stays what it is."""
    if value is None:
        return None
    if isinstance(value, str):
        try:
            return _native.size_of(value)
        except ValueError:
            raise ValueError(f"memory={value!r} is not a size; write it as \"64MiB\", \"20MB\" or 1048576") from None
    if isinstance(value, bool) or not isinstance(value, numbers.Integral):
        raise TypeError(f"memory={value!r}: expected a number of bytes, or a text such as \"8GiB\"")
    found = int(value)
    if found <= 0:
        raise ValueError(f"memory={value!r}: expected more than 0 bytes")
    return found


def thread_count(value: int | None) -> int | None:
    """A number of threads; ``None`` for as many as there are processors."""
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, numbers.Integral):
        raise TypeError(f"threads={value!r}: expected a whole number")
    found = int(value)
    if not 1 <= found <= 1024:
        raise ValueError(f"threads={value!r}: expected 1 to 1024")
    return found


def number(value: Any, name: str, least: float = -1e18, most: float = 1e18) -> float:
    """A finite number within bounds."""
    if isinstance(value, (bool, str)):
        raise TypeError(f"{name}={value!r}: expected a number")
    try:
        found = float(value)
    except (TypeError, ValueError):
        raise TypeError(f"{name}={value!r}: expected a number") from None
    if not (math.isfinite(found) and least <= found <= most):
        raise ValueError(f"{name}={value!r}: expected a number from {least:g} to {most:g}")
    return found


def seconds(value: Any) -> float:
    """A time to wait."""
    return number(value, "timeout", 1e-3, 1e9)


def whole(value: Any, name: str, least: int, most: int) -> int:
    """A whole number within bounds."""
    if isinstance(value, bool) or not isinstance(value, numbers.Integral):
        raise TypeError(f"{name}={value!r}: expected a whole number")
    found = int(value)
    if not least <= found <= most:
        raise ValueError(f"{name}={value!r}: expected {least} to {most}")
    return found


def vector(value: Any, name: str) -> list[float]:
    """Three finite numbers."""
    try:
        found = [float(v) for v in value]
    except (TypeError, ValueError):
        found = []
    if len(found) != 3:
        raise TypeError(f"{name}={value!r}: expected three numbers, as in (1, 0, -2.5)")
    if not all(math.isfinite(v) for v in found):
        raise ValueError(f"{name}={value!r}: expected finite numbers")
    return found


def direction(value: Any, name: str) -> list[float]:
    """Three numbers that are not all 0."""
    found = vector(value, name)
    if not any(found):
        raise ValueError(f"{name}={value!r} has no direction; one of its numbers must not be 0")
    return found


def color(value: Any, name: str) -> str | list[float]:
    """A colour as scenes have it."""
    return value if isinstance(value, str) else vector(value, name)


def size(value: Any) -> tuple[int, int]:
    """Width and height of a picture."""
    if isinstance(value, str):
        parts: Iterable[Any] = value.split("x")
    elif isinstance(value, numbers.Integral):
        parts = (value, value)
    else:
        parts = value
    try:
        width, height = (int(v) for v in parts)
    except (TypeError, ValueError):
        raise TypeError(f"size={value!r}: expected width and height, as in (1024, 768)") from None
    return whole(width, "width of size", 1, 1 << 20), whole(height, "height of size", 1, 1 << 20)


def path(value: Any, name: str) -> Path:
    """The path of a file or a folder on this machine."""
    text = file(value, name)
    if is_address(text):
        raise ValueError(f"{name}={_native.shown(text)!r}: expected a path on this machine, and got an address")
    return Path(text)


def file(value: Any, name: str) -> str:
    """The path or the address of a file. A `Path` cannot hold an address: it makes one slash of two."""
    try:
        text = os.fspath(value)
    except TypeError:
        raise TypeError(f"{name}={_native.shown(repr(value))}: expected the path of a file") from None
    return os.fsdecode(text)


def is_address(text: str) -> bool:
    """Whether it is an address, as in ``s3://bucket/scan.rset``, and not a path."""
    return re.match(r"[A-Za-z][A-Za-z0-9+.-]*://.", text) is not None


def absolute(text: str) -> str:
    """The whole path; addresses are whole."""
    return text if is_address(text) else os.path.abspath(text)


def beside(folder: str, text: str) -> str:
    """A path that stands in a file of a folder, which may be an address itself."""
    return _native.beside(folder, text)


def choice(value: Any, name: str, known: Sequence[str]) -> str:
    """One of some words."""
    if value not in known:
        raise ValueError(f"{name}={value!r}: expected one of {', '.join(known)}")
    return str(value)
