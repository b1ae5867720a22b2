"""What tests share."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

import rayset as rs


@pytest.fixture(autouse=True)
def _own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing goes into the user's cache."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))


def points(count: int = 2000, seed: int = 1) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=(count, 3))


@pytest.fixture(scope="session")
def cloud() -> rs.Cloud:
    """A ball of points in memory, with a temperature and classes."""
    where = points()
    attributes = {"T": where[:, 0].astype("f4"), "kind": (where[:, 1] > 0).astype("u1")}
    return rs.build(where, radius=0.3, attributes=attributes, classes=["kind"])


def program() -> str | None:
    """The program, if it is installed or named."""
    try:
        from rayset import _program

        return os.environ.get("RAYSET_PROGRAM") or _program.path()
    except FileNotFoundError:
        return None
