"""Readings of instruments on a machine with transforms of its own (`campaigns.foreign`)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from campaigns.foreign.artefact import STATIONS_MM, measure_at, tilted_bar
from campaigns.foreign.machine import HIGH, LOW, RANGES, TOOL, ForeignMachine, Polynomials
from campaigns.foreign.score import family_of
from twin.artefact.artefact import Artefact
from twin.artefact.observations import Observations
from twin.errors import DataError
from twin.formats.estimate_file import format_estimate, parse_estimate
from twin.identification import Estimate, Options, identify
from twin.identification.instruments.consistency import check_instruments, identify_with_instruments
from twin.identification.instruments.kinds import (
    BallbarSetUp,
    LaserSetUp,
    Readings,
    StraightnessSetUp,
    ballbar_circle,
    laser_line,
    level_readings,
    stated_values,
    straightness_line,
)
from twin.identification.instruments.readings import InstrumentReadings
from twin.identification.instruments.rows import direct_information, reading_covariance, reading_rows
from twin.identification.unknowns import Unknowns

ORDER = 3
FAMILY = family_of(ORDER)
MIDDLE = 0.5 * (LOW + HIGH)
NO_BENDING = np.array([0.0, 1.0, 0.0, 0.0, 0.0, 0.0])
ORIENTATIONS = ((0.0, 45.0), (90.0, -45.0))
SECOND_ORDER_MM = 3e-7
Field = Callable[[np.ndarray], np.ndarray]


@cache
def machine(seed: int = 5) -> ForeignMachine:
    """Return a machine whose errors are Legendre series of the order of the model, without straightness of order 1."""
    rng = np.random.default_rng(seed)
    motions = []
    for axis in range(3):
        coefficients = np.array([[6e-3]] * 3 + [[5e-6]] * 3) * rng.uniform(-1.0, 1.0, (6, ORDER))
        coefficients[[row for row in range(3) if row != axis], 0] = 0.0
        motions.append(Polynomials(coefficients))
    return ForeignMachine((motions[0], motions[1], motions[2]), rng.normal(0.0, 7e-6, 3), NO_BENDING)


@cache
def measured() -> tuple[Observations, Artefact]:
    rng = np.random.default_rng(3)
    bar = tilted_bar(rng, 5)
    return measure_at(machine(), bar, [(place, ORIENTATIONS) for place in STATIONS_MM], rng).seen, bar.artefact


def estimated(instruments: tuple[InstrumentReadings, ...] = (), *, scales: bool = False) -> Estimate:
    seen, artefact = measured()
    options = Options(instruments=instruments, estimate_scales=scales, outliers="none")
    return identify(FAMILY.model, seen, artefact, FAMILY, options)


@cache
def alone() -> Estimate:
    return estimated()


def line_points(axis: int, count: int = 12) -> np.ndarray:
    points = np.tile(MIDDLE, (count, 1))
    points[:, axis] = np.linspace(LOW[axis] + 60.0, HIGH[axis] - 60.0, count)
    return points


def laser(
    wrong_scale: float = 0.0, name: str = "laser.csv", bad: int | None = None, field: Field | None = None
) -> InstrumentReadings:
    points = line_points(0)
    shown = (field or machine().deviation)(points)[:, 0]
    shown = shown - shown[0] + wrong_scale * (points[:, 0] - points[0, 0])
    shown = shown + np.random.default_rng(9).normal(0.0, 0.3e-3, len(points))
    if bad is not None:
        shown[bad] += 0.03
    seen = Readings(name, shown, np.full(len(points), 0.3e-3), TOOL, tuple(range(6, 18)))
    return laser_line(seen, points, LaserSetUp())


def circle(axes: tuple[int, int] = (0, 1)) -> InstrumentReadings:
    angles = np.radians(np.arange(0.0, 360.0, 15.0))
    outwards = np.zeros((len(angles), 3))
    outwards[:, axes[0]], outwards[:, axes[1]] = np.cos(angles), np.sin(angles)
    # distance of the real tip to a centre ball that stands 20 µm off, minus the radius
    ball = MIDDLE + TOOL + np.array([0.02, -0.01, 0.015])
    at = MIDDLE + 150.0 * outwards
    shown = np.linalg.norm(at + TOOL + machine().deviation(at) - ball, axis=1) - 150.0
    shown = shown + np.random.default_rng(4).normal(0.0, 0.1e-3, len(angles))
    return ballbar_circle(
        Readings("ballbar.csv", shown, np.full(len(angles), 0.1e-3), TOOL), MIDDLE, 150.0, axes, angles, BallbarSetUp()
    )


def true_unknowns(unknowns: Unknowns) -> np.ndarray:
    """Return the true parameters in units of the prior, from the coefficients that the machine was drawn with."""
    true = machine()
    values = dict(zip(("A0Z", "B0Z", "C0Y"), true.squareness, strict=True))
    for axis, motion in zip("XYZ", true.motions, strict=True):
        assert isinstance(motion, Polynomials)
        for direction, row in zip("XYZABC", motion.coefficients, strict=True):
            values |= {f"E{direction}{axis}[{order}]": value for order, value in enumerate(row, start=1)}
    z = np.zeros(unknowns.blocks.size)
    for index, name in enumerate(unknowns.model.names):
        z[index] = values.get(name, 0.0) / unknowns.scale[index]
    return z


def left_over(readings: InstrumentReadings) -> np.ndarray:
    """Return what the true machine leaves of noiseless readings, after the free set-up is fitted, by own arithmetic."""
    unknowns = alone().unknowns
    rest = readings.readings - reading_rows(readings, unknowns) @ true_unknowns(unknowns)
    return rest - readings.free @ np.linalg.lstsq(readings.free, rest, rcond=None)[0]


def exact(values: np.ndarray, tool: np.ndarray = TOOL) -> Readings:
    return Readings("exact.csv", values, np.full(len(values), 1e-4), tool)


@pytest.mark.parametrize("axis", range(3))
def test_a_laser_sees_the_deviation_along_its_line(axis: int) -> None:
    points = line_points(axis)
    shown = machine().deviation(points)[:, axis]
    assert np.ptp(shown) > 1e-3
    assert left_over(laser_line(exact(shown), points, LaserSetUp())) == pytest.approx(0.0, abs=SECOND_ORDER_MM)


def test_a_diagonal_is_a_line_too() -> None:
    points = LOW + np.linspace(0.05, 0.95, 11)[:, None] * (HIGH - LOW)
    at = points + machine().deviation(points)
    shown = np.linalg.norm(at - at[0], axis=1) - np.linalg.norm(points - points[0], axis=1)
    assert left_over(laser_line(exact(shown), points, LaserSetUp())) == pytest.approx(0.0, abs=SECOND_ORDER_MM)


def test_straightness_optics_see_what_is_across_and_neither_zero_nor_alignment() -> None:
    points = line_points(0)
    shown = machine().deviation(points)[:, 2] + 0.4 + 50e-6 * points[:, 0]
    seen = straightness_line(exact(shown), points, (0.0, 0.0, 1.0), StraightnessSetUp())
    assert left_over(seen) == pytest.approx(0.0, abs=SECOND_ORDER_MM)


@pytest.mark.parametrize("axes", [(0, 1), (1, 2), (2, 0)])
def test_a_ballbar_sees_radii_about_a_centre_that_it_does_not_know(axes: tuple[int, int]) -> None:
    seen = circle(axes)
    # of second order: the square of the centre's 25 µm across the bar over twice the radius, 2 nm; and the noise
    assert np.abs(left_over(seen)).max() < 0.4e-3
    assert np.ptp(seen.readings) > 10e-3


@pytest.mark.parametrize("direction", range(3))
def test_a_level_sees_the_turn_of_the_tool(direction: int) -> None:
    rng = np.random.default_rng(2)
    points = rng.uniform(LOW, HIGH, (8, 3))
    share = (points - LOW) / (HIGH - LOW)
    # to first order the angles of all axes add up: the true turn is the sum of their Legendre series
    turn = np.sum(
        [motion.at(share[:, axis])[:, 3 + direction] for axis, motion in enumerate(machine().motions)], axis=0
    )
    seen = level_readings(exact(turn + 3e-4, np.zeros(3)), points, np.eye(3)[direction], 0.5)
    assert left_over(seen) == pytest.approx(0.0, abs=1e-9)


def test_one_estimate_is_that_of_all_equations_with_the_set_up_as_unknowns() -> None:
    """Dense least squares: posterior of the ball centres, readings, and one column for each unknown of a set-up."""
    first, instruments = alone(), (laser(), circle())
    precision = np.linalg.inv(first.z_covariance)
    size, count = len(first.z), sum(one.free.shape[1] for one in instruments)
    normal, right, at = np.zeros((size + count, size + count)), np.zeros(size + count), size
    normal[:size, :size], right[:size] = precision, precision @ first.z
    for one in instruments:
        rows = np.zeros((one.size, size + count))
        rows[:, :size] = reading_rows(one, first.unknowns)
        rows[:, at : at + one.free.shape[1]] = one.free
        at += one.free.shape[1]
        weight = np.linalg.inv(reading_covariance(one, first.unknowns))
        normal, right = normal + rows.T @ weight @ rows, right + rows.T @ weight @ one.readings
    joint = estimated(instruments)
    assert joint.z == pytest.approx(np.linalg.solve(normal, right)[:size], abs=2e-3)
    assert joint.z_covariance == pytest.approx(np.linalg.inv(normal)[:size, :size], abs=1e-6)


def test_right_instruments_join_and_bring_the_estimate_nearer_to_the_truth() -> None:
    joint = identify_with_instruments(estimated, (laser(), circle()))
    assert [(check.joined, check.contradicts) for check in joint.instruments] == [(True, False)] * 2
    points = line_points(0, 40)

    def left_um(estimate: Estimate) -> float:
        basis = reading_rows(laser_line(exact(np.zeros(40)), points, LaserSetUp()), estimate.unknowns)
        rest = basis @ (true_unknowns(estimate.unknowns) - estimate.z)
        return 1e3 * float((rest - rest.mean()).std())

    assert left_um(joint) < 0.5 * left_um(alone())


def test_scales_and_the_joint_prediction_of_the_line() -> None:
    """With free scales the instruments join too; the scales are those of the ball centres."""
    first, joint = estimated(scales=True), estimated((laser(),), scales=True)
    assert joint.scales.values == pytest.approx(first.scales.values, rel=1e-9)
    index = joint.model.index("EXX[1]")
    assert joint.standard_uncertainty[index] < first.standard_uncertainty[index]


def test_the_common_scale_is_that_of_the_ball_centres() -> None:
    """The test is about what the artefact shows, and a laser that has joined does not change it."""
    seen, artefact = measured()
    first, joint = (
        identify(FAMILY.model, seen, artefact, FAMILY, Options(instruments=instruments)).common_scale
        for instruments in ((), (laser(),))
    )
    assert first is not None
    assert joint is not None
    assert joint.scale_um_per_m == pytest.approx(first.scale_um_per_m, abs=2e-3)
    assert joint.axes_um_per_m == pytest.approx(first.axes_um_per_m, abs=2e-3)
    assert joint.standard_uncertainty_um_per_m == pytest.approx(first.standard_uncertainty_um_per_m, rel=1e-3)
    assert joint.false_alarm == pytest.approx(first.false_alarm, rel=1e-3)


def test_a_wrong_laser_is_named_with_its_row_and_the_right_ballbar_is_not() -> None:
    wrong, right = check_instruments(alone(), (laser(wrong_scale=2e-5), circle()))
    assert wrong.contradicts
    assert not wrong.joined
    assert right.joined
    assert wrong.largest.text.startswith(f"row {wrong.largest.line}: ")
    assert abs(wrong.largest.sigmas) > 4.0
    assert wrong.largest.line in range(6, 18)
    kept, _ = check_instruments(alone(), (laser(wrong_scale=2e-5), circle()), keep_contradicting=True)
    assert kept.contradicts
    assert kept.joined


def test_of_three_lasers_the_odd_one_is_named() -> None:
    """The ball centres alone do not see an error of scale of 4 µm/m, but two other lasers do."""
    three = (laser(name="one.csv"), laser(4e-6, name="odd.csv"), laser(name="two.csv"))
    assert [check.contradicts for check in check_instruments(alone(), three)] == [False, True, False]


def test_one_bad_reading_is_named_by_its_row() -> None:
    (check,) = check_instruments(alone(), (laser(bad=5),))
    assert check.contradicts
    assert check.largest.line == 11
    assert check.largest.micro[0] == pytest.approx(30.0, abs=8.0)


def test_values_of_an_earlier_report_are_parameters_with_their_uncertainty() -> None:
    truth = float(machine().squareness[2])
    stated = stated_values("report.csv", ("C0Y",), ("rad",), np.array([truth]), np.array([0.1e-6]), (2,))
    joint = estimated((stated,))
    index = joint.model.index("C0Y")
    assert joint.parameters[index] == pytest.approx(truth, abs=0.4e-6)
    assert joint.standard_uncertainty[index] < 0.11e-6
    with pytest.raises(DataError, match="is no parameter"):
        estimated((stated_values("r.csv", ("EXX[9]",), ("mm",), np.zeros(1), np.ones(1), (7,)),))


def lines_of_one_laser(wrong_scale: float, device: str | None = "laser 1") -> tuple[InstrumentReadings, ...]:
    """Return lines along X, Y and Z, all with the same error of scale."""
    found = []
    for axis, name in enumerate("xyz"):
        points = line_points(axis)
        shown = machine().deviation(points)[:, axis] + wrong_scale * points[:, axis]
        shown = shown + np.random.default_rng(9 + axis).normal(0.0, 0.05e-3, len(points))
        seen = Readings(f"{name}.csv", shown, np.full(len(points), 0.05e-3), TOOL, device=device)
        found.append(laser_line(seen, points, LaserSetUp(scale_um_per_m=0.5)).with_unresolved(0.0))
    return tuple(found)


@pytest.mark.parametrize(("device", "expected"), [("laser 1", 0.5), (None, 0.5 / 3**0.5)])
def test_lines_of_one_laser_do_not_average_its_scale(device: str | None, expected: float) -> None:
    """Standard uncertainty in µm/m of the mean slope of three axes, from the lines alone."""
    unknowns = alone().unknowns
    direct = direct_information(lines_of_one_laser(0.0, device), unknowns)
    assert direct is not None
    columns = [unknowns.model.index(f"E{axis}{axis}[1]") for axis in "XYZ"]
    slopes = 2e6 / (HIGH - LOW) * unknowns.scale[columns]
    rows = direct.rows[:, columns] / slopes
    covariance = np.linalg.inv(rows.T @ rows)
    assert np.sqrt(covariance.mean()) == pytest.approx(expected, rel=0.05)


def test_all_lines_of_one_wrong_laser_are_named_and_one_within_its_scale_is_not() -> None:
    """The other lines of the same laser do not explain its error away."""
    assert [check.contradicts for check in check_instruments(alone(), lines_of_one_laser(2e-5))] == [True] * 3
    assert [check.contradicts for check in check_instruments(alone(), lines_of_one_laser(0.5e-6))] == [False] * 3
    x, y, z = lines_of_one_laser(0.0)
    again = replace(x, name="again.csv", readings=x.readings + 3e-6 * x.points[:, 0])
    odd = check_instruments(alone(), (x, y, z, again))
    assert [check.name for check in odd if check.contradicts] in (["x.csv"], ["again.csv"])


def test_a_device_is_of_one_kind() -> None:
    one, other = (replace(each, device="device 1") for each in (laser(), circle()))
    with pytest.raises(DataError, match=r"laser.csv \(laser\) and ballbar.csv \(ballbar\) name the same device"):
        Options(instruments=(one, other))


def test_readings_do_not_count_again_in_the_next_night() -> None:
    """Not from the estimate, nor from its file, nor after a night without instruments; new readings do."""
    joint = estimated((laser(),))
    stored = parse_estimate(format_estimate(joint, {}), "estimate.json").carried_over()
    seen, artefact = measured()
    later = identify(FAMILY.model, seen, artefact, FAMILY, Options(carried_over=stored, outliers="none"))
    for known in (joint.carried_over(), stored, later.carried_over()):
        for name in ("laser.csv", "renamed.csv"):
            again = replace(laser(name=name), noise=laser().noise * 2.0)
            with pytest.raises(DataError, match=f"the readings of {name} are already part of the earlier estimate"):
                Options(carried_over=known, instruments=(again,))
        assert Options(carried_over=known, instruments=(circle(), laser(1e-7))).carried_over is known
    assert alone().carried_over().joined_readings == ()


def test_the_bad_uncertainty_is_named_by_its_row() -> None:
    noise = np.full(12, 1e-3)
    noise[7] = 0.0
    with pytest.raises(DataError, match="row 13"):
        laser_line(Readings("l.csv", np.zeros(12), noise, TOOL, tuple(range(6, 18))), line_points(0), LaserSetUp())


def test_a_set_up_that_is_not_determined_twice_counts_once() -> None:
    """At two angles that differ by half a turn, the two coordinates of the centre of a circle are one unknown."""
    angles = np.array([0.25, 1.25]) * np.pi
    seen = Readings("b.csv", np.zeros(2), np.full(2, 1e-4), TOOL)
    assert ballbar_circle(seen, MIDDLE, 150.0, (0, 1), angles, BallbarSetUp()).size == 2


def test_the_rank_counts_the_readings() -> None:
    """Two positions of the bar, and a report that states what it does not show."""
    seen, artefact = measured()
    few = seen.select(seen.position < seen.position.min() + 2)
    options = Options(estimate_scales=False, outliers="none")
    first = identify(FAMILY.model, few, artefact, FAMILY, options)
    names = ("EXX[1]", "EYY[2]", "C0Y")
    stated = stated_values("r.csv", names, ("mm", "mm", "rad"), np.zeros(3), np.array([1e-4, 1e-4, 1e-7]), (2, 3, 4))
    joint = identify(FAMILY.model, few, artefact, FAMILY, replace(options, instruments=(stated,)))
    assert joint.rank == first.rank + 3
    for null in joint.null_directions:
        assert all(abs(null.loadings.get(name, 0.0)) < 1e-6 for name in names)


def test_the_worst_value_is_named_whatever_its_unit() -> None:
    """A wrong squareness of 1 mrad, with a length whose variance in mm² is a million times larger."""
    wrong = float(machine().squareness[2]) + 1e-3
    values, noise = np.array([0.0, wrong]), np.array([20e-3, 0.1e-6])
    (check,) = check_instruments(
        alone(), (stated_values("r.csv", ("EXX[1]", "C0Y"), ("mm", "rad"), values, noise, (2, 3)),)
    )
    assert check.contradicts
    assert (check.largest.line, check.largest.unit) == (3, "rad")
    assert check.largest.micro[0] == pytest.approx(1000.0, rel=0.02)


def test_a_line_begins_at_one_of_its_ends() -> None:
    """If the first target lies inside the line, it depends on chance which end counts as the far one."""
    points = line_points(0)[[5, 0, 11]]
    with pytest.raises(DataError, match="lies on the other side of the first target"):
        laser_line(exact(np.zeros(3)), points, LaserSetUp())


def test_the_travel_of_the_test_is_that_of_the_model() -> None:
    assert FAMILY.model.ranges_mm == RANGES
