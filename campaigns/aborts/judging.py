"""What must be true after a run was broken off, whatever the way."""

from __future__ import annotations

from typing import Any

from agent.execution.states import RunState
from agent.runs.session import RunResult
from campaigns.aborts.breaking import Breaking
from campaigns.aborts.case import FORMER, FORMER_BANK
from drivers.roles import MotionState

SETTLE_S = 60.0
AT_PLACE_MM = 0.01
WORDS = {
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
WITHDRAWN = ("abort", "refused", "guard", "disk full", "no", "defect")
"""Ways after which the axes can and must go back; without a link, or in a fault, nothing moves any more."""


def found(breaking: Breaking, ended: RunResult | None, defect: BaseException | None) -> dict[str, Any]:
    """`failures`: what must not be; `completed`: the run was through before anybody noticed."""
    way, world = breaking.way, breaking.world
    assert way is not None
    world.advance_to(world.now + SETTLE_S)
    if ended is not None and ended.outcome.state is RunState.COMPLETE:
        return {"completed": True, "failures": [str(c) for c in world.collisions]}
    failures = [*_machine(breaking), *_compensation(breaking, ended)]
    if (defect is not None) != (way.how == "defect"):
        failures.append(f"raised {defect!r}")
    if way.how != "disk full":
        failures += _journal(breaking)
    if ended is not None:
        expected = RunState.ABORTED if way.how in BY_REQUEST else RunState.FAULTED
        if ended.outcome.state is not expected:
            failures.append(f"ended {ended.outcome.state.value}: {ended.error}")
        if WORDS[way.how] not in str(ended.error):
            failures.append(f"the first cause is not told: {ended.error}")
    return {"completed": False, "failures": failures, "active": world.controller.active_bank}


def _machine(breaking: Breaking) -> list[str]:
    world, way = breaking.world, breaking.way
    assert way is not None
    failures = [f"collision: {one.body_a} with {one.body_b}" for one in world.collisions]
    if world.controller.motion not in (MotionState.IDLE, MotionState.FAULT):
        failures.append(f"left {world.controller.motion.value}")
    away = abs(float(world.controller.displayed_position()[1]) - world.controller.limits().lower_mm[1])
    if way.how in WITHDRAWN and away > AT_PLACE_MM and breaking.ordinal > 1:
        failures.append(f"the axes stand {away:.1f} mm before the retreat plane")
    return failures


def _compensation(breaking: Breaking, ended: RunResult | None) -> list[str]:
    """The former table acts and is whole. Without a link it cannot be brought back, and that must be told."""
    controller, way = breaking.world.controller, breaking.way
    assert way is not None
    failures = []
    if FORMER_BANK not in controller.banks or not controller.banks[FORMER_BANK].same_as(FORMER):
        failures.append("the former table is not what it was")
    if controller.active_bank != FORMER_BANK:
        told = any("could not be made active again" in str(run.reason) for run in breaking.memory.journal.runs())
        if way.how != "link" or not told:
            failures.append(f"bank {controller.active_bank} acts, told: {told}")
        if controller.active_bank not in controller.banks:
            failures.append("the bank that acts is empty")
    return failures


def _journal(breaking: Breaking) -> list[str]:
    """Closed with a final state, and the first cause as its reason."""
    way, journal = breaking.way, breaking.memory.journal
    assert way is not None
    [run] = journal.runs()
    expected = "aborted" if way.how in BY_REQUEST else "faulted"
    states = [event.record["state"] for event in journal.events(run.run, ("state",))]
    failures = []
    if run.state != expected or run.ended is None:
        failures.append(f"the journal ends {run.state}, closed {run.ended}, wanted {expected}")
    if states[-1:] != [expected]:
        failures.append(f"the last state in the journal is {states[-1:]}")
    if WORDS[way.how] not in str(run.reason).split(";", maxsplit=1)[0]:
        failures.append(f"the journal's first cause is {run.reason}")
    return failures
