"""Record of a night from what the run has told, from its journal, and from the simulated world."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np

from agent.execution import steps as s
from agent.execution.encoding import table_digest
from agent.execution.journal_schema import FILE_NAME
from agent.execution.rig import Rig
from agent.results.applied_table import BANK_DOUBTED
from agent.runs.reconcile import reconcile
from agent.runs.reference_state import ACTIVATING_DECISIONS
from agent.runs.resume.abandon import abandon
from agent.runs.session import RunResult
from agent.thermal.readings import ARTEFACT
from campaigns.aborts.case import FORMER_BANK, FORMER_TABLE
from campaigns.faults.excuses import NOT_SHOWN
from campaigns.faults.fault_injector import RETURN_PREFIX, FaultInjector
from campaigns.faults.fault_kinds import KINDS, WIRE
from campaigns.faults.fault_scene import FaultScene
from campaigns.faults.faulty_device import DEVICE, HangDetectedError
from campaigns.faults.night_record import NightRecord
from campaigns.faults.planned_night import PlannedNight
from drivers.clock import VirtualClock
from drivers.errors import VolcalError
from simulators.backend import SimulatedMachineDevice
from twin.units import UM_PER_MM

SETTLE_S = 60.0
"""Time in s after the end of the run, longer than any motion of it."""
ABORT_WITHIN_S = 0.06
"""Machine time in s after which an abort must be in effect: one part of a wait, and rounding."""
ACTING = frozenset(kind.__name__ for kind in s.STEPS_WITH_EFFECT)
THERMOMETERS = frozenset(kind for kind in KINDS if kind.startswith("thermometer"))
LARGEST_EXPANSION_PER_K = 12e-6
"""Thermal expansion of steel in 1/K; no artefact expands more."""
STATED_K = 0.3
"""Error in K that the stated uncertainty of the thermometer, 0.1 K, covers."""
UNRESTORED = ("could not be made active again", BANK_DOUBTED)
"""Words of which the reason of a run that has not restored the former table must contain one."""


class Start(Enum):
    """Start of volcal in the morning."""

    RESTARTED = "restarted"
    GIVEN_UP = "given up"


@dataclass(frozen=True)
class EndedRun:
    """Run that has ended, with the object that has let its faults begin.

    `ended` is the result of the run, or None if it raised the exception `defect` or if `killed` is True. `directory`
    contains the files of the run. The world goes on for `settle_s` seconds before anything else happens.
    """

    injector: FaultInjector
    ended: RunResult | None
    defect: BaseException | None
    directory: Path
    killed: bool = False
    settle_s: float = SETTLE_S


def record_run(run: EndedRun, night: PlannedNight) -> NightRecord:
    """Return the record of a run of the night. The world goes on for some time after it."""
    injector, scene = run.injector, run.injector.scene
    clock, controller = scene.clock, scene.world.controller
    clock.watched, clock.watch = False, None
    end_s, stood = clock.now(), controller.displayed_position()
    clock.advance_to(end_s + run.settle_s)
    moved_mm = float(np.abs(controller.displayed_position() - stood).max())
    device, active, former = scene.machine, controller.active_bank, controller.banks.get(FORMER_BANK)
    injector.written += [table_digest(image) for image in device.staged]
    told = _of_result(run) | _of_journal(run)
    kinds = [KINDS[kind] for _, kind in injector.begun]
    named = [kind.reasons for kind in kinds]
    cleared = all(KINDS[kind].cleared for kind in injector.kinds)
    on_virtual_clock = not any(KINDS[kind].link for kind in injector.kinds)  # a starved computer disturbs a real link
    at_step = " ".join(part for part in (night.key, "after" if night.after else "") if part)
    return NightRecord(
        seed=night.seed,
        night=night.night,
        group=night.group,
        kind=night.kind,
        second="" if night.second is None else night.second.kind,
        second_begun=injector.second_begun,
        at_s=round(injector.begun[0][0], 3) if injector.begun else 0.0,
        size="; ".join([*injector.sizes, *([at_step] if at_step else [])]),
        resumed=injector.runs - 1,
        must_resume=cleared and bool(injector.acknowledged),
        must_end_well=cleared and on_virtual_clock and injector.runs > 1 and not injector.begun,
        collisions=tuple(text for text, bodies in _collisions(scene) if not bodies & scene.displaced),
        struck=tuple(text for text, bodies in _collisions(scene) if bodies & scene.displaced),
        stopped_s=scene.stopped_s,
        stands_from_s=device.moved_until_s,
        moved_after_end_mm=moved_mm,
        motion_at_end=controller.motion.value,
        former=table_digest(FORMER_TABLE),
        complete_table=active == 0 or active in controller.banks,
        former_intact=former is not None and former.same_as(FORMER_TABLE),
        written=tuple(injector.written),
        misled_um=_misled_um(scene) if THERMOMETERS.intersection(injector.kinds) else 0.0,
        told_unrestored=any(words in told["reason"] for words in UNRESTORED),
        unseen=_unseen(scene, told["reason"]),
        killed=run.killed,
        acknowledged_touches=len(injector.acknowledged if run.killed else injector.touches),
        acknowledged_balls=injector.balls,
        journal_writable=scene.journal_writable,
        faulted=bool(kinds),
        reasons=tuple(word for words in named for word in words) if all(named) else (),
        needs_place=bool(kinds) and all(kind.group == WIRE for kind in kinds),
        hung=clock.hung,
        end_s=round(end_s, 3),
        **told,
        **_of_table(scene.world.controller.active_bank, scene),
    )


def _collisions(scene: FaultScene) -> Iterator[tuple[str, set[str]]]:
    """Yield each collision in words, with the names of its two bodies."""
    for one in scene.world.collisions:
        yield f"{one.body_a} with {one.body_b} at {one.time_s:.2f} s", {one.body_a, one.body_b}


def _unseen(scene: FaultScene, reason: str) -> str:
    """Return why nothing could show the run that the former table does not act; empty if something could. `reason` is
    that of its end."""
    journal = scene.journal()
    runs = journal.runs()
    if not runs or FORMER_BANK not in scene.deceived:
        return ""
    if scene.deceived != {FORMER_BANK} and journal.has_decision(runs[-1].run, ("proof",)):
        if NOT_SHOWN not in reason or any(words in reason for words in UNRESTORED):
            return ""  # the proof has measured that the first activation was reported wrongly
        return (
            "the controller reports the former bank as active, and the tables differ too little for the proof to tell"
        )
    return "the controller reports the former bank as active, and nothing is measured after its activation"


def _misled_um(scene: FaultScene) -> float:
    """Return the largest error in µm by which a table may be wrong because the thermometer of the artefact was, at the
    readings that the run has used: nothing on the machine tells a wrong temperature of the bar from a wrong scale."""
    journal, controller = scene.journal(), scene.world.controller
    runs, true_c = journal.runs(), controller.temperatures()[ARTEFACT]
    readings = journal.temperatures(runs[-1].run) if runs else ()
    wrong_k = max((abs(row.record[ARTEFACT] - true_c) for row in readings if ARTEFACT in row.record), default=0.0)
    limits = controller.limits()
    diagonal_mm = float(np.linalg.norm(np.subtract(limits.upper_mm, limits.lower_mm)))
    return round(UM_PER_MM * LARGEST_EXPANSION_PER_K * wrong_k * diagonal_mm, 3) if wrong_k > STATED_K else 0.0


def _of_table(active: int, scene: FaultScene) -> dict[str, Any]:
    """Return the CRC-32 of the active table and, unless it is the former one, the true errors before and with it."""
    found: dict[str, Any] = {"active": _active_digest(scene)}
    if found["active"] != table_digest(FORMER_TABLE):
        truth = scene.world.truth
        for name, bank in (("before_um", FORMER_BANK), ("after_um", active)):
            found[name] = round(truth.true_volumetric_error(bank)[1], 3)
    return found


def _of_result(night: EndedRun) -> dict[str, Any]:
    """Return what the run has told its caller."""
    if night.killed:
        return {"reason": ""}
    if night.ended is None:
        raised = None if isinstance(night.defect, HangDetectedError) else repr(night.defect)
        return {"reason": "", "raised": raised or ""}
    outcome, error = night.ended.outcome, night.ended.error
    proof = outcome.proof
    where = error.where if isinstance(error, VolcalError) else {}
    return {
        "state": outcome.state.value,
        "accepted": proof is not None and proof.accepted,
        "reason": outcome.reason or ("" if proof is None or proof.accepted else proof.reason),
        "error": "" if error is None else type(error).__name__,
        "step": where.get("step", ""),
        "place": where.get("device", "") or where.get("link", ""),
    }


def _of_journal(night: EndedRun) -> dict[str, Any]:
    """Return what the journal says of the run. Its reason also tells what could not be done at the end."""
    scene = night.injector.scene
    journal = scene.journal()
    runs = journal.runs()
    if not runs:
        return {}
    run, aborted_s = runs[-1], scene.aborted_s
    steps = [] if aborted_s is None else journal.steps(run.run, procedure_only=True)
    late = [one.key for one in steps if one.kind in ACTING and one.begun_s > (aborted_s or 0.0) + ABORT_WITHIN_S]
    touches = [one.key for one in journal.steps(run.run, "TouchTowards") if one.result_text is not None]
    measured = Counter(key for key in touches if not key.startswith(RETURN_PREFIX))
    valid = Counter(touch.key for touch in journal.touches(run.run))
    repeated = Counter(night.injector.acknowledged) - (measured - valid)
    found = {
        "journaled_touches": measured.total(),
        "repeated": tuple(key for key, count in repeated.items() if count > 1),
        "journaled_balls": journal.count_balls(run.run),
        "journal_state": run.state,
        "journal_closed": run.ended is not None,
        "steps_after_abort": tuple(late),
    }
    if night.killed:
        found["accepted"] = journal.has_decision(run.run, ACTIVATING_DECISIONS)
    if run.reason and scene.journal_writable:
        found["reason"] = str(run.reason)
    return found


def _active_digest(scene: FaultScene) -> int:
    controller = scene.world.controller
    image = controller.banks.get(controller.active_bank)
    return 0 if image is None else table_digest(image)


def start_volcal(record: NightRecord, run: EndedRun, how: Start) -> NightRecord:
    """Start volcal again on the machine without its faults, and give up its run if that is asked for. Return the record
    with what it says then, and with the table that acts then."""
    scene, state = run.injector.scene, run.directory / "state"
    scene.world.controller.reset()
    clock = VirtualClock()
    clock.advance_to(scene.clock.now())
    device = SimulatedMachineDevice(scene.world, clock)  # the machine without its faults
    rig = Rig({DEVICE: device}, device, device, {1: device}, device, device, device, clock)
    rig.open()
    (state / FILE_NAME).touch()  # the journal itself is in memory
    try:
        found = abandon(rig, state, "a person gives it up") if how is Start.GIVEN_UP else reconcile(rig, state)
        said = found.text
    except VolcalError as error:
        said = str(error)
    rig.close()
    return replace(record, morning=_active_digest(scene), morning_says=said)
