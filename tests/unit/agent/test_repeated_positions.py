"""Positions that are measured again at the end, because the machine has changed."""

from __future__ import annotations

from dataclasses import replace

from agent.execution.steps import RunPlan
from agent.planning.case_file import CASE_STUDY, load_case
from agent.planning.cycle_time import walk_plan
from agent.planning.job import Job
from agent.probing.repeated_positions import RepeatRules, measure_with_repeats
from agent.probing.run_plan import MeasuredPositions, MeasuringOrder
from twin.artefact.position_set import Position

CHOSEN = (2, 4, 6)


def measured_with_repeats(job: Job, listed: tuple[Position, ...]) -> MeasuredPositions:
    found: list[MeasuredPositions] = []

    def then(measured: MeasuredPositions) -> RunPlan:
        found.append(measured)
        yield from ()
        return None

    rules = RepeatRules(threshold_k=0.0, declared_k=1.0, count=2, candidates=listed)

    def everything() -> RunPlan:
        order = MeasuringOrder("measure", listed, 1)
        fork = yield from measure_with_repeats(order, job.layout, job.rules, rules, then)
        assert fork is not None
        yield from fork.ways[fork.choose()]()
        return None

    walk_plan(job, everything())
    return found[-1]


def test_a_repeated_position_has_the_balls_that_were_chosen_for_it() -> None:
    job = load_case(CASE_STUDY)
    listed = (Position(1, 0.0, 0.0, balls=CHOSEN), Position(1, 45.0, 0.0))
    measured = measured_with_repeats(replace(job, positions=listed), listed)
    first, second, *again = [sorted(one.ball_numbers) for one in measured.positions]
    assert first == list(CHOSEN) and len(second) > len(first)
    assert again == [first, second]
