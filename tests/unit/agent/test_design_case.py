"""Design on the case study: the criterion is the predicted VCE, and the feasibility check agrees with the preflight."""

from dataclasses import replace
from functools import cache
from itertools import combinations

import numpy as np
import pytest

from agent.errors import PlanRefused
from agent.planning.case_file import CASE_STUDY, load_case
from agent.planning.cycle_time import machine_minutes, set_alone, without_optimisation
from agent.planning.design.design_problem import DesignProblem
from agent.planning.design.design_result import find_design
from agent.planning.design.feasibility import FeasibilityCheck
from agent.planning.design.set_valuation import valuation_of
from agent.planning.design.variants import variants_of
from agent.planning.job import Job, KnownHeldOut
from agent.probing.run_plan import position_key
from agent.runs.kinds.calibrate import preflight_of
from drivers.errors import ConfigurationError, InputError
from twin.artefact.position_set import Position, parse_position_set
from twin.design.candidates import CandidatePositions, build_candidates
from twin.design.goals import PositionCountGoal, TimeSlotGoal
from twin.design.measurement_setup import AS_STATED
from twin.design.search import ExchangeSearch
from twin.design.valuation import valuation
from twin.identification import identify, predicted_vce
from twin.identification.instruments.kinds import LaserSetUp, Readings, laser_line
from twin.identification.instruments.readings import InstrumentReadings
from twin.machine.volumetric import evaluation_grid

COARSE = (9, 5, 5)


@cache
def case() -> Job:
    return load_case(CASE_STUDY)


def candidates(positions: tuple[Position, ...]) -> CandidatePositions:
    job = case()
    grid = evaluation_grid(job.machine.model.ranges_mm, COARSE)
    return build_candidates(job.procedure, positions, job.machine.family, AS_STATED, grid, job.tool_offset_mm)


@cache
def of_s1_and_s3() -> CandidatePositions:
    return candidates(parse_position_set("S1+S3", 4))


def search_among(problem: DesignProblem, offered: CandidatePositions) -> ExchangeSearch:
    return ExchangeSearch(offered, problem.prices(offered))


def predicted(positions: tuple[Position, ...]) -> tuple[float, float]:
    """Return the predicted VCE of a real identification of the planned measurement."""
    job = case()
    seen = job.procedure.plan(positions).observations
    estimate = identify(job.machine.model, seen, job.artefact, job.machine.family, AS_STATED)
    vce = predicted_vce(estimate, evaluation_grid(job.machine.model.ranges_mm, COARSE), job.tool_offset_mm)
    return vce.raw_mm, vce.aligned_mm


def planned_laser() -> InstrumentReadings:
    """Return planned readings along X, as `volcal design --instrument` reads them; their values do not matter."""
    job = case()
    ranges = np.array(job.machine.model.ranges_mm)
    points = np.tile(ranges.mean(axis=1), (12, 1))
    points[:, 0] = np.linspace(ranges[0, 0], ranges[0, 1], 12)
    seen = Readings("laser.csv", np.zeros(12), np.full(12, 0.3e-3), job.tool_offset_mm)
    return laser_line(seen, points, LaserSetUp(0.3))


def test_planned_readings_count_in_criterion_valuation_and_search() -> None:
    """The expected error is that of an identification with balls and readings; before both, it is the prior's."""
    job, plain = case(), of_s1_and_s3()
    problem = DesignProblem({"probe": job}, 45.0, set_alone, instruments=(planned_laser(),))
    grid = evaluation_grid(job.machine.model.ranges_mm, COARSE)
    family, options = job.machine.family, replace(AS_STATED, instruments=problem.instruments)
    offered = build_candidates(job.procedure, plain.positions, family, options, grid, job.tool_offset_mm)
    assert offered.before.aligned_mm == pytest.approx(plain.before.aligned_mm, rel=1e-6)
    chosen = (3, 11, 20)
    positions = tuple(plain.positions[index] for index in chosen)
    seen = job.procedure.plan(positions).observations
    estimate = identify(job.machine.model, seen, job.artefact, family, options)
    expected = predicted_vce(estimate, grid, job.tool_offset_mm).aligned_mm
    assert offered.vce(chosen).aligned_mm == pytest.approx(expected, rel=1e-6)
    valued = valuation(family, job.artefact, seen, options, grid, job.tool_offset_mm)
    assert valued.before.aligned_mm == pytest.approx(plain.before.aligned_mm, rel=1e-6)
    assert valued.after.aligned_mm == pytest.approx(expected, rel=1e-6)
    best = PositionCountGoal(3).select(search_among(problem, offered))
    assert (
        offered.vce(best).aligned_mm
        <= offered.vce(PositionCountGoal(3).select(search_among(problem, plain))).aligned_mm
    )
    assert offered.vce(best).aligned_mm < 0.99 * plain.vce(best).aligned_mm
    assert problem.options.instruments == problem.instruments
    assert problem.with_places(job.layout.locations_mm).instruments == problem.instruments


@pytest.mark.parametrize("chosen", [(0, 9), (3, 4, 11, 20), tuple(range(32))])
def test_the_criterion_is_the_predicted_vce_of_an_identification_of_the_set(chosen: tuple[int, ...]):
    offered = of_s1_and_s3()
    vce = offered.vce(chosen)
    expected = predicted(tuple(offered.positions[index] for index in chosen))
    assert (vce.raw_mm, vce.aligned_mm) == pytest.approx(expected, rel=1e-9)


def test_the_value_carried_along_through_a_search_is_that_of_the_identification():
    problem = DesignProblem({case().settings.tool: case()}, 90.0, set_alone)
    offered = of_s1_and_s3()
    chosen = PositionCountGoal(6).select(search_among(problem, offered))
    raw, aligned = predicted(tuple(offered.positions[index] for index in chosen))
    assert offered.vce(chosen).aligned_mm == pytest.approx(aligned, rel=1e-9)
    assert offered.vce(chosen).raw_mm == pytest.approx(raw, rel=1e-9)


def test_the_search_finds_the_best_pair_of_real_positions():
    offered = candidates(parse_position_set("S1+S3", 4)[:10])
    job = case()
    search = replace(
        search_among(DesignProblem({job.settings.tool: job}, 90.0, set_alone), offered), min_improvement=0.0
    )
    best = min(combinations(range(offered.count), 2), key=lambda pair: offered.vce(pair).aligned_mm)
    assert set(PositionCountGoal(2).select(search)) == set(best)


def test_the_order_of_the_candidates_does_not_matter():
    listed = parse_position_set("S1+S3", 4)
    shuffled = tuple(np.random.default_rng(1).permutation(np.array(listed, dtype=object)))
    one, other = of_s1_and_s3(), candidates((*shuffled, *listed[:5]))
    assert one.positions == other.positions
    np.testing.assert_array_equal(one.factors, other.factors)


def test_the_valuation_is_one_less_the_share_of_the_error_that_stays():
    job, offered = case(), of_s1_and_s3()
    seen = job.procedure.plan(offered.positions).observations
    grid = evaluation_grid(job.machine.model.ranges_mm, COARSE)
    worth = valuation(job.machine.family, job.artefact, seen, AS_STATED, grid, job.tool_offset_mm)
    _, aligned = predicted(offered.positions)
    assert worth.after.aligned_mm == pytest.approx(aligned, rel=1e-9)
    assert worth.percent == pytest.approx(100.0 * (1.0 - aligned / offered.vce([]).aligned_mm), rel=1e-9)
    assert valuation_of(job, parse_position_set("S3", 4)).percent == pytest.approx(66.0, abs=2.0)


REFUSED = [(-90.0, -30.0), (60.0, 15.0), (-60.0, -15.0), (90.0, -30.0)]
PASSED = [(0.0, 0.0), (45.0, 0.0), (90.0, 45.0), (-60.0, 0.0), (0.0, -75.0)]


def test_vetting_gives_the_verdict_of_the_preflight_on_plain_ways():
    """Orientations at which the preflight was seen to stop, and some at which it passes."""
    job = without_optimisation(case())
    check = FeasibilityCheck(job)
    for azimuth, elevation in (*REFUSED, *PASSED):
        position = Position(1, azimuth, elevation)
        assert bool(check.hit(position)) is (not _passes_preflight(job, position)) is ((azimuth, elevation) in REFUSED)


def test_ways_that_are_proved_pass_where_plain_ones_would_hit():
    check = FeasibilityCheck(case())
    for azimuth, elevation in (*REFUSED, *PASSED):
        position = Position(1, azimuth, elevation)
        assert check.hit(position) == ""
        assert _passes_preflight(case(), position)


def _passes_preflight(job: Job, position: Position) -> bool:
    try:
        preflight_of(replace(job, positions=(position,), held_out_choice=KnownHeldOut((Position(1, 30.0, 30.0),))))
    except PlanRefused:
        return False
    return True


def test_a_slot_holds_for_the_plan_as_a_whole_and_carries_cost_time():
    settings = case().settings
    timing = settings.timing.model_copy(update={"relocation_minutes": 4.0})
    job = replace(case(), settings=settings.model_copy(update={"timing": timing}))
    found = find_design(
        DesignProblem({"probe": job}, 45.0, set_alone), TimeSlotGoal(22.0), verify=True, prove=None, say=lambda _: None
    )
    assert found.minutes == pytest.approx(machine_minutes(job, found.positions).total)
    assert found.minutes <= 22.0
    stations = [position.station for position in found.positions]
    assert stations == sorted(stations)
    free = find_design(
        DesignProblem({"probe": case()}, 45.0, set_alone),
        TimeSlotGoal(22.0),
        verify=False,
        prove=None,
        say=lambda _: None,
    )
    assert len(set(stations)) <= len({position.station for position in free.positions})
    assert free.valuation.percent > found.valuation.percent > 0.0
    _assert_held_out(job, found.positions, found.held_out)


def _assert_held_out(job: Job, positions: tuple[Position, ...], held_out: tuple[Position, ...]) -> None:
    assert not set(positions) & set(held_out)
    assert not set(positions) & set(job.held_out)
    orientations = {(position.azimuth_deg, position.elevation_deg) for position in held_out}
    assert job.settings.verification.positions_deg is None
    assert len(orientations) == 2
    for azimuth, elevation in orientations:
        assert all(Position(station, azimuth, elevation) in held_out for station in job.verified_stations)


def test_what_a_preflight_refuses_is_left_out_and_the_search_goes_on():
    seen: list[tuple[Position, ...]] = []

    def refusing_once(job: Job) -> None:
        seen.append(job.positions)
        if len(seen) == 1:
            raise PlanRefused("preflight: collision", step=f"measure/{position_key(job.positions[1])}/ball-03/approach")

    found = find_design(
        DesignProblem({"probe": case()}, 90.0, set_alone),
        PositionCountGoal(3),
        verify=False,
        prove=refusing_once,
        say=lambda _: None,
    )
    assert len(seen) == 2
    assert found.preflight_passed
    assert found.positions == seen[1]
    assert seen[0][1] not in found.positions


def test_variants_change_what_they_name_and_nothing_else(tmp_path):
    ways = variants_of(case(), tmp_path, touches=[5, 9], balls=[5, 7], thetas_deg=[0.0])
    assert [(way.touches, way.balls, way.theta_deg, way.made_up) for way in ways] == [
        (5, 5, 0.0, True),
        (5, 7, 0.0, True),
        (9, 5, 0.0, True),
        (9, 7, 0.0, True),
    ]
    job = ways[2].jobs["probe"]
    assert job.artefact.count == job.layout.artefact.count == 5
    assert len(job.rules.probing.directions) == 9
    assert job.artefact.half_length_mm == pytest.approx(750.0, abs=0.1)
    assert variants_of(case(), tmp_path)[0].jobs["probe"] is case()


def test_more_touches_take_longer_and_tell_more(tmp_path):
    few, many = (way.jobs["probe"] for way in variants_of(case(), tmp_path, touches=[5, 13]))
    position = Position(1, 0.0, 0.0)
    assert FeasibilityCheck(many).minutes(position) > 1.2 * FeasibilityCheck(few).minutes(position)
    s3 = parse_position_set("S3", 4)
    assert valuation_of(many, s3).percent > valuation_of(few, s3).percent


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ({"touches": [6]}, "no pattern of 6 touches"),
        ({"balls": [1]}, "at least two balls"),
        ({"tools": ["hammer"]}, "the machine has no tool 'hammer'"),
    ],
)
def test_variants_that_cannot_be_are_refused(tmp_path, more, message):
    with pytest.raises(ConfigurationError, match=message):
        variants_of(case(), tmp_path, **more)


def test_an_unreachable_goal_is_the_users_error():
    with pytest.raises(InputError, match="shortest two take"):
        find_design(
            DesignProblem({"probe": case()}, 90.0, set_alone),
            TimeSlotGoal(1.0),
            verify=False,
            prove=None,
            say=lambda _: None,
        )
