"""Record of a night from what the run has told, from its journal, and from the simulated world."""

from __future__ import annotations

import contextlib
import sqlite3
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from agent.execution import steps as s
from agent.execution.encoding import table_digest
from agent.execution.journal_schema import FILE_NAME
from agent.execution.rig import Rig
from agent.runs.reconcile import reconcile
from agent.runs.session import RunResult
from campaigns.aborts.case import FORMER_BANK, FORMER_TABLE
from campaigns.faults.fault_kinds import KINDS, PlannedFault
from campaigns.faults.fault_scene import FaultScene
from campaigns.faults.faulty_device import DEVICE, HangDetectedError
from campaigns.faults.night_record import NightRecord
from drivers.clock import VirtualClock
from drivers.errors import VolcalError
from simulators.backend import SimulatedMachineDevice

SETTLE_S = 60.0
"""Time in s after the end of the run, longer than any motion of it."""
ABORT_WITHIN_S = 0.06
"""Machine time in s after which an abort must be in effect: one part of a wait, and rounding."""
ACTING = frozenset(kind.__name__ for kind in s.STEPS_WITH_EFFECT)
UNRESTORED = "could not be made active again"


@dataclass(frozen=True)
class EndedNight:
    """Night after the end of its run.

    `ended` is the result of the run, or None if it raised the exception `defect`. `began_s` is the instant in s at
    which the fault began; `reached` is False if the run had ended before. `balls` is the number of balls that the run
    has acknowledged. `directory` contains the files of the run.
    """

    scene: FaultScene
    fault: PlannedFault
    ended: RunResult | None
    defect: BaseException | None
    began_s: float
    balls: int
    directory: Path
    reached: bool = True


def record_night(night: EndedNight) -> NightRecord:
    """Return the record of the night. The world goes on for some time after the run, and then the fault is removed and
    volcal is started again."""
    scene, fault, kind = night.scene, night.fault, KINDS[night.fault.kind]
    clock, controller = scene.clock, scene.world.controller
    clock.watched, clock.watch = False, None
    end_s, stood = clock.now(), controller.displayed_position()
    clock.advance_to(end_s + SETTLE_S)
    moved_mm = float(np.abs(controller.displayed_position() - stood).max())
    device, active, former = scene.machine, controller.active_bank, controller.banks.get(FORMER_BANK)
    told = _of_result(night) | _of_journal(night)
    return NightRecord(
        seed=fault.seed,
        night=fault.night,
        group=kind.group,
        kind=fault.kind,
        at_s=round(night.began_s, 3),
        size=" ".join(part for part in (scene.size, fault.key, "after" if fault.after else "") if part),
        reached=night.reached,
        collisions=tuple(f"{one.body_a} with {one.body_b} at {one.time_s:.2f} s" for one in scene.world.collisions),
        stopped_s=scene.stopped_s,
        stands_from_s=device.moved_until_s,
        moved_after_end_mm=moved_mm,
        motion_at_end=controller.motion.value,
        former=table_digest(FORMER_TABLE),
        complete_table=active == 0 or active in controller.banks,
        former_intact=former is not None and former.same_as(FORMER_TABLE),
        written=tuple(table_digest(image) for image in device.staged),
        told_unrestored=UNRESTORED in told["reason"],
        acknowledged_touches=device.touches,
        acknowledged_balls=night.balls,
        journal_writable=scene.journal_writable,
        reasons=kind.reasons,
        hung=clock.hung,
        end_s=round(end_s, 3),
        **told,
        **_of_table(scene.world.controller.active_bank, scene),
        **_morning(night),
    )


def _of_table(active: int, scene: FaultScene) -> dict[str, Any]:
    """Return the CRC-32 of the active table and, unless it is the former one, the true errors before and with it."""
    found: dict[str, Any] = {"active": _active_digest(scene)}
    if found["active"] != table_digest(FORMER_TABLE):
        truth = scene.world.truth
        for name, bank in (("before_um", FORMER_BANK), ("after_um", active)):
            found[name] = round(truth.true_volumetric_error(bank)[1], 3)
    return found


def _of_result(night: EndedNight) -> dict[str, Any]:
    """Return what the run has told its caller."""
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


def _of_journal(night: EndedNight) -> dict[str, Any]:
    """Return what the journal says of the run. Its reason also tells what could not be done at the end."""
    scene = night.scene
    journal = scene.memory.journal
    runs = journal.runs()
    if not runs:
        return {}
    run, aborted_s = runs[-1], scene.aborted_s
    steps = [] if aborted_s is None else journal.steps(run.run, procedure_only=True)
    late = [one.key for one in steps if one.kind in ACTING and one.begun_s > (aborted_s or 0.0) + ABORT_WITHIN_S]
    found = {
        "journaled_touches": journal.count_touches(run.run),
        "journaled_balls": journal.count_balls(run.run),
        "journal_state": run.state,
        "journal_closed": run.ended is not None,
        "steps_after_abort": tuple(late),
    }
    if run.reason and scene.journal_writable:
        found["reason"] = str(run.reason)
    return found


def _active_digest(scene: FaultScene) -> int:
    controller = scene.world.controller
    image = controller.banks.get(controller.active_bank)
    return 0 if image is None else table_digest(image)


def _morning(night: EndedNight) -> dict[str, Any]:
    """Remove the fault and start volcal again. Return the CRC-32 of the table that acts then, and what volcal says."""
    scene = night.scene
    for repair in scene.repairs:
        with contextlib.suppress(sqlite3.ProgrammingError):  # a connection that was closed meanwhile
            repair()
    if scene.proxy is not None:
        scene.proxy.repair()
    scene.world.controller.reset()
    clock = VirtualClock()
    clock.advance_to(scene.clock.now())
    device = SimulatedMachineDevice(scene.world, clock)  # the machine without its fault
    rig = Rig({DEVICE: device}, device, device, {1: device}, device, device, device, clock)
    rig.open()
    (night.directory / "state" / FILE_NAME).touch()  # the journal itself is in memory
    try:
        said = reconcile(rig, night.directory / "state").text
    except VolcalError as error:
        said = str(error)
    rig.close()
    return {"morning": _active_digest(scene), "morning_says": said}
