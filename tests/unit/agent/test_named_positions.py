"""Errors about a position of a run name it by its number in the run, not by its place among the observations."""

from __future__ import annotations

import numpy as np
import pytest

from agent.probing.ball import FittedBall
from agent.probing.measured_balls import MeasuredBall, no_correction, observations_of
from agent.results.observations import positions_named
from agent.thermal.readings import Conditions
from twin.errors import PositionError


def ball(position: int, number: int) -> MeasuredBall:
    fitted = FittedBall(
        centre_mm=np.array([100.0 * number, 0.0, 0.0]),
        covariance_mm2=1e-6 * np.eye(3),
        radius_mm=12.5,
        form_mm=0.001,
        touches=5,
        residuals_mm=np.zeros(5),
    )
    return MeasuredBall(position, 1, 0.0, 0.0, number, fitted, Conditions(0.0, 20.0))


def test_the_number_is_that_of_the_run_and_no_row_is_named() -> None:
    """Position 3 is held out, so that position 7 is the second one of the observations."""
    balls = [ball(position, number) for position in (2, 7) for number in range(4)]
    seen = observations_of(balls, np.zeros(3), no_correction)
    slip = PositionError(int(seen.position[6]), "moved between ball 1 and ball 2 by about 30 µm", row=6, hint="repeat")
    with pytest.raises(PositionError) as caught, positions_named(balls):
        raise slip
    assert str(caught.value) == "position 7 moved between ball 1 and ball 2 by about 30 µm. repeat"
    assert caught.value.position == 7
