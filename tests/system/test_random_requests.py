"""A small part of the campaign `make requests`, and the sequences of requests in which it has found defects."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from campaign_command import run_campaign

from agent.execution.journal_reader import open_journal
from agent.execution.states import RunState
from agent.runs.run_kinds import KINDS
from campaigns.aborts.case import FORMER_BANK
from campaigns.requests.trial import Count, RequestTrial
from campaigns.sum import form_of
from drivers.roles import MotionState

S = RunState
STEPS = 300
"""Some ten seconds of CPU time."""
CALIBRATE = (KINDS.index("calibrate"), 0, 1)


def test_random_requests_at_all_moments_of_real_runs() -> None:
    code, found = run_campaign("requests", "--steps", str(STEPS), "--seed", "1")
    assert (code, found["violated"]) == (0, [])
    assert found["steps"] == STEPS
    assert form_of(found).name == "requests"
    assert sum(found["runs_by_end"].values()) > 2
    assert found["by_state"]["measuring"] > 10
    assert sum(count > 0 for count in found["accepted"].values()) > 6


def test_trials_in_two_parts_are_those_in_one() -> None:
    counts = [Count(), Count()]
    for count in counts:
        count.steps["start"] += 2
        count.violations.append("two runs at once")
    counts[0].add(counts[1])
    assert (counts[0].steps, counts[0].violations) == ({"start": 4}, ["two runs at once"] * 2)


@pytest.fixture
def trial(tmp_path: Path) -> Iterator[RequestTrial]:
    played = RequestTrial(tmp_path, Count())
    try:
        yield played
    finally:
        played.close()
    assert played.count.violations == []


def perform(trial: RequestTrial, action: str, *choices: int) -> None:
    """Perform an action with these choices of its arguments."""
    given = iter(choices)
    trial.perform(action, lambda _: next(given))


def state(trial: RequestTrial) -> RunState:
    return trial.scene.owner.status().state


def go_to(trial: RequestTrial, wanted: RunState) -> None:
    while state(trial) is not wanted:
        assert not trial.at_rest, f"ended {state(trial).value} before {wanted.value}"
        perform(trial, "go_to_the_next_state")


def go_on(trial: RequestTrial) -> None:
    """Let the run pass the turnstile once."""
    perform(trial, "go_on", 0, 0)


def cut(trial: RequestTrial) -> None:
    perform(trial, "cut_or_connect", 0)


def connect(trial: RequestTrial) -> None:
    perform(trial, "cut_or_connect", 1)


def test_a_resumption_while_the_axes_brake_for_the_hold_resumes_the_motion(trial: RequestTrial) -> None:
    controller = trial.scene.world.controller
    perform(trial, "start", *CALIBRATE)
    go_to(trial, S.MEASURING)
    y_mm = trial.scene.position_mm[1]
    while controller.motion is not MotionState.MOVING or abs(trial.scene.position_mm[1] - y_mm) < 1.0:
        y_mm = trial.scene.position_mm[1]
        go_on(trial)
    perform(trial, "hold")
    go_to(trial, S.HELD)
    assert controller.motion is MotionState.MOVING, "the axes brake"
    perform(trial, "resume")
    go_to(trial, S.MEASURING)
    go_to(trial, S.IDENTIFYING)


def test_a_run_that_is_resumed_after_a_later_one_ended_in_its_preflight_proves_its_table(trial: RequestTrial) -> None:
    perform(trial, "start", *CALIBRATE)
    go_to(trial, S.VERIFYING)
    run_id = trial.scene.owner.status().run_id
    cut(trial)
    go_to(trial, S.FAULTED)
    connect(trial)
    perform(trial, "reset")
    assert trial.scene.table[0] == FORMER_BANK
    perform(trial, "start", *CALIBRATE)
    perform(trial, "abort")
    go_to(trial, S.ABORTED)
    perform(trial, "reset")
    perform(trial, "resume_run", 0)
    assert trial.scene.owner.status().run_id == run_id
    go_to(trial, S.COMPLETE)
    assert trial.scene.table[0] != FORMER_BANK
    with open_journal(trial.scene.state_directory) as reader:
        last = reader.last_run()
    assert last is not None
    assert last.run_id != run_id


def test_a_stopped_run_whose_table_is_taken_back_by_a_reset_is_not_offered_again(trial: RequestTrial) -> None:
    perform(trial, "start", *CALIBRATE)
    go_to(trial, S.VERIFYING)
    perform(trial, "abort")
    go_to(trial, S.ABORTING)
    cut(trial)
    go_to(trial, S.FAULTED)
    connect(trial)
    assert trial.scene.table[0] != FORMER_BANK
    perform(trial, "reset")
    assert trial.scene.table[0] == FORMER_BANK
    assert (trial.scene.owner.status().unfinished, "resume_run" in trial.may) == (None, False)
    perform(trial, "resume_run", 0)
    assert trial.at_rest


def test_a_restoration_first_takes_back_a_table_that_was_never_proved(trial: RequestTrial) -> None:
    perform(trial, "start", *CALIBRATE)
    go_to(trial, S.VERIFYING)
    run_id = trial.scene.owner.status().run_id
    cut(trial)
    go_to(trial, S.FAULTED)
    perform(trial, "reset")
    assert trial.scene.table[0] != FORMER_BANK, "the link is still cut"
    connect(trial)
    assert run_id is not None
    perform(trial, "restore_table", trial.stored_tables().index((run_id, "backup")), 0)
    assert trial.scene.table[0] == FORMER_BANK
    go_to(trial, S.COMPLETE)


def test_a_resumed_run_whose_proof_is_broken_off_is_taken_back_although_a_later_run_read_the_table(
    trial: RequestTrial,
) -> None:
    perform(trial, "start", *CALIBRATE)
    go_to(trial, S.MEASURING)
    while trial.scene.owner.status().balls < 1:
        perform(trial, "go_on", 1, 30)
    cut(trial)
    go_to(trial, S.FAULTED)
    connect(trial)
    perform(trial, "reset")
    perform(trial, "start", *CALIBRATE)
    go_to(trial, S.MEASURING)
    cut(trial)
    go_to(trial, S.FAULTED)
    connect(trial)
    perform(trial, "reset")
    perform(trial, "resume_run", 0)
    go_to(trial, S.VERIFYING)
    cut(trial)
    go_to(trial, S.FAULTED)
    connect(trial)
    assert trial.scene.table[0] != FORMER_BANK
    perform(trial, "reset")
    assert trial.scene.table[0] == FORMER_BANK


def test_a_table_that_the_controller_keeps_is_given_up_and_no_run_starts_before_it_is_taken_back(
    trial: RequestTrial,
) -> None:
    perform(trial, "start", *CALIBRATE)
    go_to(trial, S.VERIFYING)
    perform(trial, "refuse_or_permit", 0)
    perform(trial, "kill")
    perform(trial, "reset")
    perform(trial, "give_up")
    assert trial.scene.owner.status().unfinished is None
    perform(trial, "start", *CALIBRATE)
    assert trial.at_rest
    perform(trial, "refuse_or_permit", 1)
    perform(trial, "restore_former")
    assert trial.count.accepted["restore_former"] == 1
    assert trial.scene.table[0] == FORMER_BANK
