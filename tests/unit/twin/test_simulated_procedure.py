"""Simulated procedures against plain loops over the documented machine, the mount's pose, and a grid."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from plain_machine import deviations

from twin.artefact.artefact import Artefact, ball_bar
from twin.artefact.mount_geometry import MountGeometry
from twin.artefact.position_set import Position, mount_pose
from twin.collision.measuring_layout import MeasuringLayout
from twin.collision.probe_geometry import ProbeGeometry
from twin.design.procedure import PlannedMeasurement, Procedure
from twin.errors import ModelError
from twin.identification import Options, identify
from twin.machine.deflection import DeflectionGrid, cantilever_deflection
from twin.machine.error_model import ErrorModel
from twin.machine.forward_model import exact_deviation
from twin.machine.kinematic_chain import parse_chain
from twin.machine.machine_population import family_from_amplitudes
from twin.machine.true_machine import TrueMachine
from twin.machine.volumetric import align_rigidly, evaluation_grid
from twin.uncertainty.monte_carlo import (
    compensated_errors,
    draw_truth,
    position_progress,
    simulated_observations,
    true_vce,
    uncompensated_errors,
)
from twin.uncertainty.residual_field_form import FieldForm
from twin.uncertainty.truth_assumptions import TruthAssumptions

CHAINS = ("tool-Y-Z-X-bed-workpiece", "tool-Z-bed-Y-X-workpiece")
RANGES = ((0.0, 4000.0), (0.0, 1300.0), (0.0, 1500.0))
TOOL = np.array([0.0, 250.0, 0.0])
AMPLITUDES: dict[str, float | list[float]] = {
    "positioning_um": [12.0, 8.0],
    "straightness_um": [8.0],
    "rotation_urad": [10.0],
    "squareness_urad": 15.0,
    "cross_displacement_um": 6.0,
    "cross_rotation_urad": 5.0,
}
ORIENTATIONS = ((45.0, 0.0), (-45.0, 0.0), (0.0, 45.0), (0.0, -45.0), (90.0, 45.0), (90.0, -45.0), (30.0, 0.0))
MOUNT = MountGeometry()


def bar(tilt_deg: float = 15.0, sag_mm: float = 0.0) -> Artefact:
    return ball_bar(
        "bar",
        balls=7,
        length_mm=1200.0,
        tilt_rad=math.radians(tilt_deg),
        holder_length_mm=60.0,
        ball_diameter_mm=25.0,
        standard_uncertainty_mm=0.8e-3,
        cte_standard_uncertainty_per_k=0.4e-6,
        sag_mm=sag_mm,
    )


def planned_for(artefact: Artefact, orientations: tuple[tuple[float, float], ...] = ORIENTATIONS) -> PlannedMeasurement:
    layout = MeasuringLayout(
        artefact=artefact,
        mount=MOUNT,
        probe=ProbeGeometry(),
        locations_mm={1: np.array([1200.0, 1000.0, 750.0]), 2: np.array([2800.0, 1000.0, 750.0])},
        tool_offset_mm=TOOL,
        lower_mm=np.array([low for low, _ in RANGES]),
        upper_mm=np.array([high for _, high in RANGES]),
        contact_mm=15.0,
        approach_mm=5.0,
    )
    covariance = np.array([[4.0, 1.0, 0.0], [1.0, 2.0, -0.5], [0.0, -0.5, 1.0]]) * 1e-7
    positions = [Position(station, *pair) for station in (1, 2) for pair in orientations]
    return Procedure({"probe": layout}, covariance).plan(positions)


def model(order: int = 5, chain: str = CHAINS[0]) -> ErrorModel:
    return ErrorModel.uniform(parse_chain(chain), RANGES, order)


def deflection() -> DeflectionGrid:
    x, y, z = (np.linspace(low, high, 7) for low, high in RANGES)
    return cantilever_deflection(x, y, z)


def quiet(order: int = 5, chain: str = CHAINS[0], **changes: object) -> TruthAssumptions:
    """Return machines without any other influence."""
    family = family_from_amplitudes(model(order, chain), AMPLITUDES)
    silent = {"touch_noise": False, "certificate": False, "cte": False}
    return TruthAssumptions(family, **{**silent, **changes})  # type: ignore[arg-type]


def perfect(**changes: object) -> TruthAssumptions:
    family = family_from_amplitudes(model(), {})
    silent = {"touch_noise": False, "certificate": False, "cte": False}
    return TruthAssumptions(family, **{**silent, **changes})  # type: ignore[arg-type]


def rng(seed: int = 1) -> np.random.Generator:
    return np.random.default_rng(seed)


class TestTruth:
    def test_it_is_drawn_evenly_between_the_half_widths_of_the_family(self) -> None:
        assumptions, source = quiet(7), rng()
        drawn = np.array([draw_truth(assumptions, source, TOOL).parameters for _ in range(4000)])
        widths = assumptions.family.half_widths
        used = widths > 0.0
        assert (np.abs(drawn) <= widths).all()
        share = drawn[:, used] / widths[used]
        assert np.abs(share.mean(axis=0)).max() < 4.5 / math.sqrt(3.0 * 4000)
        assert np.abs((share**2).mean(axis=0) - 1.0 / 3.0).max() < 0.03

    def test_it_has_the_deflection_of_the_reality(self) -> None:
        field = deflection()
        truth = draw_truth(perfect(deflection=field), rng(), TOOL)
        points = np.array([[100.0, 200.0, 300.0], [3900.0, 1200.0, 40.0]])
        assert np.abs(truth.deviation(points) - field.at(points)).max() < 1e-15


class TestWhereBallsAreFound:
    @pytest.mark.parametrize("chain", CHAINS)
    def test_the_tool_point_is_at_the_ball_by_plain_matrices(self, chain: str) -> None:
        """Check X + t + d(X) = ball, with d from a loop over 4x4 matrices written from the documentation."""
        artefact = bar()
        plan = planned_for(artefact).observations
        assumptions = quiet(7, chain)
        truth = draw_truth(assumptions, rng(), TOOL)
        seen = simulated_observations(plan, artefact, truth, assumptions, rng(2))
        named = dict(zip(assumptions.family.model.names, truth.parameters.tolist(), strict=True))
        off = np.array(deviations(chain, RANGES, seen.axis_positions, TOOL, named))
        assert np.abs(off).max() > 5e-3
        assert np.abs(seen.axis_positions + off - plan.axis_positions).max() < 1e-9

    def test_every_tool_has_its_own_deviation(self) -> None:
        artefact = bar()
        plan = planned_for(artefact).observations
        longer = TOOL + np.array([0.0, 0.0, 120.0])
        both = replace(plan, tool=(plan.position % 2), tool_offsets=np.array([TOOL, longer]))
        assumptions = quiet(deflection=deflection())
        truth = draw_truth(assumptions, rng(), TOOL)
        seen = simulated_observations(both, artefact, truth, assumptions, rng(2))
        for tool, offset in enumerate((TOOL, longer)):
            at = seen.axis_positions[both.tool == tool]
            off = exact_deviation(assumptions.family.model, at, offset, truth.parameters) + deflection().at(at)
            assert np.abs(at + off - plan.axis_positions[both.tool == tool]).max() < 1e-9

    @pytest.mark.parametrize("tilt_deg", [0.0, 15.0])
    @pytest.mark.parametrize("elevation_deg", [0.0, 30.0, 45.0, -45.0])
    def test_warmth_and_gravity_move_balls_as_in_the_pose_of_the_mount(
        self, tilt_deg: float, elevation_deg: float
    ) -> None:
        """Includes a straight bar, whose roll no fit of its balls can determine."""
        artefact = bar(tilt_deg, sag_mm=0.05)
        plan = planned_for(artefact, ((20.0, elevation_deg), (110.0, elevation_deg)))
        warm = perfect(artefact_temperature_c=26.0)
        truth = draw_truth(warm, rng(), TOOL)
        seen = simulated_observations(plan.observations, artefact, truth, warm, rng(2))
        moved = seen.axis_positions - plan.observations.axis_positions
        real = artefact.at(26.0, math.radians(elevation_deg)) - artefact.balls
        for number, position in enumerate(plan.positions):
            rows = plan.observations.position == number
            angles = math.radians(position.azimuth_deg), math.radians(position.elevation_deg)
            turned = real @ mount_pose(np.zeros(3), MOUNT, *angles).rotation.T
            assert np.abs(moved[rows] - turned[plan.observations.ball[rows]]).max() < 1e-9
        assert np.abs(moved).max() > 0.03
        assert (seen.temperature_c == 26.0).all()

    def test_a_bar_that_stands_upright_is_stretched_along_z(self) -> None:
        artefact = bar(0.0)
        plan = planned_for(artefact, ((0.0, 90.0), (0.0, 0.0))).observations
        warm = perfect(artefact_temperature_c=30.0)
        seen = simulated_observations(plan, artefact, draw_truth(warm, rng(), TOOL), warm, rng())
        rows = plan.elevation_rad > 1.0
        growth = np.ptp(seen.axis_positions[rows, 2]) - np.ptp(plan.axis_positions[rows, 2])
        assert growth == pytest.approx(11.5e-6 * 10.0 * np.ptp(plan.axis_positions[rows, 2]), rel=1e-9)


class TestChance:
    """Over many draws every influence has its stated standard deviation; perfect machines show no other error."""

    RUNS = 700

    def found(self, assumptions: TruthAssumptions, artefact: Artefact | None = None) -> np.ndarray:
        """Return measured less planned positions (runs, n, 3)."""
        artefact = artefact or bar()
        plan = planned_for(artefact, ((0.0, 0.0), (45.0, 0.0))).observations
        truth, source = TrueMachine(None, np.zeros(0), TOOL, None), rng(3)
        runs = [simulated_observations(plan, artefact, truth, assumptions, source) for _ in range(self.RUNS)]
        return np.array([run.axis_positions for run in runs]) - plan.axis_positions

    def test_touches_have_the_stated_covariance(self) -> None:
        found = self.found(perfect(touch_noise=True))
        stated = planned_for(bar()).observations.covariance[0]
        pooled = np.einsum("rni,rnj->ij", found, found) / (found.shape[0] * found.shape[1])
        assert np.abs(pooled / stated.max() - stated / stated.max()).max() < 0.05
        neighbours = np.einsum("ri,rj->ij", found[:, 0], found[:, 1]) / self.RUNS
        assert np.abs(neighbours).max() < 5.0 * stated.max() / math.sqrt(self.RUNS)

    def test_the_certificate_is_off_alike_in_every_position_of_a_run(self) -> None:
        artefact = bar()
        shared = np.full((21, 21), 0.3) + 0.7 * np.eye(21)
        artefact = replace(artefact, covariance=shared * (0.8e-3) ** 2)
        plan = planned_for(artefact, ((0.0, 0.0), (45.0, 0.0))).observations
        found = self.found(perfect(certificate=True), artefact)
        first = found[:, plan.position == 0].reshape(self.RUNS, -1)  # at azimuth 0: the artefact's own axes
        assert first.shape[1] == 21
        sample = first.T @ first / self.RUNS / (0.8e-3) ** 2
        assert np.abs(sample - shared).max() < 5.0 / math.sqrt(self.RUNS)
        other = found[:, plan.position == 2].reshape(self.RUNS, -1)  # the same orientation at the other station
        assert np.abs(other - first).max() < 1e-12

    def test_drift_grows_linearly_to_the_last_ball_of_each_position(self) -> None:
        found = self.found(perfect(drift_mm=2e-3))
        plan = planned_for(bar(), ((0.0, 0.0), (45.0, 0.0))).observations
        share = position_progress(plan.position)
        assert share[plan.position == 0].tolist() == pytest.approx([k / 6.0 for k in range(7)])
        ends = found[:, share == 1.0]
        assert np.abs(ends.std(axis=0) / 2e-3 - 1.0).max() < 0.12
        for number in np.unique(plan.position):
            rows = plan.position == number
            last = found[:, rows][:, -1:]
            assert np.abs(found[:, rows] - share[rows][None, :, None] * last).max() < 1e-12
        apart = (ends[:, 0] * ends[:, 1]).mean(axis=0) / 4e-6
        assert np.abs(apart).max() < 5.0 / math.sqrt(self.RUNS)

    def test_rows_of_a_position_need_not_stand_together(self) -> None:
        assert position_progress(np.array([4, 1, 4, 1, 4, 2])).tolist() == [0.0, 0.0, 0.5, 1.0, 1.0, 0.0]

    def test_the_coefficient_of_expansion_is_off_by_its_uncertainty(self) -> None:
        found = self.found(perfect(cte=True, artefact_temperature_c=30.0), bar())
        plan = planned_for(bar(), ((0.0, 0.0), (45.0, 0.0))).observations
        rows = plan.position == 0
        length = found[:, rows][:, -1, 0] - found[:, rows][:, 0, 0]
        assert length.mean() == pytest.approx(11.5e-6 * 10.0 * 1200.0, rel=0.01)
        assert length.std() == pytest.approx(0.4e-6 * 10.0 * 1200.0, rel=0.1)

    def test_the_thermometer_is_off_by_the_same_for_a_whole_run(self) -> None:
        artefact = bar()
        plan = planned_for(artefact).observations
        assumptions = perfect(thermometer_uncertainty_k=0.2, artefact_temperature_c=22.0)
        truth, source = TrueMachine(None, np.zeros(0), TOOL, None), rng(5)
        shown = []
        for _ in range(500):
            seen = simulated_observations(plan, artefact, truth, assumptions, source)
            assert np.ptp(seen.temperature_c) == 0.0
            shown.append(seen.temperature_c[0])
        assert np.mean(shown) == pytest.approx(22.0, abs=0.03)
        assert np.std(shown) == pytest.approx(0.2, rel=0.15)

    def test_switching_one_off_leaves_the_others_as_they_are(self) -> None:
        artefact = bar()
        plan = planned_for(artefact).observations
        full = quiet(touch_noise=True, certificate=True, cte=True, drift_mm=1e-3, thermometer_uncertainty_k=0.1)
        truth = draw_truth(full, rng(), TOOL)

        def found(assumptions: TruthAssumptions) -> np.ndarray:
            return simulated_observations(plan, artefact, truth, assumptions, rng(7)).axis_positions

        touches = found(full) - found(replace(full, touch_noise=False))
        alone = replace(full, certificate=False, cte=False, drift_mm=0.0)
        assert np.abs(touches - (found(alone) - found(replace(alone, touch_noise=False)))).max() < 1e-10
        assert np.abs(touches).max() > 1e-4


class TestWhatIsLeft:
    """Quadratic forms against the exact machine of order 7 with deflection, point by point on a grid."""

    @pytest.mark.parametrize("chain", CHAINS)
    def test_it_is_the_exact_field_less_the_compensation_to_nanometres(self, chain: str) -> None:
        assumptions = quiet(7, chain, deflection=deflection())
        own = model(5, chain)
        grid = evaluation_grid(RANGES, (9, 6, 7))
        form = FieldForm.build(own, assumptions, grid, TOOL)
        source = rng(11)
        truths = [draw_truth(assumptions, source, TOOL) for _ in range(5)]
        estimates = family_from_amplitudes(own, AMPLITUDES).draw(source, 5)
        left = compensated_errors(form, np.array([truth.parameters for truth in truths]), estimates)
        before = uncompensated_errors(form, np.array([truth.parameters for truth in truths]))
        for number, (truth, estimate) in enumerate(zip(truths, estimates, strict=True)):
            bare = truth.deviation(grid)
            field = bare - exact_deviation(own, grid, TOOL, estimate)
            for quick, exact in ((before, bare), (left, field)):
                straight = align_rigidly(grid + TOOL, exact)
                assert quick[0][number] == pytest.approx(math.sqrt((exact**2).sum() / len(grid)), abs=5e-6)
                assert quick[1][number] == pytest.approx(math.sqrt((straight**2).sum() / len(grid)), abs=5e-6)

    def test_an_identified_machine_is_better_than_it_was(self) -> None:
        artefact = bar()
        plan = planned_for(artefact).observations
        assumptions = quiet(7, touch_noise=True, certificate=True, deflection=deflection())
        family = family_from_amplitudes(model(5), AMPLITUDES)
        form = FieldForm.build(family.model, assumptions, evaluation_grid(RANGES, (9, 6, 7)), TOOL)
        source = rng(13)
        truth = draw_truth(assumptions, source, TOOL)
        seen = simulated_observations(plan, artefact, truth, assumptions, source)
        left = true_vce(identify(family.model, seen, artefact, family, Options()), truth, form)
        assert left.aligned_mm < 0.7 * uncompensated_errors(form, truth.parameters[None, :])[1][0]

    def test_machines_of_other_ranges_are_refused(self) -> None:
        narrow = ErrorModel.uniform(parse_chain(CHAINS[0]), ((0.0, 3000.0), *RANGES[1:]), 5)
        with pytest.raises(ModelError, match="differ in kinematic chain or axis ranges"):
            FieldForm.build(narrow, quiet(), evaluation_grid(RANGES, (3, 3, 3)), TOOL)
