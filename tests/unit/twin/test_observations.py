"""Refusals of observations and the row they name."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from twin.artefact.observations import Observations
from twin.errors import DataError


def values(n: int = 4) -> dict[str, Any]:
    return {
        "position": np.array([0, 0, 1, 1])[:n],
        "ball": np.array([0, 1, 0, 1])[:n],
        "tool": np.zeros(n, dtype=int),
        "axis_positions": np.arange(3.0 * n).reshape(n, 3),
        "covariance": np.tile(np.eye(3) * 1e-6, (n, 1, 1)),
        "temperature_c": np.full(n, 20.0),
        "elevation_rad": np.zeros(n),
        "tool_offsets": np.array([[0.0, 250.0, 0.0]]),
    }


def test_good_values_are_kept_and_frozen() -> None:
    seen = Observations(**values())
    assert seen.size == 4
    with pytest.raises(ValueError, match="read-only"):
        seen.axis_positions[0, 0] = 1.0
    assert seen.select(np.array([True, False, True, False])).ball.tolist() == [0, 0]


def broken(name: str, row: int, value: Any) -> dict[str, Any]:
    changed = values()
    changed[name] = changed[name].copy()
    changed[name][row] = value
    return changed


@pytest.mark.parametrize(
    ("given", "words", "row"),
    [
        (broken("axis_positions", 2, np.nan), "not a finite", "2"),
        (broken("temperature_c", 1, np.inf), "not a finite", "1"),
        (broken("tool", 3, 1), "unknown tool", "3"),
        (broken("ball", 1, -1), "negative", "1"),
        (broken("covariance", 2, -np.eye(3)), "positive definite", "2"),
        (broken("covariance", 0, np.ones((3, 3))), "positive definite", "0"),
        (broken("covariance", 0, [[1, 0.5, 0], [0, 1, 0], [0, 0, 1]]), "symmetric", "0"),
        (broken("ball", 3, 0), "already given in row 2", "3"),
    ],
)
def test_a_bad_row_is_named(given: dict[str, Any], words: str, row: str) -> None:
    with pytest.raises(DataError, match=words) as caught:
        Observations(**given)
    assert caught.value.where["row"] == row


def test_shapes_must_fit() -> None:
    with pytest.raises(DataError, match="elevation_rad has the shape"):
        Observations(**{**values(), "elevation_rad": np.zeros(3)})
    with pytest.raises(DataError, match="whole numbers"):
        Observations(**{**values(), "ball": np.array([0.0, 1.0, 2.0, 3.0])})
    with pytest.raises(DataError, match="no ball centre"):
        Observations(**values(0))
