"""Pretravel maps compared with probes richer than the harmonics: lobes that grow with the sine, a shifted centre."""

from __future__ import annotations

import math

import numpy as np
import pytest

from twin.artefact.pretravel import PretravelMap, direction_at, fit_pretravel
from twin.artefact.sphere_fit import fit_sphere
from twin.artefact.touch_pattern import QUALIFYING_RINGS, approach_directions, ring_directions
from twin.errors import DataError

AXIS = np.array([0.0, 1.0, 0.0])
DENSE = ring_directions(QUALIFYING_RINGS, AXIS)
RADIUS = 15.5


def lobed(direction: np.ndarray, amplitude: float = 3e-3) -> float:
    """Return the pretravel of a probe on three seats: it grows with the bending of the stylus, not as a polynomial.

    Bending is the sine of the angle to the stylus axis.
    """
    x, _, z = direction
    return 8e-3 + amplitude * math.hypot(x, z) * math.cos(3.0 * math.atan2(z, x) + 0.4)


def latched(directions: np.ndarray, centre: np.ndarray, pretravel=lobed) -> np.ndarray:
    """Return the latched point of a touch along each direction: pretravel beyond contact."""
    return np.array([centre - d * (RADIUS - pretravel(d)) for d in directions])


def a_map() -> PretravelMap:
    return fit_pretravel(DENSE, fit_sphere(latched(DENSE, np.zeros(3)), 1e-3).residuals, AXIS)


@pytest.mark.parametrize("touches", [5, 9, 13, 25])
def test_a_centre_by_any_pattern_is_that_of_the_qualification_with_the_map(touches: int) -> None:
    directions, centre = approach_directions(touches, AXIS), np.array([100.0, -20.0, 7.0])
    points = latched(directions, centre)
    dense = fit_sphere(latched(DENSE, centre), 1e-3)
    with_map = fit_sphere(a_map().correct(points, directions), 1e-3, dense.radius, near=centre)
    assert np.linalg.norm(with_map.centre - dense.centre) < 0.4e-3
    if touches == 5:
        bare = fit_sphere(points, 1e-3)
        assert np.linalg.norm(bare.centre - dense.centre) > 2.5e-3


def test_the_map_leaves_centre_and_radius_of_the_qualification_as_they_are() -> None:
    points = latched(DENSE, np.zeros(3))
    before, after = fit_sphere(points, 1e-3), fit_sphere(a_map().correct(points, DENSE), 1e-3)
    assert after.centre == pytest.approx(before.centre, abs=2e-6)
    assert after.radius == pytest.approx(before.radius, abs=2e-6)
    assert after.form < 0.3 * before.form


def test_a_smooth_probe_has_no_map() -> None:
    """Use equal pretravel in all directions and a stylus off centre: nothing for harmonics beyond the first."""
    points = latched(DENSE, np.array([0.01, 0.02, -0.03]), lambda _: 9e-3)
    found = fit_pretravel(DENSE, fit_sphere(points, 1e-3).residuals, AXIS)
    assert found.largest_mm < 1e-9
    assert np.abs(found.offsets_mm(approach_directions(13, AXIS))).max() < 1e-9


def test_what_the_harmonics_leave_is_the_noise() -> None:
    rng = np.random.default_rng(3)
    found = []
    for _ in range(200):
        points = latched(DENSE, np.zeros(3), lambda _: 8e-3 + rng.normal(0.0, 1e-3))
        found.append(fit_pretravel(DENSE, fit_sphere(points, 1e-3).residuals, AXIS).noise_mm)
    assert np.sqrt(np.mean(np.square(found))) == pytest.approx(1e-3, rel=0.1)


def test_directions_at_a_latitude_are_those_of_a_ring() -> None:
    ring = ring_directions(((30.0, 4, 10.0),), AXIS)[1:]
    for index, direction in enumerate(ring):
        angle = math.radians(10.0 + 90.0 * index)
        assert direction_at(AXIS, math.radians(30.0), angle) == pytest.approx(direction)


@pytest.mark.parametrize("touches", [5, 13])
def test_too_few_touches_carry_no_map(touches: int) -> None:
    with pytest.raises(DataError, match="do not determine"):
        fit_pretravel(approach_directions(touches, AXIS), np.zeros(touches), AXIS)
