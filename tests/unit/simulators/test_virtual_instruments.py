"""Virtual instruments on machines whose errors are known in closed form: their figures, and what they state."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from worlds import case_study, ideal_world

from drivers.errors import InputError
from drivers.roles import TableImage
from simulators.instruments.ballbar import BallbarClass, Circle, measure_circle
from simulators.instruments.interferometer import Air, InterferometerClass, measure_line
from simulators.instruments.machine_under_test import MachineUnderTest, machine_of_world
from simulators.instruments.straightness_interferometer import (
    StraightnessClass,
    measure_squareness,
    measure_straightness,
)
from simulators.instruments.target_line import TargetLine
from simulators.scenario import AxisBehaviour
from simulators.temperatures import ThermalSettings
from simulators.wire.control_channel import ControlServer
from simulators.wire.instrument_requests import VirtualInstruments
from simulators.wire.shared_world import SharedWorld
from simulators.world.world import World

NO_ERRORS = AxisBehaviour(repeatability_um=0.0, backlash_um=0.0)
ALONG_X = TargetLine(np.array([0.0, 600.0, 700.0]), np.array([2000.0, 600.0, 700.0]))
ALONG_Y = TargetLine(np.array([1000.0, 0.0, 700.0]), np.array([1000.0, 1200.0, 700.0]))
CIRCLE = Circle(np.array([1000.0, 600.0, 700.0]), 150.0, (0, 1))
LOW_TO_X = [[0, 0, 0], [900, 0, 0]]
PERFECT_LASER = InterferometerClass(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 150.0, 0.0)
PERFECT_OPTICS = StraightnessClass(0.0, 0.0, 50.0, 0.0, 0.0, 0.0)
PERFECT_BAR = BallbarClass(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


def machine(
    field: Callable[[np.ndarray], np.ndarray], behaviour: AxisBehaviour = NO_ERRORS, seed: int = 0
) -> MachineUnderTest:
    return MachineUnderTest(lambda path, _: field(path), behaviour, lambda _: 21.0, seed=seed)


def linear(matrix_urad: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    """Return the field of displacements that is linear in the axis positions."""
    return lambda path: 1e-6 * path @ matrix_urad.T


def scale(x_urad: float) -> Callable[[np.ndarray], np.ndarray]:
    return linear(np.diag([x_urad, 0.0, 0.0]))


def test_the_refractive_index_is_that_of_the_published_example() -> None:
    """NIST, Engineering Metrology Toolbox: n = 1.000271373 at 20 °C, 101.325 kPa and 50 % (Ciddor, 633 nm)."""
    assert Air(20.0, 101.325, 50.0).refractivity == pytest.approx(2.71373e-4, abs=0.15e-6)


def test_a_perfect_laser_shows_the_scale_and_the_play_of_an_axis() -> None:
    behaviour = AxisBehaviour(repeatability_um=0.0, backlash_um=3.0)
    found = measure_line(machine(scale(10.0), behaviour), ALONG_X, 1, PERFECT_LASER)
    assert found.mean_range == pytest.approx(20e-3, abs=1e-6)
    assert found.reversal == pytest.approx(3e-3, abs=1e-6)
    assert found.systematic == pytest.approx(23e-3, abs=1e-6)
    assert found.accuracy == pytest.approx(found.systematic, abs=1e-6)  # nothing scatters
    assert found.repeatability == pytest.approx(3e-3, abs=1e-6)


def test_figures_of_iso_230_2_from_readings_that_scatter() -> None:
    """By the formulas of clause 3 of the standard, in loops over the targets."""
    behaviour = AxisBehaviour(repeatability_um=0.8, backlash_um=2.0)
    found = measure_line(machine(scale(6.0), behaviour, seed=3), ALONG_X, 1, PERFECT_LASER)
    forwards, backwards = found.deviations[:, 0], found.deviations[:, 1]
    highest, lowest, widest = [], [], []
    for target in range(ALONG_X.targets):
        up, down = forwards[:, target], backwards[:, target]
        s_up, s_down = ((sum((one - one_way.mean()) ** 2 for one in one_way) / 4.0) ** 0.5 for one_way in (up, down))
        highest.append(max(up.mean() + 2 * s_up, down.mean() + 2 * s_down))
        lowest.append(min(up.mean() - 2 * s_up, down.mean() - 2 * s_down))
        widest.append(max(2 * s_up + 2 * s_down + abs(up.mean() - down.mean()), 4 * s_up, 4 * s_down))
    assert found.accuracy == pytest.approx(max(highest) - min(lowest))
    assert found.repeatability == pytest.approx(max(widest))


def test_a_diagonal_shows_the_mean_of_the_scales() -> None:
    """Along (1, 1, 1) the scale is a third of the sum of the three scales (ISO 230-6)."""
    line = TargetLine(np.array([0.0, 0.0, 0.0]), np.array([1000.0, 1000.0, 1000.0]))
    found = measure_line(machine(linear(np.diag([9.0, -3.0, 6.0]))), line, 1, PERFECT_LASER)
    assert found.mean_range == pytest.approx(1e-6 * 4.0 * np.sqrt(3.0) * 1000.0, rel=1e-4)


def test_the_dead_path_shows_a_change_of_the_air() -> None:
    """The air pressure rises: the dead path is longer in wavelengths, although nothing has moved."""

    def drift(dead_path_mm: float) -> float:
        quality = InterferometerClass(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, dead_path_mm, 0.5)
        found = measure_line(machine(scale(0.0)), ALONG_X, 1, quality)
        return float(found.deviations[-1, 1, 0] - found.deviations[0, 0, 0])

    hours = measure_line(machine(scale(0.0)), ALONG_X, 1).duration_s / 3600.0
    assert drift(0.0) == pytest.approx(0.0, abs=1e-7)
    # 2.7e-6 per kPa; from the first to the last reading of the first target
    assert drift(1000.0) == pytest.approx(2.68e-6 * 0.5 * hours * 1000.0, rel=0.05)


def test_straightness_optics_show_a_bow_and_a_square_shows_an_angle() -> None:
    def bowed(path: np.ndarray) -> np.ndarray:
        found = np.zeros_like(path)
        found[:, 1] = 8e-3 * (path[:, 0] / 2000.0) ** 2 + 30e-6 * path[:, 0]
        return found

    straight = measure_straightness(machine(bowed), ALONG_X, 1, 1, PERFECT_OPTICS)
    # least-squares line of a parabola at 11 even targets, worked out for share² on 0 to 1: residuals 0.15 and -0.1
    assert straight.span == pytest.approx(8e-3 * 0.25, abs=1e-6)
    turned = np.zeros((3, 3))
    turned[1, 0], turned[0, 1] = 7.0, -2.0
    square = measure_squareness(machine(linear(turned)), (ALONG_X, ALONG_Y), (0, 1), 1, PERFECT_OPTICS)
    assert square.angle_rad == pytest.approx(-5e-6, abs=1e-9)


def test_a_ballbar_shows_squareness_and_scale_as_an_ellipse() -> None:
    turned = np.zeros((3, 3))
    turned[1, 0] = 20.0
    found = measure_circle(machine(linear(turned)), CIRCLE, 1, PERFECT_BAR)
    assert found.g_mean == pytest.approx(150.0 * 20e-6, rel=1e-3)  # R sin 2θ / 2, from minimum to maximum
    assert found.g_bidirectional == pytest.approx(found.g_mean, rel=1e-3)
    grown = measure_circle(machine(linear(np.diag([30.0, 30.0, 0.0]))), CIRCLE, 1, PERFECT_BAR)
    assert grown.radius == pytest.approx(150.0 * 30e-6, rel=1e-3)
    assert grown.g_mean == pytest.approx(0.0, abs=1e-5)


def test_lost_motion_enlarges_the_paths_but_not_their_mean() -> None:
    behaviour = AxisBehaviour(repeatability_um=0.0, backlash_um=5.0)
    found = measure_circle(machine(scale(0.0), behaviour), CIRCLE, 1, PERFECT_BAR)
    assert found.g_mean < 1e-4
    assert found.g_clockwise > 4e-3
    assert found.hysteresis == pytest.approx(5e-3, rel=0.05)  # just after the reversal of an axis


def test_the_evaluation_removes_the_set_up() -> None:
    off_centre = BallbarClass(0.0, 0.0, 0.0, 0.0, 60.0, 0.0)
    found = measure_circle(machine(scale(0.0)), CIRCLE, 1, off_centre)
    assert found.g_mean < 1e-4  # of 60 µm, terms of second order are left
    other = measure_straightness(machine(scale(0.0)), ALONG_X, 1, 1, StraightnessClass(0.0, 0.0, 500.0, 0.0, 0.0, 0.0))
    assert other.span < 1e-9


def test_statements_hold_what_the_instruments_err() -> None:
    """Errors over their standard uncertainty, on a machine without scatter: the statement is neither too small nor
    idle."""
    turned = np.array([[8.0, -3.0, 0.0], [5.0, -6.0, 0.0], [0.0, 0.0, 0.0]])
    true = machine(linear(turned))
    seeds = range(80)
    lines = [measure_line(true, ALONG_X, seed) for seed in seeds]
    squares = [measure_squareness(true, (ALONG_X, ALONG_Y), (0, 1), seed) for seed in seeds]
    circles = [measure_circle(true, CIRCLE, seed) for seed in seeds]
    exact = measure_circle(true, CIRCLE, 1, PERFECT_BAR)
    scores = {
        "M": [(one.mean_range - 16e-3) / one.mean_range_u for one in lines],
        "squareness": [(one.angle_rad + 2e-6) / one.angle_u_rad for one in squares],
        "G": [(one.g_mean - exact.g_mean) / one.g_mean_u for one in circles],
        "radius": [(one.radius - exact.radius) / one.radius_u for one in circles],
    }
    for name, found in scores.items():
        size = float(np.sqrt(np.mean(np.square(found))))
        assert 0.6 < size < 1.35, (name, size)
        assert np.mean(np.abs(found) <= 2.0) >= 0.9, name


def test_a_world_is_observed_with_its_table_and_stays_as_it_is() -> None:
    world = ideal_world()
    correction = np.zeros((2, 2, 2, 3), dtype=np.int32)
    correction[1, :, :, 0] = 400  # 40 µm at the upper end of X
    world.controller.write_bank(1, TableImage((0.0, 0.0, 0.0), (2000.0, 1300.0, 1500.0), 1e-4, correction))
    before = world.now, world.controller.displayed_position().tolist()
    for bank, shown_mm in ((0, 0.0), (1, 40e-3)):
        found = measure_line(machine_of_world(world, bank, 1), ALONG_X, 1, PERFECT_LASER)
        assert found.mean_range == pytest.approx(shown_mm, abs=1e-6)
    assert (world.now, world.controller.displayed_position().tolist()) == before
    with pytest.raises(InputError, match="bank 2 holds no table"):
        machine_of_world(world, 2, 1)


def test_a_machine_that_warms_up_scatters_between_the_runs() -> None:
    scenario = case_study().without_errors()
    warming = ThermalSettings(machine_k_per_h=2.0, growth_um_per_k=(5.0, 0.0, 0.0), scale_um_per_m_k=(10.0, 0.0, 0.0))
    settings = scenario.settings.model_copy(update={"temperatures": warming})
    world = World(type(scenario)(settings, scenario.machine, scenario.artefact))
    still = measure_line(machine_of_world(ideal_world(), 0, 1), ALONG_X, 1)
    found = measure_line(machine_of_world(world, 0, 1), ALONG_X, 1)
    assert found.repeatability > 3.0 * still.repeatability
    assert found.mean_range_u > still.mean_range_u


@pytest.mark.parametrize(
    ("request_", "key"),
    [
        ({"do": "interferometer", "from_mm": [0, 0, 0], "to_mm": [0, 0, 0]}, "from_mm"),
        ({"do": "interferometer", "from_mm": [0, 0], "to_mm": [1, 0, 0]}, "from_mm"),
        ({"do": "interferometer", "from_mm": [0, 0, 0], "to_mm": [9, 0, 0], "targets": 1}, "targets"),
        ({"do": "interferometer", "from_mm": [0, 0, 0], "to_mm": [9, 0, 0], "runs": 99}, "runs"),
        ({"do": "interferometer", "from_mm": [0, 0, 0], "to_mm": [9, 0, 0], "bank": 5}, "bank"),
        ({"do": "interferometer", "from_mm": [0, 0, 0], "to_mm": [9, 0, 0], "seed": -1}, "seed"),
        ({"do": "straightness", "from_mm": [0, 0, 0], "to_mm": [9, 0, 0], "across": "A"}, "across"),
        ({"do": "squareness", "lines_mm": [[0, 1]], "plane": "XY"}, "lines_mm"),
        ({"do": "ballbar", "centre_mm": [1, 2, 3], "radius_mm": 0.0, "plane": "XY"}, "radius_mm"),
        ({"do": "ballbar", "centre_mm": [1, 2, 3], "radius_mm": 10.0, "plane": "XX"}, "plane"),
        ({"do": "ballbar", "centre_mm": [1, 2, 3], "radius_mm": True, "plane": "XY"}, "radius_mm"),
        ({"do": "ballbar", "centre_mm": [1, 2, 3], "radius_mm": 10**400, "plane": "XY"}, "radius_mm"),
        ({"do": "ballbar", "centre_mm": [9, 9, 9], "radius_mm": 100, "plane": "XY"}, "radius_mm"),
        ({"do": "ballbar", "centre_mm": [-90, 9, 9], "radius_mm": 5, "plane": "XY"}, "centre_mm"),
        ({"do": "interferometer", "from_mm": [0, 0, 0], "to_mm": [1e5, 0, 0]}, "to_mm"),
        ({"do": "straightness", "from_mm": [0, 0, 0], "to_mm": [9, 0, 0], "across": "X"}, "across"),
        ({"do": "squareness", "lines_mm": [LOW_TO_X, LOW_TO_X], "plane": "XY"}, "lines_mm"),
        ({"do": "squareness", "lines_mm": [LOW_TO_X, LOW_TO_X[::-1]], "plane": "YX"}, "lines_mm"),
        ({"do": "squareness", "lines_mm": [LOW_TO_X, [[0, 0, 0], [0, -1e5, 0]]], "plane": "XY"}, "lines_mm"),
    ],
)
def test_a_bad_request_is_refused_with_its_key(request_: dict[str, object], key: str) -> None:
    with pytest.raises(InputError) as refused:
        VirtualInstruments(SharedWorld(ideal_world())).measure(request_)
    assert refused.value.where["key"] == key


@pytest.mark.parametrize("value", ["1" + 400 * "0", "NaN", "-1e7", "true"])
@pytest.mark.parametrize(
    ("request_", "key"),
    [
        ('{"do": "jog", "axis": "X", "distance_mm": VALUE}', "distance_mm"),
        ('{"do": "place_by_hand", "station": 1, "azimuth_deg": VALUE}', "azimuth_deg"),
        ('{"do": "interferometer", "from_mm": [0, 0, VALUE], "to_mm": [9, 0, 0]}', "from_mm"),
    ],
)
def test_the_control_channel_answers_a_number_that_is_none(request_: str, key: str, value: str) -> None:
    shared = SharedWorld(ideal_world())
    server = ControlServer(shared, ("127.0.0.1", 0), measure=VirtualInstruments(shared).measure)
    try:
        answer = server.answer(request_.replace("VALUE", value).encode())
    finally:
        server.close()
    assert f"{key} must be a number from -1000000 to 1000000" in answer["error"]


def test_the_second_line_of_a_squareness_is_measured_after_the_first() -> None:
    instants: list[np.ndarray] = []

    def still(path: np.ndarray, at_s: np.ndarray) -> np.ndarray:
        instants.append(at_s)
        return np.zeros_like(path)

    found = measure_squareness(
        MachineUnderTest(still, NO_ERRORS, lambda _: 21.0, now_s=100.0), (ALONG_X, ALONG_Y), (0, 1), 1
    )
    first, second = instants
    assert first[0] > 100.0
    assert second[0] > first[-1]
    assert found.duration_s == pytest.approx(second[-1] - 100.0)
