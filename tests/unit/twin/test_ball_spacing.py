"""Places of balls along a bar: gaps, distances and ends, against their own arithmetic."""

from __future__ import annotations

import math
from itertools import combinations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twin.artefact.artefact import ball_bar
from twin.artefact.ball_spacing import BallSpacing, spaced_balls, stated_places
from twin.errors import DataError

COUNTS = st.integers(2, 30)
LENGTHS = st.floats(10.0, 5000.0)


@given(COUNTS, LENGTHS, st.sampled_from(BallSpacing))
def test_the_gaps_of_every_spacing_add_up_to_the_length(balls: int, length_mm: float, spacing: BallSpacing) -> None:
    places = spaced_balls(balls, length_mm, spacing)
    gaps = np.diff(places)
    assert len(places) == balls
    assert (gaps > 0.0).all()
    assert math.fsum(gaps) == pytest.approx(length_mm)
    assert places[0] == pytest.approx(-0.5 * length_mm)
    assert places[-1] == pytest.approx(0.5 * length_mm)


@given(COUNTS, LENGTHS)
def test_even_gaps_are_equal(balls: int, length_mm: float) -> None:
    assert np.diff(spaced_balls(balls, length_mm, BallSpacing.EVEN)) == pytest.approx(length_mm / (balls - 1))


@given(st.integers(3, 30), LENGTHS)
def test_graded_gaps_grow_by_one_factor_to_twice_the_first(balls: int, length_mm: float) -> None:
    gaps = np.diff(spaced_balls(balls, length_mm, BallSpacing.GRADED))
    assert gaps[-1] / gaps[0] == pytest.approx(2.0)
    assert gaps[1:] / gaps[:-1] == pytest.approx(2.0 ** (1.0 / (balls - 2)))


def test_ends_are_the_chebyshev_lobatto_points() -> None:
    expected = [-math.cos(math.pi * number / 6) for number in range(7)]
    assert spaced_balls(7, 2.0, BallSpacing.ENDS) == pytest.approx(expected)


@pytest.mark.parametrize("balls", range(3, 16))
def test_no_two_distances_of_a_distinct_spacing_are_equal(balls: int) -> None:
    def least_difference(spacing: BallSpacing) -> float:
        places = spaced_balls(balls, 1000.0, spacing)
        return float(np.diff(np.sort([b - a for a, b in combinations(places.tolist(), 2)])).min())

    assert least_difference(BallSpacing.DISTINCT) > 0.01
    assert least_difference(BallSpacing.EVEN) == pytest.approx(0.0, abs=1e-9)


def test_stated_places_are_measured_from_the_middle() -> None:
    assert stated_places([0.0, 140.0, 310.0, 500.0]) == pytest.approx([-250.0, -110.0, 60.0, 250.0])


@pytest.mark.parametrize("places", [[], [0.0], [10.0, 20.0], [0.0, 5.0, 5.0], [0.0, 9.0, 4.0], [0.0, math.nan]])
def test_places_that_do_not_begin_with_0_and_rise_are_refused(places: list[float]) -> None:
    with pytest.raises(DataError, match="do not begin with 0 and rise") as caught:
        stated_places(places)
    assert "0,140,310,500" in caught.value.hint


def test_impossible_bars_are_refused() -> None:
    with pytest.raises(DataError, match="at least two balls"):
        spaced_balls(1, 100.0, BallSpacing.EVEN)
    with pytest.raises(DataError, match="must be positive"):
        spaced_balls(3, 0.0, BallSpacing.EVEN)


def test_a_bar_with_given_places_keeps_the_pattern_of_its_tilted_holders() -> None:
    places = np.array([-300.0, -50.0, 100.0, 300.0])
    bar = ball_bar(
        "bar", balls=4, length_mm=600.0, tilt_rad=math.radians(30.0), holder_length_mm=60.0, ball_diameter_mm=25.0,
        along_mm=places,
    )  # fmt: skip
    assert bar.balls[:, 0] == pytest.approx(places)
    assert bar.balls[:, 1:] == pytest.approx(np.array([[-60.0, 30.0], [-90.0, 0.0], [-60.0, -30.0], [-30.0, 0.0]]))
