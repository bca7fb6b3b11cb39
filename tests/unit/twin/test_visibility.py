"""Identifiability of a set-up, against machines that are really identified and a Jacobian of plain 4x4 matrices."""

from __future__ import annotations

import dataclasses
from functools import cache
from typing import Any

import numpy as np
import plain_machine
import pytest
from measured_set import RANGES, TOOL, bar, case_study

from twin.artefact.mount_geometry import MountGeometry
from twin.artefact.position_set import Position, parse_position_set, station_locations
from twin.collision.measuring_layout import MeasuringLayout
from twin.collision.probe_geometry import ProbeGeometry
from twin.design.identifiability import EvaluatedTool, Identifiability, assess_identifiability
from twin.design.measurement_setup import AS_STATED, SetUp, layout_for
from twin.design.procedure import Procedure
from twin.design.setup_advice import describe_gain, describe_trial
from twin.design.setup_trials import TrialGain, evaluated_tools, other_tools, trial_gains
from twin.identification import Estimate, identify
from twin.identification.observability import field_observability
from twin.machine.deviation_basis import linear_deviation
from twin.machine.error_model import ErrorModel
from twin.machine.forward_model import exact_deviation
from twin.machine.volumetric import QuadraticForm, align_rigidly, evaluation_grid, rms

CHAIN = "tool-Y-Z-X-bed-workpiece"
LONGER, LATERAL = np.array([0.0, 450.0, 0.0]), np.array([0.0, 250.0, -300.0])
GRID = evaluation_grid(RANGES, (9, 6, 7))
BAR = bar(balls=7, sigma_mm=0.8e-3)


def layout(tool: np.ndarray = TOOL) -> MeasuringLayout:
    lower, upper = np.array(RANGES).T
    places = station_locations(3, RANGES[0], 765.0, 1000.0, 750.0)
    plain = MeasuringLayout(
        artefact=BAR,
        mount=MountGeometry(),
        probe=ProbeGeometry(),
        locations_mm=dict(enumerate(places, start=1)),
        tool_offset_mm=TOOL,
        lower_mm=lower + 5.0,
        upper_mm=upper - 5.0,
        contact_mm=15.5,
        approach_mm=8.0,
    )
    return layout_for(plain, tool, 1)


def set_up(expression: str = "S3", order: int = 4, sigma_mm: float = 1e-3, **options: Any) -> SetUp:
    model, family = case_study(order)
    procedure = Procedure({"probe": layout()}, np.eye(3) * sigma_mm**2)
    return SetUp(model, family, procedure, parse_position_set(expression, 3), dataclasses.replace(AS_STATED, **options))


def seen_by(one: SetUp, tools: tuple[np.ndarray, ...] = (TOOL, LONGER, LATERAL)) -> Identifiability:
    views = [EvaluatedTool(str(k), QuadraticForm.build(one.model, GRID, tool), k == 0) for k, tool in enumerate(tools)]
    return assess_identifiability(one.estimate(), views)


class TestRank:
    @staticmethod
    def plain_rank(model: ErrorModel, scale: np.ndarray, tools: list[np.ndarray]) -> int:
        """Return the rank of the field at scattered points without rigid motions, by differences of the plain loop."""
        low, high = np.array(RANGES).T
        points = np.random.default_rng(3).uniform(low, high, (28, 3))
        reached = np.concatenate([points + tool for tool in tools])
        columns = []
        for name, size in zip(model.names, 1e-2 * scale, strict=True):
            change = [plain_machine.deviations(CHAIN, RANGES, points.tolist(), tool, {name: size}) for tool in tools]
            columns.append(align_rigidly(reached, np.concatenate(change)).reshape(-1) / 1e-2)
        return int(np.linalg.matrix_rank(np.stack(columns, axis=1), tol=1e-7))

    @pytest.mark.parametrize(
        ("tools", "rank"),
        # the last remaining one: b0 is a scale error of Y with any tool
        [([TOOL], 56), ([TOOL, LONGER], 65), ([TOOL, LONGER, LATERAL], 73)],
        ids=["straight", "and longer", "and lateral"],
    )
    def test_of_the_field_by_the_plain_loop(self, tools: list[np.ndarray], rank: int) -> None:
        model, family = case_study(4, ("b0", "b1", "b2", "c0", "c1"))
        scale = family.prior_standard_deviation
        assert model.size == 74
        assert self.plain_rank(model, scale, tools) == rank
        assert field_observability(model, scale, np.array(tools), aligned=True).rank == rank


class TestUnseenField:
    @pytest.mark.parametrize("formulation", ["centres", "distances"])
    def test_is_what_an_identified_machine_keeps(self, formulation: str) -> None:
        """Each parameter in turn is off by its prior standard deviation, measured without noise and identified.

        The parts that the estimate does not follow add up in squares, since the parameters of a random machine are
        independent.
        """
        one = set_up("S1+S3", order=2, formulation=formulation)
        total = np.zeros(3)
        for name, size in zip(one.model.names, one.family.prior_standard_deviation, strict=True):
            truth = np.zeros(one.model.size)
            truth[one.model.index(name)] = size
            found = identified(one, truth)
            for k, tool in enumerate((TOOL, LONGER, LATERAL)):
                left = linear_deviation(one.model, GRID, tool, truth - found.parameters)
                total[k] += rms(align_rigidly(GRID + tool, left)) ** 2
        wanted = [field.unseen_mm for field in seen_by(one).fields]
        np.testing.assert_allclose(np.sqrt(total), wanted, rtol=2e-3)

    def test_tends_to_the_blind_field_as_noise_tends_to_nothing(self) -> None:
        perfect = dataclasses.replace(BAR, covariance=0.0 * BAR.covariance)
        one = set_up("S1", misfit_mm=0.0)
        one = dataclasses.replace(one, procedure=one.procedure.with_artefact(perfect))
        unseen = []
        for sigma_mm in (1e-3, 1e-4, 1e-5, 1e-6):
            quieter = dataclasses.replace(one.procedure, covariance_mm2=np.eye(3) * sigma_mm**2)
            seen = seen_by(dataclasses.replace(one, procedure=quieter))
            unseen.append([field.unseen_mm for field in seen.fields])
            blind = [field.blind_mm for field in seen.fields]
        assert (np.diff(unseen, axis=0) < 0.0).all()
        assert unseen[0][0] > 1.05 * blind[0] > 1e-5
        np.testing.assert_allclose(unseen[-1], blind, rtol=1e-2)

    def test_blind_at_another_tool_is_what_turns_about_the_tool_do_there(self) -> None:
        """Compare with the rms, over random machines, of the errors that one straight probe cannot determine.

        At a lateral stylus these are EBY and EBZ; with either tool, also the errors that the straight one cannot
        separate.
        """
        one = set_up("S3")
        at_own, at_longer, at_lateral = seen_by(one).fields
        assert at_own.blind_mm < 1e-7
        assert at_longer.blind_mm > 1e-4
        scale = one.family.prior_standard_deviation
        alone = np.zeros(one.model.size)
        for error in ("EBY", "EBZ"):
            alone[one.model.block[error]] = scale[one.model.block[error]]
        draws = np.random.default_rng(1).standard_normal((400, one.model.size)) * alone
        raw, aligned = QuadraticForm.build(one.model, GRID, LATERAL).values(draws)
        assert raw.max() > aligned.max()
        assert at_lateral.blind_mm > 0.9 * np.sqrt(np.mean(aligned**2)) > 1e-4

    def test_prior_is_the_family_without_a_table(self) -> None:
        one = set_up("S3")
        draws = np.random.default_rng(2).standard_normal((4000, one.model.size)) * one.family.prior_standard_deviation
        _, aligned = QuadraticForm.build(one.model, GRID, LONGER).values(draws)
        assert seen_by(one).fields[1].prior_mm == pytest.approx(np.sqrt(np.mean(aligned**2)), rel=0.02)

    def test_a_parameter_that_the_family_excludes_is_no_part_of_it(self) -> None:
        one = set_up("S3")
        widths = one.family.half_widths.copy()
        widths[one.model.block["EBY"]] = 0.0
        without = seen_by(dataclasses.replace(one, family=dataclasses.replace(one.family, half_widths=widths)))
        assert without.rank == seen_by(one).rank
        assert without.fields[2].blind_mm < seen_by(one).fields[2].blind_mm
        assert np.isfinite([field.unseen_mm for field in without.fields]).all()


@cache
def advice() -> tuple[SetUp, Identifiability, tuple[TrialGain, ...]]:
    one = set_up("S3", order=3)
    views = evaluated_tools(one, GRID)
    before = assess_identifiability(one.estimate(), views)
    return one, before, trial_gains(one, before, views)


class TestAdvice:
    def test_looks_from_the_tools_of_the_set_up_a_longer_one_and_two_sideways(self) -> None:
        _, before, _ = advice()
        offsets = {field.tool: field.tool_offset.tolist() for field in before.fields}
        assert offsets == {
            "probe": [0.0, 250.0, 0.0],
            "200 mm longer": [0.0, 450.0, 0.0],
            "lateral +100 mm X": [100.0, 250.0, 0.0],
            "lateral +100 mm Z": [0.0, 250.0, 100.0],
        }
        assert [field.measured for field in before.fields] == [True, False, False, False]

    def test_tries_everything_that_can_be(self) -> None:
        one, _, found = advice()
        names = {gain.trial.tool.name for gain in found if gain.trial.tool}
        # 200 mm shorter leaves 50 mm, less than stem and body of the probe need
        assert names == {"200 mm longer", "100 mm longer", "100 mm shorter", *lateral_names()}
        assert {gain.trial.added for gain in found if not gain.trial.tool} == {"S1", "S2", ""}
        assert not {tool.name for tool in other_tools(one)} - names

    def test_best_first_and_each_as_if_it_were_the_set_up(self) -> None:
        one, before, found = advice()
        removed = [gain.unseen_removed_mm for gain in found]
        assert removed == sorted(removed, reverse=True)
        assert min(removed) > 0.0
        longer = next(gain for gain in found if gain.trial.tool and gain.trial.tool.name == "200 mm longer")
        layouts = {"probe": layout(), "second": layout(LONGER)}
        both = [Position(p.station, p.azimuth_deg, p.elevation_deg, tool) for tool in layouts for p in one.positions]
        whole = SetUp(one.model, one.family, Procedure(layouts, one.procedure.covariance_mm2), tuple(both), one.options)
        again = assess_identifiability(whole.estimate(), evaluated_tools(one, GRID))
        assert longer.after.rank == again.rank == before.rank + longer.rank
        assert longer.rank > 0
        for field, other in zip(longer.after.fields, again.fields, strict=True):
            assert field.unseen_mm == pytest.approx(other.unseen_mm, rel=1e-6)

    def test_says_what_to_do_and_what_it_brings(self) -> None:
        _, _, found = advice()
        said = {describe_trial(gain.trial): describe_gain(gain) for gain in found}
        sideways = said["the positions again with a stylus 100 mm aside along -X"]
        assert "EBY" in sideways
        assert "EBZ" in sideways
        assert "no longer hidden" in sideways
        longer = said["the positions again with a probe 200 mm longer"]
        assert "EAY" in longer
        assert "ECY" in longer
        assert "EBY" not in longer
        for same in ("the same positions once more", "the positions of S1 as well"):
            assert said[same].startswith("no parameter more; unseen ")

    def test_a_longer_tool_shows_all_at_another_length_and_not_sideways(self) -> None:
        _, before, found = advice()
        longer = next(gain for gain in found if gain.trial.tool and gain.trial.tool.name == "200 mm longer")
        blind = {field.tool: field.blind_mm for field in longer.after.fields}
        was = {field.tool: field.blind_mm for field in before.fields}
        assert was["200 mm longer"] > 1e-4
        assert blind["200 mm longer"] < 1e-7
        assert 1e-4 < blind["lateral +100 mm X"] < was["lateral +100 mm X"]

    def test_a_tool_that_is_there_is_not_proposed(self) -> None:
        one, _, _ = advice()
        two = one.with_tool("second", np.array([0.0, 350.0, 0.0]))
        assert "100 mm longer" not in {tool.name for tool in other_tools(two)}
        assert [view.measured for view in evaluated_tools(two, GRID)][:2] == [True, True]

    def test_a_tool_along_minus_z_is_lengthened_downwards(self) -> None:
        one, _, _ = advice()
        down = dataclasses.replace(layout(), tool_offset_mm=np.array([0.0, 0.0, -300.0]))
        hanging = dataclasses.replace(one, procedure=Procedure({"down": down}, one.procedure.covariance_mm2))
        tools = {tool.name: tool.offset.tolist() for tool in other_tools(hanging)}
        assert tools["200 mm longer"] == [0.0, 0.0, -500.0]
        assert tools["lateral -100 mm Y"] == [0.0, -100.0, -300.0]


def lateral_names() -> set[str]:
    return {f"lateral {sign}100 mm {axis}" for sign in "+-" for axis in "XZ"}


def identified(one: SetUp, truth: np.ndarray) -> Estimate:
    """Identify from the points at which the machine with errors `truth` (p,) would find the planned balls."""
    planned = one.plan().observations
    at = planned.axis_positions.copy()
    for _ in range(3):
        at = planned.axis_positions - exact_deviation(one.model, at, TOOL, truth)
    return identify(one.model, dataclasses.replace(planned, axis_positions=at), BAR, one.family, one.options)
