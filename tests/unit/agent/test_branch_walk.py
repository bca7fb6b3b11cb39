"""Branches of a plan: each way of each decision is walked on a machine of its own."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import pytest

from agent.errors import PlanRefused
from agent.execution.states import RunState
from agent.execution.steps import (
    CheckPermissions,
    Conclude,
    Dwell,
    Enter,
    Fork,
    MoveTo,
    ReadPosition,
    RunPlan,
    StageTable,
)
from agent.planning.case_file import load_case
from agent.planning.job import Job
from agent.planning.preflight import PreflightResult, run_preflight
from agent.planning.stand_ins import STAND_IN_TABLE
from agent.service.owner.run_hooks import require_within

CASE_STUDY = Path(__file__).resolve().parents[3] / "config" / "case-study.toml"
FAR, NEAR = (3000.0, 0.0, 1400.0), (500.0, 0.0, 1400.0)
SEEN: list[tuple[str, tuple[float, float, float]]] = []


@cache
def job() -> Job:
    return load_case(CASE_STUDY)


def never_called() -> str:
    raise AssertionError("the preflight decides nothing")


def forking(_: Job) -> RunPlan:
    yield CheckPermissions("permissions")
    yield MoveTo("start", NEAR)
    value = yield Conclude("value", never_called, stand_in="stand-in")
    assert value == "stand-in"
    return Fork("choice", never_called, {"short": short, "long": long}, expected="short")


def short() -> RunPlan:
    SEEN.append(("short", (yield ReadPosition("here"))))
    yield MoveTo("short/move", FAR)
    return None


def long() -> RunPlan:
    SEEN.append(("long", (yield ReadPosition("here"))))
    yield Dwell("long/wait", 600.0)
    return Fork("again", never_called, {"rest": rest, "stop": stop}, expected="stop")


def rest() -> RunPlan:
    yield Dwell("rest/wait", 60.0)
    return None


def stop() -> RunPlan:
    yield from ()
    return None


@pytest.fixture(scope="module")
def walked() -> PreflightResult:
    SEEN.clear()
    return run_preflight(job(), forking)


def test_every_way_is_walked_and_the_expected_one_stands_first(walked: PreflightResult) -> None:
    assert [branch.ways for branch in walked.ends] == [("short",), ("long", "stop"), ("long", "rest")]
    assert [branch.keys[-1] for branch in walked.ends] == ["short/move", "again", "rest/wait"]
    assert all(branch.keys[:3] == ("permissions", "start", "choice") for branch in walked.ends)


def test_each_way_begins_where_the_decision_was_made(walked: PreflightResult) -> None:
    assert SEEN == [("short", NEAR), ("long", NEAR)]


def test_the_longest_way_decides_whether_a_run_fits(walked: PreflightResult) -> None:
    assert walked.machine_minutes < 1.0
    assert 11.0 < walked.longest_minutes < 12.0
    require_within(walked, 12.0)
    with pytest.raises(PlanRefused, match="11 min of machine time, 10 min are available"):
        require_within(walked, 10.0)


def test_only_the_expected_way_is_walked_if_asked(walked: PreflightResult) -> None:
    alone = run_preflight(job(), forking, every_branch=False)
    assert [branch.ways for branch in alone.branches] == [("short",)]
    assert alone.machine_seconds == walked.machine_seconds


def test_a_way_that_is_not_expected_is_refused_too() -> None:
    def plan(_: Job) -> RunPlan:
        yield CheckPermissions("permissions")

        def beyond() -> RunPlan:
            yield MoveTo("beyond", (1e6, 0.0, 1400.0))
            return None

        return Fork("choice", never_called, {"here": stop, "beyond": beyond}, expected="here")

    assert run_preflight(job(), plan, every_branch=False)
    with pytest.raises(PlanRefused) as refused:
        run_preflight(job(), plan)
    assert refused.value.where["step"] == "beyond"


@pytest.mark.parametrize(("state", "permitted"), [(RunState.STAGING, True), (RunState.VERIFYING, False)])
def test_a_table_is_written_in_the_states_that_write_alone(state: RunState, permitted: bool) -> None:
    def plan(_: Job) -> RunPlan:
        yield Enter("state", state)
        yield StageTable("stage", 1, STAND_IN_TABLE)
        return None

    if permitted:
        assert run_preflight(job(), plan).expected.keys == ("stage",)
        return
    with pytest.raises(PlanRefused, match="must not write"):
        run_preflight(job(), plan)
