"""Check of the conditions that must hold after every interruption of a run."""

from __future__ import annotations

from typing import Any

from agent.execution.states import RunState
from agent.runs.session import RunResult
from campaigns.aborts.case import FORMER_BANK, FORMER_TABLE
from campaigns.aborts.interruption_kinds import Interrupter
from drivers.roles import MotionState

SETTLE_S = 60.0
POSITION_TOLERANCE_MM = 0.01
EXPECTED_REASONS = {
    "abort": "SIGINT",
    "link": "connection reset",
    "link once": "connection reset",
    "fault": "door opened",
    "refused": "the controller refused",
    "guard": "probe tripped in a guarded move",
    "disk full": "the journal cannot be written",
    "no": "the operator said no",
    "defect": "a defect of ours",
}
BY_REQUEST = ("abort", "no")
WITHDRAWING = ("abort", "refused", "guard", "disk full", "no", "defect")
"""Interruptions after which the axes can and must withdraw. Without a link, or in a fault, nothing moves."""


def check_interruption(
    interrupter: Interrupter, ended: RunResult | None, defect: BaseException | None
) -> dict[str, Any]:
    """Check the conditions that must hold after a run has been interrupted, and return an object with up to three keys.

    `ended` is the result of the run, or None if it raised the exception `defect`.

    ``failures`` lists the violated conditions. ``completed`` is True if the run completed before the interruption was
    noticed. ``active`` is the number of the controller's active bank; the key is present only if the run did not
    complete.
    """
    interruption, world = interrupter.interruption, interrupter.world
    assert interruption is not None
    world.advance_to(world.now + SETTLE_S)
    if ended is not None and ended.outcome.state is RunState.COMPLETE:
        return {"completed": True, "failures": [str(c) for c in world.collisions]}
    failures = [*_machine(interrupter), *_compensation(interrupter, ended)]
    if (defect is not None) != (interruption.how == "defect"):
        failures.append(f"raised {defect!r}")
    if interruption.how != "disk full":
        failures += _journal(interrupter)
    if ended is not None:
        expected = RunState.ABORTED if interruption.how in BY_REQUEST else RunState.FAULTED
        if ended.outcome.state is not expected:
            failures.append(f"ended {ended.outcome.state.value}: {ended.error}")
        if EXPECTED_REASONS[interruption.how] not in str(ended.error):
            failures.append(f"the first cause is not reported: {ended.error}")
    return {"completed": False, "failures": failures, "active": world.controller.active_bank}


def _machine(interrupter: Interrupter) -> list[str]:
    world, interruption = interrupter.world, interrupter.interruption
    assert interruption is not None
    failures = [f"collision: {one.body_a} with {one.body_b}" for one in world.collisions]
    if world.controller.motion not in (MotionState.IDLE, MotionState.FAULT):
        failures.append(f"left {world.controller.motion.value}")
    away = abs(float(world.controller.displayed_position()[1]) - world.controller.limits().lower_mm[1])
    if interruption.how in WITHDRAWING and away > POSITION_TOLERANCE_MM and interrupter.ordinal > 1:
        failures.append(f"the axes stand {away:.1f} mm short of the retreat plane")
    return failures


def _compensation(interrupter: Interrupter, ended: RunResult | None) -> list[str]:
    """Return failures unless the former table is active and unchanged.

    After a link loss it cannot be restored; the run must then have reported this.
    """
    controller, interruption = interrupter.world.controller, interrupter.interruption
    assert interruption is not None
    failures = []
    if FORMER_BANK not in controller.banks or not controller.banks[FORMER_BANK].same_as(FORMER_TABLE):
        failures.append("the former table is not what it was")
    if controller.active_bank != FORMER_BANK:
        told = any("could not be made active again" in str(run.reason) for run in interrupter.memory.journal.runs())
        if interruption.how != "link" or not told:
            failures.append(f"bank {controller.active_bank} is active, reported: {told}")
        if controller.active_bank not in controller.banks:
            failures.append("the active bank is empty")
    return failures


def _journal(interrupter: Interrupter) -> list[str]:
    """Return failures unless the journal is closed with the expected final state and gives the first cause as the
    reason.
    """
    interruption, journal = interrupter.interruption, interrupter.memory.journal
    assert interruption is not None
    [run] = journal.runs()
    expected = "aborted" if interruption.how in BY_REQUEST else "faulted"
    states = [event.record["state"] for event in journal.events(run.run, ("state",))]
    failures = []
    if run.state != expected or run.ended is None:
        failures.append(f"the journal ends {run.state}, closed {run.ended}, wanted {expected}")
    if states[-1:] != [expected]:
        failures.append(f"the last state in the journal is {states[-1:]}")
    if EXPECTED_REASONS[interruption.how] not in str(run.reason).split(";", maxsplit=1)[0]:
        failures.append(f"the journal's first cause is {run.reason}")
    return failures
