"""What is said of a look: values as people have them in Python, and what is said of others."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import rayset as rs


def test_values_of_numpy_mean_what_numbers_and_lists_of_python_mean(cloud: rs.Cloud) -> None:
    said = dict(color_by="T", value_range=(-1.5, 2.0), radius_scale=1.5, opacity=[(0.0, 0.0), (1.0, 0.5)], log=False)
    of_numpy = dict(said, value_range=np.array([-1.5, 2]), radius_scale=np.float32(1.5), opacity=np.array([[0, 0], [1, 0.5]]))
    typed = dict(said, value_range="-1.5:2", radius_scale="1.5", opacity="0:0,1:0.5", log=None)
    scene = rs.Scene(cloud, **said).to_json()
    assert scene["root"]["radiusScale"] == 1.5
    assert rs.Scene(cloud, **of_numpy).to_json() == scene == rs.Scene(cloud, **typed).to_json()
    extinction = rs.Scene(cloud, opacity=2).to_json()["root"]["transferFunction"]["opacity"]
    assert extinction == {"extinction": 2}


@pytest.mark.parametrize(
    ("name", "value", "what"),
    [
        ("radius_scale", 1e9, "`1000000000.0` is not a number from 0.001 to 1000"),
        ("stop", float("nan"), "`nan` is not a number from 0 to 0.999"),
        ("value_range", (1,), "expected two numbers, or a range like 1%:99%, and got [1]"),
        ("value_range", (0, float("inf")), 'expected two numbers, or a range like 1%:99%, and got [0,"inf"]'),
        ("opacity", [], "expected clamp, an extinction, or a curve [[0, 0], [1, 0.5]], and got []"),
        ("log", "yes", 'expected true or false, and got "yes"'),
        ("kernel", "round", "unknown kernel `round`; expected one of"),
        ("color_by", "U", "there is no such attribute"),
    ],
)
def test_a_wrong_value_is_said_by_the_name_of_the_argument(cloud: rs.Cloud, name: str, value: Any, what: str) -> None:
    with pytest.raises(rs.SceneError) as caught:
        rs.Scene(cloud, **{name: value})
    assert str(caught.value).startswith(name) and what in str(caught.value)


def test_arguments_that_exclude_each_other_are_refused(cloud: rs.Cloud) -> None:
    with pytest.raises(rs.SceneError, match="color: cannot be used with color_by"):
        rs.Scene(cloud, color="#000000", color_by="T")
