"""Published studies against brute force on the grid and plain arithmetic, including unidentifiable cases."""

from __future__ import annotations

import csv
import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from study_case import shipped_job, study_case

from agent.planning.case_file import load_case, shipped_case
from agent.planning.cycle_time import machine_minutes
from agent.planning.design.bar_variants import Bar
from agent.settings.schema import RELOCATION_BY_HAND_MINUTES
from agent.studies import ball_count, misalignment, strategy, trajectory, volumetric_error
from agent.studies.identification_variants import PUBLISHED, UNWEIGHTED, identification_variants
from agent.studies.measure import ALIGNED, share_of_gain
from agent.studies.monte_carlo import SimulatedMachine
from agent.studies.procedure_value import ProcedureEvaluator, ProcedureVariant, Verdict
from agent.studies.study import StudyCase
from agent.studies.study_files import document, format_rows, write_result
from agent.studies.verdict_table import worst_deviation
from agent.studies.workers import generator
from twin.arrays import Array
from twin.artefact.artefact import Artefact, ball_bar
from twin.artefact.ball_spacing import BallSpacing, spaced_balls, stated_places
from twin.artefact.position_set import parse_position_set
from twin.errors import DataError
from twin.identification import Options
from twin.machine.deflection import CASE_STUDY_NODES, CantileverStructure, DeflectionGrid, cantilever_deflection
from twin.machine.forward_model import exact_deviation
from twin.machine.volumetric import VolumetricRms, evaluation_grid
from twin.uncertainty.monte_carlo import draw_truth
from twin.uncertainty.residual_field_form import FieldForm

NANOMETRE_UM = 1e-3
case = partial(study_case, seed=7)


def true_field(made: StudyCase, parameters: Array, points: Array) -> Array:
    """Return the exact deviation (n, 3) in mm of a machine with deflection."""
    deflection = made.assumptions.deflection
    assert deflection is not None
    return exact_deviation(made.machine.model, points, made.tool_offset, parameters) + deflection.at(points)


def less_rigid(made: StudyCase, field_at_grid: Array, grid: Array, field: Array, points: Array) -> Array:
    """Return `field` without the rigid motion of `field_at_grid`: three shifts and three rotations by least squares."""

    def motions(places: Array) -> Array:
        columns = [np.tile(np.eye(3)[axis], (len(places), 1)) for axis in range(3)]
        columns += [np.cross(np.eye(3)[axis], (places + made.tool_offset) / 1000.0) for axis in range(3)]
        return np.stack(columns, axis=-1)

    found = np.linalg.lstsq(motions(grid).reshape(-1, 6), field_at_grid.reshape(-1), rcond=None)[0]
    return np.asarray(field - motions(points) @ found)


def set_up(made: StudyCase, field_at: Callable[[Array], Array], points: Array) -> Array:
    """Return the field at `points` for a workpiece zeroed in the middle of the travel and aligned to X and Y."""
    ranges = np.array(made.machine.model.ranges_mm)
    middle = ranges.mean(axis=1)

    def slope(axis: int) -> Array:
        line = np.tile(middle, (65, 1))
        line[:, axis] = np.linspace(ranges[axis, 0], ranges[axis, 1], 65)
        return np.asarray(np.polyfit(line[:, axis], field_at(line), 1)[0])

    along_x, along_y = slope(0), slope(1)
    rotation = np.array([along_y[2], -along_x[2], along_x[1]])
    return np.asarray(field_at(points) - field_at(middle[None, :]) - np.cross(rotation, points - middle))


def rms_um(field: Array) -> float:
    return 1e3 * math.sqrt(float(np.mean(np.sum(field**2, axis=1))))


def verdict(aligned_um: float | None) -> Verdict:
    if aligned_um is None:
        return Verdict(None)
    return Verdict(VolumetricRms(2e-3 * aligned_um, 1e-3 * aligned_um), in_work_frame_mm=1.5e-3 * aligned_um)


class TestVolumetricError:
    def test_each_machine_has_the_error_of_the_exact_model_on_the_grid(self) -> None:
        made = case()
        grid = evaluation_grid(made.machine.model.ranges_mm)
        form = ProcedureEvaluator(made).work_frame
        found = volumetric_error.draw_family(made.machine.family, form, 3, generator(made.seed, 0))
        for number, parameters in enumerate(found.parameters):
            field = true_field(made, parameters, grid)
            assert found.raw_um[number] == pytest.approx(rms_um(field), abs=5 * NANOMETRE_UM)
            aligned = rms_um(less_rigid(made, field, grid, field, grid))
            assert found.aligned_um[number] == pytest.approx(aligned, abs=5 * NANOMETRE_UM)
            in_frame = rms_um(set_up(made, partial(true_field, made, parameters), grid))
            assert found.work_frame_um[number] == pytest.approx(in_frame, abs=5 * NANOMETRE_UM)

    def test_the_maps_show_the_exact_deviation_at_800_mm(self) -> None:
        made = case()
        grid = evaluation_grid(made.machine.model.ranges_mm)
        parameters = made.machine.family.draw(generator(1), 1)[0]
        field = FieldForm.build(made.machine.model, made.assumptions, grid, made.tool_offset)
        raw, aligned = volumetric_error.median_planes(field, parameters)
        for row, column in ((0, 0), (17, 5), (80, 26)):
            point = np.array([[raw.x_mm[row], raw.y_mm[column], 800.0]])
            there = true_field(made, parameters, point)
            assert raw.length_um[row, column] == pytest.approx(rms_um(there), abs=5 * NANOMETRE_UM)
            left = less_rigid(made, true_field(made, parameters, grid), grid, there, point)
            assert aligned.length_um[row, column] == pytest.approx(rms_um(left), abs=5 * NANOMETRE_UM)

    def test_the_family_has_the_published_median(self) -> None:
        said = document(volumetric_error.run(case(machines=4000)))
        assert said["median_ve_raw_um"] == pytest.approx(volumetric_error.PUBLISHED_MEDIAN_UM, abs=0.2)
        assert said["ve_raw_p05_um"] == pytest.approx(9.1, abs=0.3)
        assert said["ve_raw_p95_um"] == pytest.approx(15.6, abs=0.4)

    def test_the_figure_shows_maps_and_distribution(self, tmp_path: Path) -> None:
        files = write_result(volumetric_error.run(case(machines=60)), tmp_path)
        percents = [float(row["percent_of_machines"]) for row in csv.DictReader(files["csv"].read_text().splitlines())]
        assert (percents[0], percents[-1]) == (0.0, 100.0)
        assert "published median 11.9" in files["svg"].read_text()


class TestBar:
    def test_the_bar_as_drawn_is_near_the_certified_one(self) -> None:
        certified = shipped_job().artefact
        bar = Bar.of(certified)
        assert bar.tilt_deg == pytest.approx(15.0, abs=0.1)
        assert np.abs(bar.with_().balls - certified.balls).max() < 0.1
        assert bar.standard_uncertainty_mm == pytest.approx(0.8e-3)

    @pytest.mark.parametrize("case_name", ["bridge", "mill", "router"])
    def test_holders_may_point_to_a_vertical_spindle(self, case_name: str) -> None:
        certified = load_case(shipped_case(case_name).settings).artefact
        bar = Bar.of(certified)
        assert bar.tilt_deg == pytest.approx(15.0, abs=0.2)
        assert np.abs(bar.with_().balls - certified.balls).max() < 0.2
        straight = bar.with_(balls=5, tilt_deg=0.0).balls
        assert straight[:, 2] == pytest.approx(certified.holder_length_mm)

    @pytest.mark.parametrize("balls", [3, 7, 15])
    def test_the_length_does_not_depend_on_the_number_of_balls(self, balls: int) -> None:
        made = Bar.of(shipped_job().artefact).with_(balls=balls)
        assert made.count == balls
        assert np.ptp(made.balls[:, 0]) == pytest.approx(1500.0, abs=0.1)
        assert np.sqrt(np.diagonal(made.covariance)) == pytest.approx(0.8e-3)
        assert made.cte_standard_uncertainty_per_k == shipped_job().artefact.cte_standard_uncertainty_per_k

    @pytest.mark.parametrize("spacing", BallSpacing)
    def test_the_rule_of_the_spacing_is_found_and_holds_for_another_number(self, spacing: BallSpacing) -> None:
        even = Bar.of(shipped_job().artefact)
        made = even.with_(along_mm=spaced_balls(6, 1800.0, spacing))
        displaced = replace(made, balls=made.balls + 0.4 * np.sin(np.arange(18.0)).reshape(6, 3))
        bar = Bar.of(displaced)
        assert bar.spacing is spacing
        assert bar.tilt_deg == pytest.approx(15.0, abs=0.5)
        assert bar.with_().balls == pytest.approx(made.balls, abs=0.6)
        assert bar.with_(balls=9).balls[:, 0] == pytest.approx(spaced_balls(9, bar.length_mm, spacing))

    def test_a_bar_without_a_rule_keeps_its_places_and_has_no_other_number_of_balls(self) -> None:
        along_mm = stated_places((0.0, 140.0, 310.0, 1000.0, 1234.5))
        bar = Bar.of(Bar.of(shipped_job().artefact).with_(along_mm=along_mm))
        assert bar.spacing is None
        assert bar.with_(tilt_deg=30.0).balls[:, 0] == pytest.approx(along_mm)
        with pytest.raises(
            DataError, match="by no rule that is known, so a bar like it with 4 balls is not determined"
        ):
            bar.with_(balls=4)

    def test_a_bar_with_the_origin_elsewhere_is_refused(self) -> None:
        certified = shipped_job().artefact
        with pytest.raises(DataError, match=r"deviate by up to 20\.\d mm"):
            Bar.of(replace(certified, balls=certified.balls + np.array([20.0, 0.0, 0.0])))

    def test_tilted_holders_set_the_balls_off_by_their_sine(self) -> None:
        bar = Bar.of(shipped_job().artefact)
        straight, tilted = bar.with_(tilt_deg=0.0).balls, bar.with_(tilt_deg=30.0).balls
        assert np.ptp(straight[:, 1:], axis=0) == pytest.approx([0.0, 0.0])
        assert np.linalg.norm((tilted - straight)[:, 1:], axis=1) == pytest.approx(60.0 * 0.5)

    def test_another_artefact_is_refused_with_a_hint(self) -> None:
        plate = replace(shipped_job().artefact, balls=shipped_job().artefact.balls[:, [1, 0, 2]])
        with pytest.raises(DataError, match="not a bar of balls on tilted holders") as caught:
            Bar.of(plate)
        assert "ball-bar-1500" in (caught.value.hint or "")


class TestWays:
    def test_the_way_asked_for_stands_before_the_published_one(self) -> None:
        assert [variant.label for variant in identification_variants(Options())] == [
            "centres, full weights, prior",
            "published, cut-off 0.01",
            "distances, unit weights, prior",
            "distances, unit weights, no prior",
        ]

    def test_none_stands_twice(self) -> None:
        assert [variant.label for variant in identification_variants(UNWEIGHTED)] == [
            "distances, unit weights, no prior",
            "published, cut-off 0.01",
            "distances, unit weights, prior",
        ]

    def test_all_are_those_of_the_closed_form(self) -> None:
        assert all(
            not variant.options.estimate_scales and variant.options.outliers == "none"
            for variant in identification_variants(Options())
        )


class TestWorth:
    def test_the_simulated_error_is_that_of_the_exact_machines_on_the_grid(self) -> None:
        made = case(machines=2)
        trial = ProcedureVariant.of(made, Bar.of(made.artefact).with_(balls=5), made.positions("S3"))
        evaluator, variants = ProcedureEvaluator(made), identification_variants(made.options)[:1]
        ((found,),) = evaluator.evaluate([trial], variants, [0])
        grid, squares = evaluation_grid(made.machine.model.ranges_mm), []
        for number in range(2):
            truth = draw_truth(made.assumptions, generator(made.seed, number), made.tool_offset)
            identified = evaluator.procedure(trial, variants[0])(number)
            assert isinstance(identified, SimulatedMachine)
            left = truth.deviation(grid) - exact_deviation(
                made.machine.model, grid, made.tool_offset, identified.estimate
            )
            squares.append(rms_um(left) ** 2)
        assert found.simulated is not None
        assert found.simulated.raw_um == pytest.approx(math.sqrt(np.mean(squares)), abs=5 * NANOMETRE_UM)

    def test_closed_form_and_simulation_agree(self) -> None:
        made = case(machines=160)
        bar = Bar.of(made.artefact)
        trials = [ProcedureVariant.of(made, bar.with_(balls=balls), made.positions("S3")) for balls in (5, 6)]
        rows = ProcedureEvaluator(made).evaluate(trials, identification_variants(made.options)[:3], [0, 1])
        deviation = worst_deviation(rows)
        assert deviation is not None and deviation < 3.5
        for found in (found for row in rows for found in row):
            assert found.expected is not None and found.standard_error is not None
            assert found.standard_error.aligned_mm < 0.08 * found.expected.aligned_mm

    def test_only_what_is_asked_for_is_simulated(self) -> None:
        made = case()
        trials = [ProcedureVariant.of(made, made.artefact, made.positions(name)) for name in ("S1", "S3")]
        (first,), (second,) = ProcedureEvaluator(made).evaluate(trials, identification_variants(made.options)[:1], [1])
        assert first.expected is not None and first.simulated is None
        assert second.simulated is not None

    def test_an_artefact_out_of_reach_identifies_nothing(self) -> None:
        made = case()
        long = ball_bar("long", balls=3, length_mm=9000.0, tilt_rad=0.2, holder_length_mm=60.0, ball_diameter_mm=25.0)
        trial = ProcedureVariant.of(made, long, made.positions("S1"))
        assert trial.planned is None
        ((found,),) = ProcedureEvaluator(made).evaluate([trial], identification_variants(made.options)[:1], [0])
        assert found == Verdict(None)


class TestPublishedMethod:
    """The reading of the published method shows the published behaviour on the case study."""

    def vce(self, made: StudyCase, artefact: Artefact, *sets: str) -> list[float]:
        variant, evaluator = identification_variants(PUBLISHED)[0], ProcedureEvaluator(made)
        trials = [ProcedureVariant.of(made, artefact, made.positions(name)) for name in sets]
        ((*found,),) = zip(*evaluator.evaluate(trials, [variant], []), strict=True)
        return [one.expected.aligned_um for one in found if one.expected is not None]

    def bent_by(self, deflection: DeflectionGrid | None) -> StudyCase:
        return case(
            stations=None, job=replace(shipped_job(), machine=replace(shipped_job().machine, deflection=deflection))
        )

    def test_s3_stands_at_the_bend(self) -> None:
        made = self.bent_by(cantilever_deflection(*CASE_STUDY_NODES, CantileverStructure(column_rail_wave_mm=0.0)))
        sets = ("S1", "S2", "S1+S2", "S3", "S1+S3", "S2+S3", "S1+S2+S3")
        found = dict(zip(sets, self.vce(made, made.artefact, *sets), strict=True))
        assert found["S1"] > found["S2"] > found["S1+S2"] > found["S3"] > found["S1+S3"]
        assert found["S1"] - found["S3"] > 4.0 * (found["S3"] - found["S1+S2+S3"])

    def test_balls_beyond_seven_add_nothing(self) -> None:
        made = self.bent_by(None)
        bar, before = Bar.of(made.artefact), ALIGNED.um(ProcedureEvaluator(made).before) or 0.0
        found = {balls: self.vce(made, bar.with_(balls=balls), "S3")[0] for balls in (3, 7, 11, 15)}
        assert before - found[3] < 0.8 * (before - min(found.values()))
        assert before - found[7] > ball_count.SUFFICIENT_SHARE * (before - min(found.values()))

    def test_tilt_helps_s2_and_hardly_s2_with_s3(self) -> None:
        made = case(stations=None)
        straight, tilted = (Bar.of(made.artefact).with_(tilt_deg=tilt) for tilt in (0.0, 30.0))
        (alone, both), (alone_tilted, both_tilted) = (self.vce(made, one, "S2", "S2+S3") for one in (straight, tilted))
        assert alone_tilted < 0.65 * alone
        assert both_tilted == pytest.approx(both, rel=0.03)

    def test_it_is_measured_without_errors_of_touches_and_artefact(self) -> None:
        made = case()
        variant, rough = identification_variants(PUBLISHED)[0], 25.0 * Bar.of(made.artefact).certified.covariance
        trial = ProcedureVariant.of(made, replace(made.artefact, covariance=rough), made.positions("S3"))
        budget = ProcedureEvaluator(made).budget(trial, variant)
        assert budget is not None
        parts = {name: part.raw_um for name, part in budget.contributions.items() if part.raw_um > 0.0}
        assert set(parts) == {"misfit", "unseen"}


class TestBallCount:
    def test_the_share_of_the_gain_is_that_of_the_best_count(self) -> None:
        shares = share_of_gain((8.0, None, 5.0, 4.0), 10.0)
        assert shares[1] is None
        assert [shares[n] for n in (0, 2, 3)] == pytest.approx([2.0 / 6.0, 5.0 / 6.0, 1.0])

    def test_no_gain_has_no_share(self) -> None:
        assert share_of_gain((30.0, 11.0), 10.0) == (None, None)

    def test_seven_balls_are_enough_as_published_and_six_are_at_the_limit(self) -> None:
        made = case(stations=None)
        bar, variant = Bar.of(made.artefact), identification_variants(made.options)[0]
        trials = [ProcedureVariant.of(made, bar.with_(balls=balls), made.positions()) for balls in ball_count.COUNTS]
        evaluator = ProcedureEvaluator(made)
        verdicts = tuple(row[0] for row in evaluator.evaluate(trials, [variant], []))
        curve = ball_count.Curve(variant, evaluator.before, verdicts)
        shares = dict(zip(ball_count.COUNTS, curve.shares(ALIGNED), strict=True))
        assert curve.fewest(ALIGNED) in (6, ball_count.PUBLISHED_BALLS)
        assert shares[6] == pytest.approx(ball_count.SUFFICIENT_SHARE, abs=0.006)
        assert shares[ball_count.PUBLISHED_BALLS] == pytest.approx(0.964, abs=0.006)

    def test_the_study_has_a_row_for_each_count_and_way(self, tmp_path: Path) -> None:
        result = ball_count.run(case(position_set="S3"))
        assert len(result.rows) == 4 * len(ball_count.COUNTS)
        assert set(document(result)["vce_work_frame_um"]) == set(document(result)["vce_raw_um"])  # type: ignore[call-overload]
        assert "share of the largest gain" in write_result(result, tmp_path)["svg"].read_text()


class TestMisalignment:
    def test_tilt_helps_s2_and_hardly_s2_with_s3(self) -> None:
        made = case(stations=None)
        bar, variant = Bar.of(made.artefact), identification_variants(made.options)[:1]
        saved = {}
        for name in misalignment.SETS:
            trials = [ProcedureVariant.of(made, bar.with_(tilt_deg=tilt), made.positions(name)) for tilt in (0.0, 30.0)]
            saved[name] = misalignment.saving(ProcedureEvaluator(made).evaluate(trials, variant, []), 0)
        assert saved["S2"] == pytest.approx(0.25, abs=0.05)
        assert saved["S2+S3"] == pytest.approx(0.0, abs=0.02)

    def test_the_study_names_what_is_not_identified(self) -> None:
        beside = case(stations=None).job
        away_mm = np.array([9000.0, 0.0, 0.0])
        far = replace(
            beside.layout, locations_mm={n: place + away_mm for n, place in beside.layout.locations_mm.items()}
        )
        result = misalignment.run(case(job=replace(beside, layout=far)))
        unknown = document(result)["not_identified"]
        assert len(unknown["centres, full weights, prior"]) == 2 * len(misalignment.TILTS_DEG)  # type: ignore[index]
        assert all(row[result.columns.index("vce_raw_um")] is None for row in result.rows)

    def test_what_is_not_identified_saves_nothing(self) -> None:
        assert misalignment.saving([(verdict(None),), (verdict(4.0),)], 0) is None
        assert misalignment.saving([(verdict(8.0),), (verdict(6.0),)], 0) == pytest.approx(0.25)


def strategies(points: list[tuple[float, float | None]]) -> list[strategy.Strategy]:
    nothing = ProcedureVariant(shipped_job().artefact, None)
    return [
        strategy.Strategy(str(n), nothing, minutes, 0, 3.0, 1, (verdict(value),))
        for n, (minutes, value) in enumerate(points)
    ]


class TestStrategy:
    @given(st.lists(st.tuples(st.integers(1, 9), st.one_of(st.none(), st.integers(1, 9))), max_size=9))
    def test_the_front_is_what_none_beats(self, points: list[tuple[float, float | None]]) -> None:
        names = strategy.pareto_front(strategies(points), 0)
        for number, (minutes, value) in enumerate(points):
            beaten = value is None or any(
                other is not None and m <= minutes and other <= value and (m < minutes or other < value)
                for m, other in points
            )
            equals = [n for n, point in enumerate(points) if point == (minutes, value)]
            if beaten:
                assert str(number) not in names
            else:
                assert sum(str(n) in names for n in equals) == 1

    def test_machine_time_is_that_of_the_time_model(self) -> None:
        made = case(stations=1)
        result = strategy.run(made)
        minutes = {row[0]: row[3] for row in result.rows}
        assert minutes["S1+S3"] == pytest.approx(machine_minutes(made.job, parse_position_set("S1+S3", 1)).total)
        assert set(minutes) == {"S1", "S2", "S3", "S1+S2", "S1+S3", "S2+S3", "S1+S2+S3"}

    def test_carrying_takes_its_time_at_every_further_station(self) -> None:
        made = case(stations=3, job=shipped_job(3))
        timing = made.job.settings.timing.model_copy(update={"relocation_minutes": 7.0})
        job = replace(made.job, settings=made.job.settings.model_copy(update={"timing": timing}))
        minutes, carries = strategy.set_time(made.job, parse_position_set("S1", 3))
        assert carries == 3  # nobody has said that the artefact stands at the first station
        assert minutes + 3 * 7.0 == pytest.approx(machine_minutes(job, parse_position_set("S1", 3)).total)

    def test_an_operator_without_a_time_is_taken_for_a_person(self) -> None:
        assert case().job.settings.timing.relocation_minutes == 0.0
        assert case().relocation_minutes == RELOCATION_BY_HAND_MINUTES

    def test_the_time_of_carrying_decides_between_more_sets_and_more_stations(self) -> None:
        made = case(stations=3, job=shipped_job(3))
        result = strategy.run(made)
        fronts: dict[str, list[str]] = document(result)["pareto_front_over_stations"]  # type: ignore[assignment]
        assert set(fronts) == set(strategy.CARRYING)
        assert {row[1] for row in result.rows} == {2, 3}
        few = {what: sum(name.endswith("at 2") for name in front) for what, front in fronts.items()}
        assert few["by crane"] >= few["none"]

    @pytest.mark.parametrize(("count", "stations"), [(1, (1,)), (2, (1, 4)), (3, (1, 3, 4)), (4, (1, 2, 3, 4))])
    def test_fewer_stations_are_spread(self, count: int, stations: tuple[int, ...]) -> None:
        assert strategy.spread((1, 2, 3, 4), count) == stations

    def test_sets_that_identify_nothing_leave_a_gap(self, tmp_path: Path) -> None:
        result = strategy.run(case(stations=1, options=Options(use_prior=False)))
        variant = "centres, full weights, no prior"
        unknown = document(result)["not_identified"][variant]  # type: ignore[index]
        assert "S1" in unknown
        rows = list(csv.DictReader(format_rows(result).splitlines()))
        for row in rows:
            if row["identification"] == variant:
                assert (row["vce_raw_um"] == "") == (row["sets"] in unknown)
        assert write_result(result, tmp_path)["png"].stat().st_size > 0


class TestTrajectory:
    def test_the_machine_is_the_exact_one_less_its_rigid_motion(self) -> None:
        made = case()
        line = trajectory.middle_line(made.machine.model.ranges_mm)
        identified = trajectory.IdentifiedModels.of(made, identification_variants(made.options)[0])
        followed = identified.along(line, aligned=True)
        grid = evaluation_grid(made.machine.model.ranges_mm)
        truth = draw_truth(made.assumptions, generator(made.seed, 0), made.tool_offset)
        wanted = less_rigid(made, truth.deviation(grid), grid, truth.deviation(line), line)
        assert np.abs(followed.machine_um - 1e3 * wanted).max() < 5 * NANOMETRE_UM
        lengths = [math.dist(*pair) ** 2 for pair in zip(followed.machine_um, followed.models_um[5], strict=True)]
        assert followed.residual_um(5) == pytest.approx(math.sqrt(sum(lengths) / len(lengths)))

    def test_more_balls_are_expected_to_follow_better(self) -> None:
        expected = document(trajectory.run(case(stations=None)))["rms_left_expected_um"]
        assert expected["3"] > expected["5"] > expected["11"]  # type: ignore[index]

    def test_what_is_not_identified_has_no_curve(self, tmp_path: Path) -> None:
        made = case(stations=1, options=Options(use_prior=False), position_set="S1")
        result = trajectory.run(made)
        assert document(result)["not_identified"] == [3, 5, 11]
        row = next(csv.DictReader(format_rows(result).splitlines()))
        assert row["machine_X_um"] != "" and row["11_balls_X_um"] == ""
        assert "machine M" in write_result(result, tmp_path)["svg"].read_text()


def test_an_artefact_that_is_no_bar_is_told_before_any_work() -> None:
    square = np.array([[0.0, 0.0, 0.0], [300.0, 0.0, 0.0], [0.0, 300.0, 0.0]])
    plate = Artefact(
        name="plate",
        certificate="drawing",
        balls=square,
        ball_diameter_mm=25.0,
        reference_temperature_c=20.0,
        cte_per_k=11.5e-6,
        cte_standard_uncertainty_per_k=0.0,
        covariance=np.zeros((9, 9)),
    )
    with pytest.raises(DataError, match="'plate' is not a bar"):
        ball_count.run(case(job=replace(shipped_job(2), artefact=plate)))
