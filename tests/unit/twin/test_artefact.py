import math

import numpy as np
import pytest

from twin.artefact.artefact import Artefact, ball_bar
from twin.errors import DataError

# 11 balls, 1500 mm, 40 mm holders tilted by 15°: offset 40 * 0.2588190451 = 10.352761804 mm, by hand.
OFFSET = 10.352761804


def bar(**changes: float) -> Artefact:
    settings: dict[str, float] = {
        "balls": 11, "length_mm": 1500.0, "tilt_rad": math.radians(15.0), "holder_length_mm": 40.0,
        "ball_diameter_mm": 25.0,
    }  # fmt: skip
    return ball_bar("bar", **{**settings, **changes})  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("ball", "expected"),
    [
        (0, (-750.0, -40.0, OFFSET)),
        (1, (-600.0, -40.0 - OFFSET, 0.0)),
        (2, (-450.0, -40.0, -OFFSET)),
        (3, (-300.0, -40.0 + OFFSET, 0.0)),
        (4, (-150.0, -40.0, OFFSET)),
        (10, (750.0, -40.0, -OFFSET)),
    ],
)
def test_balls_go_up_out_down_in(ball: int, expected: tuple[float, float, float]) -> None:
    assert bar().balls[ball] == pytest.approx(expected, abs=1e-8)


@pytest.mark.parametrize("count", [2, 3, 7, 15])
def test_the_number_of_balls_keeps_the_length(count: int) -> None:
    balls = bar(balls=count).balls
    assert (balls[0, 0], balls[-1, 0]) == (-750.0, 750.0)
    assert np.diff(balls[:, 0]) == pytest.approx(1500.0 / (count - 1))


def test_steel_grows_by_17_um_per_kelvin_on_one_and_a_half_metres() -> None:
    warm = bar(tilt_rad=0.0, holder_length_mm=0.0).at(21.0, 0.0)
    assert warm[-1, 0] - warm[0, 0] - 1500.0 == pytest.approx(0.01725, abs=1e-9)


def test_the_sag_of_a_long_bar_is_that_of_a_tube_of_carbon_fibre() -> None:
    weight_n_per_m3, modulus_pa, radius_m, half_length_m = 1600.0 * 9.81, 120e9, 0.015, 0.75
    # thin tube, second moment of area A r²/2; cantilever under its own weight, w L⁴ / 8EI
    sag_mm = 1e3 * weight_n_per_m3 * half_length_m**4 / (8.0 * modulus_pa * 0.5 * radius_m**2)
    assert bar(tilt_rad=0.0).expected_sag_mm == pytest.approx(sag_mm, rel=1e-6)
    assert sag_mm == pytest.approx(0.046, abs=0.001)


def test_sag_is_that_of_a_cantilever_from_the_middle_and_vanishes_upright() -> None:
    sagging = bar(tilt_rad=0.0, sag_mm=0.030)
    # w(x) = (6x² - 4x³ + x⁴)/3 of the end's droop: at x = 0.6, (2.16 - 0.864 + 0.1296)/3 = 0.4752
    level = sagging.at(20.0, 0.0)[:, 2]
    assert level[[5, 8, 10]] == pytest.approx([0.0, -0.030 * 0.4752, -0.030], abs=1e-12)
    assert sagging.at(20.0, math.pi / 3)[10, 2] == pytest.approx(-0.015)
    assert sagging.at(20.0, math.pi / 2)[:, 2] == pytest.approx(np.zeros(11), abs=1e-15)


def test_balls_that_overlap_are_refused_by_number() -> None:
    with pytest.raises(DataError, match=r"balls 0 and 1 are 20\.000 mm apart"):
        bar(balls=2, length_mm=20.0, tilt_rad=0.0)


@pytest.mark.parametrize("spoilt", [np.eye(3), np.full((33, 33), np.nan), -np.eye(33)])
def test_a_covariance_that_cannot_be_is_refused(spoilt: np.ndarray) -> None:
    good = bar()
    with pytest.raises(DataError, match="covariance"):
        Artefact("a", "c", good.balls, 25.0, 20.0, 1e-5, 0.0, spoilt)


def test_one_ball_is_no_artefact() -> None:
    with pytest.raises(DataError, match="two balls"):
        bar(balls=1)
