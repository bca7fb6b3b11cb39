"""Figures of ISO 230-2 with repeated approaches, and angular errors, against figures that are computed otherwise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from twin.errors import DataError
from twin.machine.error_model import ErrorModel
from twin.machine.kinematic_chain import parse_chain
from twin.workpiece.acceptance import acceptance_tests, axis_line
from twin.workpiece.angles import predict_angles
from twin.workpiece.positioning import AxisRepeats, predict_positioning

RANGES = ((0.0, 900.0), (0.0, 600.0), (0.0, 400.0))
CENTRE = np.array([450.0, 300.0, 200.0])
MODEL = ErrorModel.uniform(parse_chain("tool-Y-Z-X-bed-workpiece"), RANGES, 2, ())
TOOL = np.array([0.0, 120.0, -50.0])


@dataclass(frozen=True, eq=False)
class KnownMachine:
    """Estimate of a machine whose parameters are known to 1 nm and 1 nrad."""

    parameters: np.ndarray
    model: ErrorModel = MODEL
    misfit: None = None
    scatter_mm2: float = 0.0

    @property
    def covariance(self) -> np.ndarray:
        return np.asarray(1e-18 * np.eye(self.model.size))


def known(**values: float) -> KnownMachine:
    parameters = np.zeros(MODEL.size)
    for name, value in values.items():
        parameters[MODEL.index(f"{name[:3]}[{name[3:]}]")] = value
    return KnownMachine(parameters)


def figures_um(machine: KnownMachine, repeats: AxisRepeats) -> dict[str, tuple[float, float, float]]:
    """Return expected value and 95 % limits of each figure of X, in µm."""
    tests = acceptance_tests(RANGES, TOOL, CENTRE, ())
    found = predict_positioning(machine, tests, {"X": repeats}, TOOL)
    errors = {one.test.feature.name: one.figure.without_table for one in found}
    return {name: (1e3 * one.expected_mm, 1e3 * one.low_mm, 1e3 * one.high_mm) for name, one in errors.items()}


def test_an_axis_that_repeats_exactly_has_its_slope_and_its_reversal() -> None:
    """20 µm too long over the travel, and 6 µm of lost motion that does not change by much over 0.9 m."""
    found = figures_um(known(EXX1=10e-3), AxisRepeats(0.0, 29, 6e-3, 0.0, 450.0))
    assert found["R± X"] == pytest.approx((0.0, 0.0, 0.0), abs=1e-6)
    assert found["A± X"] == pytest.approx((20.0,) * 3, abs=1.0)
    for name, right in (("A X", 26.0), ("E X", 26.0), ("R X", 6.0), ("B X", 6.0)):
        assert found[name][1] <= right + 0.01
        assert found[name][2] >= right - 0.01
        assert found[name][0] == pytest.approx(right, abs=0.4)


def test_the_figures_are_those_of_five_approaches() -> None:
    """ISO 230-2 evaluated from simulated readings, with a loop over machines, targets and sides. Lost motion changes
    along the travel of 0.9 m, by 0.5 µm/m as a standard deviation."""
    rng = np.random.default_rng(4)
    sigma_um, lost_um, targets = 0.8, 3.0, 11
    of_machines: dict[str, list[float]] = {name: [] for name in ("A X", "A± X", "E X", "R X", "R± X", "B X")}
    for _ in range(300):
        share, growth_um = rng.uniform(0.0, 1.0), 0.9 * rng.normal(0.0, 0.5)
        up, down = [], []
        for place in np.linspace(-0.5, 0.5, targets):
            half = 0.5 * (lost_um + growth_um * place)
            up.append(20.0 * place - half + share * sigma_um * rng.standard_normal(5))
            down.append(20.0 * place + half + share * sigma_um * rng.standard_normal(5))
        ups, downs = np.array(up), np.array(down)
        s_up, s_down = ups.std(axis=1, ddof=1), downs.std(axis=1, ddof=1)
        reversal = np.abs(ups.mean(axis=1) - downs.mean(axis=1))
        highest = max((ups.mean(axis=1) + 2.0 * s_up).max(), (downs.mean(axis=1) + 2.0 * s_down).max())
        lowest = min((ups.mean(axis=1) - 2.0 * s_up).min(), (downs.mean(axis=1) - 2.0 * s_down).min())
        of_machines["A X"].append(highest - lowest)
        of_machines["A± X"].append((ups.mean(axis=1) + 2.0 * s_up).max() - (ups.mean(axis=1) - 2.0 * s_up).min())
        means = np.concatenate((ups.mean(axis=1), downs.mean(axis=1)))
        of_machines["E X"].append(float(np.ptp(means)))
        of_machines["R X"].append(
            max((2.0 * s_up + 2.0 * s_down + reversal).max(), 4.0 * s_up.max(), 4.0 * s_down.max())
        )
        of_machines["R± X"].append(4.0 * float(s_up.max()))
        of_machines["B X"].append(float(reversal.max()))
    found = figures_um(known(EXX1=10e-3), AxisRepeats(1e-3 * sigma_um, 100000, 1e-3 * lost_um, 0.0, 450.0))
    for name, values in of_machines.items():
        expected, low, high = found[name]
        assert expected == pytest.approx(np.mean(values), abs=0.25)
        assert np.mean([low <= value <= high for value in values]) > 0.9


@pytest.mark.parametrize(
    ("repeats", "names"),
    [
        (AxisRepeats(1e-3, 9), ("A±", "R±")),
        (AxisRepeats(lost_mm=2e-3, lost_sigma_mm=1e-3), ("E",)),
        (AxisRepeats(), ()),
    ],
)
def test_only_what_was_measured_is_stated(repeats: AxisRepeats, names: tuple[str, ...]) -> None:
    assert set(figures_um(known(), repeats)) == {f"{name} X" for name in names}


def test_a_figure_lies_inside_its_own_limits_with_few_degrees_of_freedom() -> None:
    found = figures_um(known(EXX1=10e-3), AxisRepeats(1e-3, 3, 5e-3, 0.5e-3, 450.0))
    assert len(found) == 6
    assert all(low <= expected <= high for expected, low, high in found.values())


def test_figures_beyond_the_travel_of_the_standard_say_so() -> None:
    """ISO 230-2:2014 states accuracy and repeatability for travels of up to 2000 mm, reversal and E for all."""
    model = ErrorModel.uniform(MODEL.chain, ((0.0, 2100.0), (0.0, 2000.0), (0.0, 400.0)), 2, ())
    tests = acceptance_tests(model.ranges_mm, TOOL, CENTRE, ())
    repeats = {name: AxisRepeats(1e-3, 29, 6e-3, 0.0, 450.0) for name in "XY"}
    found = predict_positioning(KnownMachine(np.zeros(model.size), model), tests, repeats, TOOL)
    beyond = {one.test.feature.name for one in found if "over more than the 2000 mm" in one.test.title}
    assert beyond == {"A X", "A± X", "R X", "R± X"}


@pytest.mark.parametrize("given", [(1e-3, 0), (1e-3, 2), (-1e-3, 9), (1e-3, 9, 5e-3, -1e-3)])
def test_a_scatter_that_says_nothing_is_refused(given: tuple[float, ...]) -> None:
    with pytest.raises(DataError, match=r"degrees of freedom|negative"):
        AxisRepeats(*given)  # type: ignore[arg-type]


def test_angles_are_those_of_the_error_motions() -> None:
    """12 µrad of roll and -30 µrad of pitch of X over its travel, and 8 µrad about X as Z rises."""
    machine = known(EAX1=6e-6, EBX1=-15e-6, EAZ1=4e-6)
    lines = tuple(axis_line(RANGES, CENTRE, axis) for axis in range(3))
    found = predict_angles(machine, lines, TOOL, with_table=True)
    names = [one.test.feature.name for one in found]
    assert names == [f"E{about}{axis}" for axis in "XYZ" for about in "ABC"]
    right = dict.fromkeys(names, 0.0) | {"EAX": 12.0, "EBX": 30.0, "EAZ": 8.0}
    for one in found:
        name, error = one.test.feature.name, one.figure.without_table
        # µm over 1000 mm are µrad; nothing but the stated parameters is known exactly
        assert 1e3 * error.expected_mm == pytest.approx(right[name], abs=0.01)
        assert one.figure.with_table == error
    pitch = found[names.index("EBX")]
    assert pitch.curve_mm[0] > 0.0 > pitch.curve_mm[-1]
    assert pitch.test.title.startswith("pitch of X")
