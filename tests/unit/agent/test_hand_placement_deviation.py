"""Displacement and rotation of an artefact that was placed by hand, against its nominal place."""

from __future__ import annotations

import math

import numpy as np
import pytest

from agent.probing.hand_placement import deviation

BAR = np.stack([np.linspace(-150.0, 150.0, 7), np.zeros(7), np.full(7, 40.0)], axis=1)
FRAME = np.array([[0.0, 200.0, 80.0], [-165.0, -100.0, 80.0], [150.0, -125.0, 80.0], [15.0, -10.0, 280.0]])


def turned(points: np.ndarray, angle_deg: float) -> np.ndarray:
    c, s = math.cos(math.radians(angle_deg)), math.sin(math.radians(angle_deg))
    return np.asarray(points @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]))


@pytest.mark.parametrize("azimuth_deg", range(-180, 180, 10))
@pytest.mark.parametrize("artefact", [BAR, FRAME], ids=["bar", "frame"])
@pytest.mark.parametrize("angle_deg", [0.0, 0.8, 30.0, 170.0])
def test_the_rotation_of_a_straight_bar_is_that_of_its_line(
    artefact: np.ndarray, azimuth_deg: float, angle_deg: float
) -> None:
    nominal = turned(artefact, azimuth_deg)
    found = turned(nominal, angle_deg)
    shift = np.array([3.0, -4.0, 0.0]) + nominal.mean(axis=0) - found.mean(axis=0)
    shift_mm, turn_deg = deviation(nominal, found + shift)
    assert shift_mm == pytest.approx(5.0)
    assert turn_deg == pytest.approx(angle_deg, abs=1e-4)
