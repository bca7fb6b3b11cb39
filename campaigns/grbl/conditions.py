"""Conditions that must hold after every disturbance of a run over a serial line."""

from __future__ import annotations

from typing import Any

import numpy as np

from agent.execution.journal_reader import JournalReader
from agent.execution.states import RunState
from agent.runs.session import RunResult
from campaigns.grbl.disturbance_kinds import BRAKED_AFTER_S, END_REASON, KINDS, Observation
from campaigns.grbl.scene import DisturbedMachine
from drivers.roles import MotionState

SETTLE_S = 60.0
"""Time in s after the end of the run, longer than any motion of it."""
MOVED_MM = 1e-6
HOLD = b"!"
RESET = "reset"
"""A reset of a controller at rest keeps the position, and the run may go on."""


def judge(
    scene: DisturbedMachine,
    seen: Observation,
    ended: RunResult | None,
    defect: BaseException | None,
    journal: JournalReader,
) -> dict[str, Any]:
    """Return the result of one disturbed run; ``failures`` lists the conditions that it violates."""
    kind = KINDS[seen.kind]
    ended_s = scene.clock.now()
    scene.clock.advance_to(ended_s + BRAKED_AFTER_S)
    at_end, place = scene.world.controller.motion, scene.position
    scene.clock.advance_to(ended_s + SETTLE_S)
    after = scene.position
    scene.clock.advance_to(ended_s + 2.0 * SETTLE_S)
    if defect is not None or ended is None:
        return {"failures": [f"raised {defect!r}"]}
    reason = str(ended.error)
    state = ended.outcome.state
    noticed = END_REASON not in reason and state is not RunState.COMPLETE
    failures = [f"collision: {one.body_a} with {one.body_b}" for one in scene.world.collisions]
    if np.abs(scene.position - after).max() > MOVED_MM:
        failures.append("something still moves long after the end of the run")
    if kind.reachable and (at_end is MotionState.MOVING or np.abs(after - place).max() > MOVED_MM):
        failures.append(f"the axes move after the end of the run ({at_end.value})")
    stands = kind.stands and (seen.moving or seen.kind != RESET)
    if stands and seen.braked and seen.released and np.abs(np.subtract(seen.braked, seen.released)).max() > MOVED_MM:
        failures.append("the axes have moved while they must not")
    failures += _reason(seen, state, reason, noticed=noticed)
    if noticed and seen.moving and state is RunState.FAULTED:
        failures += _stop_sent(scene, seen, reachable=kind.reachable)
    [run] = journal.runs()
    lost = (scene.probe.touches if scene.probe else 0) - journal.count_touches(run.run)
    if lost > 0:
        failures.append(f"{lost} measured touches are not in the journal")
    if run.ended is None or run.state != state.value:
        failures.append(f"the journal ends {run.state}, closed {run.ended}")
    return {
        "failures": failures,
        "state": state.value,
        "noticed": noticed,
        "moving": seen.moving,
        "latency_s": round(ended_s - seen.began_s, 3),
        "reason": reason,
    }


def _reason(seen: Observation, state: RunState, reason: str, *, noticed: bool) -> list[str]:
    kind = KINDS[seen.kind]
    if not noticed:
        must = kind.ends_motion and seen.moving
        expected = state in (RunState.ABORTED, RunState.COMPLETE)
        return [f"not noticed: ended {state.value}"] if must or not expected else []
    failures = []
    if state not in (RunState.FAULTED, RunState.ABORTED):
        failures.append(f"ended {state.value}: {reason}")
    if not any(word in reason for word in kind.reasons):
        failures.append(f"the cause is not named: {reason}")
    return failures


def _stop_sent(scene: DisturbedMachine, seen: Observation, *, reachable: bool) -> list[str]:
    """Return a failure unless a feed hold was sent after the disturbance, or could not be and this was noticed."""
    if any(HOLD in data for at_s, data in scene.cable.sent if at_s >= seen.began_s):
        return []
    if not reachable and any(at_s >= seen.began_s for at_s in scene.cable.refused_urgent):
        return []
    return ["no stop was sent"]
