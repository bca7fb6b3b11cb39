"""Lost motion of the axes: the play operator compared with its definition, step by step."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from simulators.scenario import AxisBehaviour
from simulators.world.lost_motion import PlayOperator

NO_GROWTH = (0.0, 0.0, 0.0)


def play(backlash: float | tuple[float, float, float], growth: tuple[float, float, float] = NO_GROWTH) -> PlayOperator:
    return PlayOperator(
        AxisBehaviour(repeatability_um=0.0, backlash_um=backlash, backlash_growth_um_per_m=growth), seed=1
    )


def test_each_axis_keeps_the_sign_of_its_own_last_motion() -> None:
    axes = play((4.0, 6.0, 8.0))
    assert axes.after((0.0, 0.0, 0.0), (10.0, 10.0, 10.0)) == pytest.approx((-0.002, -0.003, -0.004))
    assert axes.after((10.0, 10.0, 10.0), (10.0, 0.0, 10.0)) == pytest.approx((-0.002, 0.003, -0.004))
    assert axes.after((10.0, 0.0, 10.0), (20.0, 0.0, 0.0)) == pytest.approx((-0.002, 0.003, 0.004))


def test_a_way_back_shorter_than_the_play_leaves_the_slide_where_it_was() -> None:
    axes = play(8.0)
    axes.after((0.0, 0.0, 0.0), (10.0, 0.0, 0.0))
    x, _, _ = axes.after((10.0, 0.0, 0.0), (9.997, 0.0, 0.0))
    assert 9.997 + x == pytest.approx(10.0 - 0.004)


def test_rounding_is_no_motion() -> None:
    axes = play(8.0)
    axes.after((0.0, 0.0, 0.0), (10.0, 0.0, 0.0))
    assert axes.after((10.0, 0.0, 0.0), (10.0 - 1e-12, 5.0, 0.0))[0] == pytest.approx(-0.004)


def test_play_grows_along_the_axis_and_never_below_nothing() -> None:
    axes = play(2.0, (4.0, -4.0, 0.0))
    assert axes.after((0.0, 0.0, 0.0), (1000.0, 1000.0, 1000.0)) == pytest.approx((-0.003, 0.0, -0.001))


@given(st.lists(st.floats(-0.02, 0.02), min_size=1, max_size=40))
def test_slide_is_that_of_the_play_operator_in_small_steps(ways: list[float]) -> None:
    """Brute force: the drive moves in steps of 0.1 µm and pushes the slide only at either end of the play."""
    ways = [round(way, 4) for way in ways if abs(round(way, 4)) > 1e-4]
    axes, drive, slide, half = play(8.0), 0.0, 0.0, 0.004
    for way in ways:
        lag = axes.after((drive, 0.0, 0.0), (drive + way, 0.0, 0.0))[0]
        for step in np.linspace(drive, drive + way, round(abs(way) / 1e-4) + 1):
            slide = min(max(slide, step - half), step + half)
        drive += way
        assert drive + lag == pytest.approx(slide, abs=1e-9)
