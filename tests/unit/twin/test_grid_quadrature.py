"""Sums over a grid from few nodes, compared with plain sums over all points."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from twin.machine.grid_quadrature import GridQuadrature

RNG = np.random.default_rng(2)
LINES = (np.linspace(-200.0, 4000.0, 40), np.sort(RNG.uniform(0.0, 900.0, 15)), np.linspace(10.0, 20.0, 4))
POINTS = np.array(list(itertools.product(*LINES)))
DEGREES = (6, 4, 5)


def monomial(points: np.ndarray, powers: tuple[int, ...]) -> np.ndarray:
    scaled = (points - [1900.0, 450.0, 15.0]) / [2100.0, 450.0, 5.0]
    return np.prod(scaled**powers, axis=1)


@pytest.mark.parametrize("powers", [(0, 0, 0), (12, 8, 10), (13, 9, 11), (5, 3, 2), (1, 0, 7)])
def test_products_of_two_columns_are_summed_exactly(powers: tuple[int, ...]) -> None:
    sums = GridQuadrature.for_points(POINTS, DEGREES)
    assert len(sums.nodes) == 7 * 5 * 4  # the last axis has fewer points than nodes
    assert sums.count == len(POINTS)
    plain = monomial(POINTS, powers)
    assert sums.weights @ monomial(sums.nodes, powers) == pytest.approx(plain.sum(), abs=1e-11 * np.abs(plain).sum())


@pytest.mark.parametrize("powers", [(0, 0, 0), (6, 4, 3), (2, 0, 1)])
def test_any_field_is_summed_exactly_against_a_column(powers: tuple[int, ...]) -> None:
    sums = GridQuadrature.for_points(POINTS, DEGREES)
    field = RNG.normal(size=POINTS.shape)
    found = monomial(sums.nodes, powers) @ sums.gather(field)
    assert found == pytest.approx(monomial(POINTS, powers) @ field, abs=1e-10)


@pytest.mark.parametrize(
    "points",
    [RNG.permutation(POINTS), POINTS[:-1], POINTS[:, [1, 0, 2]], POINTS[::-1], np.ones((5, 3)), POINTS[:1]],
    ids=["shuffled", "one missing", "another order", "descending", "all the same", "one"],
)
def test_points_that_are_no_such_grid_are_summed_one_by_one(points: np.ndarray) -> None:
    sums = GridQuadrature.for_points(points, DEGREES)
    assert sums.weights.sum() == pytest.approx(len(points))
    np.testing.assert_allclose(
        sums.weights @ monomial(sums.nodes, (3, 2, 1)), monomial(points, (3, 2, 1)).sum(), atol=1e-9
    )
    field = np.ones_like(points)
    np.testing.assert_allclose(sums.gather(field).sum(axis=0), field.sum(axis=0), atol=1e-9)
