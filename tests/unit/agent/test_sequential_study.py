"""Study of sequential calibrations on few machines: what ends a run, and that each machine stands alone."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any
from unittest.mock import patch

from study_case import shipped_job, study_case

from agent.planning.design.sequential_candidates import MIN_POSITIONS
from agent.planning.job import Job
from agent.studies import sequential
from agent.studies.sequential import COLUMNS, DESIGNED, NAMED, SEQUENTIAL, run
from agent.studies.study import StudyResult
from agent.studies.study_files import document, format_rows

MACHINES = 2


def job() -> Job:
    """Two stations and one Legendre order, so that the study takes seconds."""
    made = shipped_job(2)
    identification = made.settings.identification.model_copy(update={"order": 5})
    return replace(made, settings=made.settings.model_copy(update={"identification": identification}))


@cache
def found() -> StudyResult:
    """Two designs and their bounds out of few candidates, so that the study takes seconds."""
    with patch.multiple(sequential, _SLOT_SHARES=(0.5, 1.0), _DESIGN_GRID_DEG=45.0):
        return run(study_case(2, seed=4, machines=MACHINES, job=job()))


def rows(result: StudyResult) -> list[dict[str, Any]]:
    return [dict(zip(COLUMNS, row, strict=True)) for row in result.rows]


def endings(result: StudyResult) -> list[dict[str, Any]]:
    return [row for row in rows(result) if row["ending"].startswith("target")]


def test_each_machine_ends_once_for_each_target() -> None:
    ends = endings(found())
    assert [row["machine"] for row in ends] == [0, 0, 1, 1]
    targets = [float(row["ending"].split()[1]) for row in ends]
    assert targets[0] > targets[1]


def test_a_run_ends_at_its_target_or_with_its_slot() -> None:
    slot = found().summary["slot_minutes"]
    assert isinstance(slot, float)
    for row in endings(found()):
        assert row["positions"] >= MIN_POSITIONS
        assert row["minutes"] <= slot
        target = float(row["ending"].split()[1])
        assert (row["vce_upper_um"] < target + 0.005) == row["reached"]


def test_what_is_held_lies_between_its_limits() -> None:
    for row in rows(found()):
        assert row["held"] == (row["vce_lower_um"] <= row["vce_true_aligned_um"] <= row["vce_upper_um"])


def test_the_three_ways_are_compared_within_the_same_time() -> None:
    of_first = [row for row in rows(found()) if row["machine"] == 0]
    for name in (NAMED, DESIGNED, SEQUENTIAL):
        minutes = [row["minutes"] for row in of_first if row["ending"] == name]
        assert len(minutes) >= 2
        assert minutes == sorted(minutes)
        assert name == NAMED or max(minutes) <= 20.0
    assert {row["machine"] for row in rows(found()) if row["ending"] in (NAMED, DESIGNED, SEQUENTIAL)} == {0, 1}


def test_no_design_passes_the_information_bound() -> None:
    summary: dict[str, Any] = dict(found().summary)
    expected, bound = summary["expected_of_designs"], summary["information_bound"]
    assert expected["minutes"] == bound["minutes"]
    for of_design, lowest in zip(expected["vce_um"], bound["vce_um"], strict=True):
        assert 0.5 * of_design < lowest < of_design


def test_the_result_can_be_written() -> None:
    assert format_rows(found()).count("\n") == len(found().rows) + 1
    assert document(found())["study"] == "sequential"
