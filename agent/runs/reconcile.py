"""Comparison of the controller's active compensation with the journal of earlier runs after a start of the program, and
repair if necessary.

Only one state must be repaired: a table is active that was never proved by measurement. In this case, the former table
is reactivated. All other states are complete and consistent, because a bank is never written while it is active.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Self

from agent.errors import Busy
from agent.execution.encoding import table_digest
from agent.execution.engine import Engine
from agent.execution.journal import Journal
from agent.execution.journal_reader import JournalReader, has_journal, open_journal
from agent.execution.journal_rows import TableRow
from agent.execution.rig import ACTIVATED_AFTER, ACTIVATION_INSTRUCTION, Rig
from agent.execution.run_lock import ownership
from agent.execution.steps import CheckPermissions, Plan
from agent.execution.stored_json import stored_json
from agent.probing import publish
from agent.runs.reconcile_result import CompensationState, ReconcileAction, Reconciliation
from agent.runs.reference_state import ACTIVATING_DECISIONS
from agent.runs.unfinished_run import UnfinishedRun, left_unproved, unfinished_run
from agent.runs.unproved_table import UnprovedTable
from drivers.clock import Deadline
from drivers.errors import DeviceError, NotActiveYet, PermissionMissing
from drivers.roles import MotionState, TableImage


@dataclass(frozen=True)
class RecordedBank:
    """Number of a bank, with the CRC-32 of the table in it, and its grid: origin, step, resolution and shape. Both are
    None for an empty bank and for bank 0 (no compensation). The same corrections elsewhere are another table."""

    number: int
    crc32: int | None
    grid: tuple[object, ...] | None

    @classmethod
    def of_image(cls, number: int, image: TableImage | None) -> Self:
        if image is None:
            return cls(number, None, None)
        grid = (*image.origin_mm, *image.step_mm, image.resolution_mm, *image.shape)
        return cls(number, table_digest(image), grid)

    @classmethod
    def of_row(cls, row: TableRow) -> Self:
        origin, step, shape = (
            stored_json(text) for text in (row.origin_mm_text or "[]", row.step_mm_text or "[]", row.shape_text or "[]")
        )
        grid = None if row.crc32 is None else (*origin, *step, row.resolution_mm, *shape)
        return cls(row.bank, row.crc32, grid)


@dataclass(frozen=True)
class LastCompensation:
    """State of the controller's compensation after the last run that read it, according to the journal.

    `former` is the bank that was active before that run. `staged` is the bank that the run wrote, or None if the run
    wrote no bank. `unproved` is True if the run activated that table and left it unproved. `accepted` is True if the
    written table was accepted, and `restored` if the former one was reactivated.
    """

    run: int
    run_id: str
    former: RecordedBank
    staged: RecordedBank | None
    unproved: bool
    accepted: bool
    restored: bool

    @property
    def expected(self) -> RecordedBank:
        return self.staged if self.staged is not None and self.accepted else self.former

    @property
    def restore_command(self) -> str:
        """Command that writes the expected table again, in quotes."""
        role = "" if self.expected is self.former else " --role staged"
        return f"`volcal table restore {self.run_id}{role}`"


REST_WITHIN_S, REST_POLL_S = 10.0, 0.1
"""Longest wait for the end of a motion that was left to the controller, and interval of looking, in s."""


def reconcile(rig: Rig, state_directory: Path, *, of_run: int | None = None, restore: bool = True) -> Reconciliation:
    """Compare the controller's active compensation with the journal of earlier runs. If a table is active that was
    never proved by measurement, reactivate the table that was active before it.

    This former table is reactivated only if `restore` is set and the machine permits it. `rig` must be open; the
    machine does not move. If the controller refuses to reactivate it, the result says so. The comparison refers to the
    run with the number `of_run`. If `of_run` is None, it refers to the last run that read the compensation. Raises
    DeviceError if the controller cannot be read, and InputError if the journal cannot be read.
    """
    last = _last_compensation(state_directory, of_run)
    unfinished = unfinished_run(state_directory) if of_run is None else None
    active, waiting = rig.store.active_bank(), rig.store.pending_bank()
    if last is None:
        return Reconciliation(CompensationState.UNKNOWN, ReconcileAction.NOTHING, active, waiting, unfinished)
    if waiting is not None:
        return _waiting(rig, last, active, waiting, unfinished)
    state = _state(last, _active_bank(rig, active))
    # only then: a table is thousands of registers
    differs = state in (CompensationState.LOST, CompensationState.CHANGED)
    kept = differs and _active_bank(rig, last.expected.number) == last.expected
    if state is CompensationState.UNPROVED and restore:
        return _restored(rig, state_directory, last, active, unfinished)
    unrepaired = state in (CompensationState.UNPROVED, CompensationState.CHANGED, CompensationState.LOST)
    action = ReconcileAction.LEFT if unrepaired else ReconcileAction.NOTHING
    unproved = _unproved(last, unfinished) if state is CompensationState.UNPROVED else None
    instruction = _instruction(state, last, active, kept=kept) if unproved is None else unproved.way_out
    return Reconciliation(state, action, active, None, unfinished, instruction, unproved)


def compensation_left(rig: Rig, state_directory: Path) -> Reconciliation | None:
    """Return the comparison of the controller's active compensation with the journal, without any repair.

    Return None if the journal has no run to compare with, or if another process owns the machine and may be proving a
    table. `rig` must be open. Raises DeviceError if the controller cannot be read, and InputError if the journal cannot
    be read.
    """
    if not has_compensation_record(state_directory):
        return None
    try:
        with ownership(state_directory, "a comparison of the compensation with the journal"):
            return reconcile(rig, state_directory, restore=False)
    except Busy:
        return None


def unproved_table(state_directory: Path) -> UnprovedTable | None:
    """Return the table that the last run that read the compensation activated and neither accepted nor took back,
    according to the journal alone; None if there is none. Raises InputError if the journal cannot be read."""
    last = _last_compensation(state_directory, None)
    if last is None or not last.unproved:
        return None
    return _unproved(last, unfinished_run(state_directory))


def has_compensation_record(state_directory: Path) -> bool:
    """Return True if a run in the journal has read the controller's active compensation. Otherwise, the journal
    contains no state with which the controller could be compared."""
    return _last_compensation(state_directory, None) is not None


def _unproved(last: LastCompensation, unfinished: UnfinishedRun | None) -> UnprovedTable | None:
    if last.staged is None:
        return None
    provable = unfinished is not None and unfinished.run == last.run and unfinished.resumable
    return UnprovedTable(last.run_id, last.staged.number, last.former.number, provable)


def _instruction(state: CompensationState, last: LastCompensation, active: int, *, kept: bool) -> str:
    if state is CompensationState.LOST:
        number = last.expected.number
        cause = f"bank 0 is active instead of bank {number}, as after a power loss or a new start of the controller"
        if kept:
            return f"{cause}; bank {number} still holds its table: activate it at the controller, or calibrate again"
        return f"{cause}, and bank {number} no longer holds its table: restore it ({last.restore_command})"
    if state is not CompensationState.CHANGED:
        return ""
    if last.unproved and last.staged is not None:
        left = UnprovedTable(last.run_id, last.staged.number, last.former.number, provable=False)
        action = left.at_the_controller if kept else f"write the former table again ({last.restore_command})"
        return (
            f"run {last.run_id} ended with a table that was never proved, and neither this table nor the former one is "
            f"active: find out who activated bank {active}, or {action}"
        )
    number = last.expected.number
    if not kept:
        return (
            f"run {last.run_id} left bank {number} active, which holds another table now: find out who wrote it, then "
            f"restore the table ({last.restore_command}) or calibrate again"
        )
    return (
        f"run {last.run_id} left bank {number} active: find out who changed it, then activate bank {number} at the "
        "controller or calibrate again"
    )


def _state(last: LastCompensation, active: RecordedBank) -> CompensationState:
    if active == last.expected:
        complete = last.staged is None or last.accepted
        return CompensationState.AS_EXPECTED if complete else CompensationState.NOT_ACTIVATED
    if active == last.staged:
        return CompensationState.UNPROVED
    # a person who changes the compensation activates another table; a controller that starts anew has none active
    lost = active.number == 0 and not last.unproved
    return CompensationState.LOST if lost else CompensationState.CHANGED


def _active_bank(rig: Rig, active: int) -> RecordedBank:
    return RecordedBank.of_image(active, rig.store.read_table(active) if active else None)


def _waiting(
    rig: Rig, last: LastCompensation, active: int, waiting: int, unfinished: UnfinishedRun | None
) -> Reconciliation:
    """Return the result if the controller has accepted an activation but not yet carried it out.

    A restart of the controller and the next start of the agent complete it.
    """
    event = rig.store.store_limits().activation
    former = waiting == last.former.number
    instruction = f"{ACTIVATION_INSTRUCTION[event]}: bank {waiting} becomes active only after {ACTIVATED_AFTER[event]}"
    if not former and unfinished is not None:
        instruction += f"; then resume run {last.run_id}, which proves the table"
    action = ReconcileAction.RESTORE_WAITS if former else ReconcileAction.LEFT
    return Reconciliation(CompensationState.WAITING, action, active, waiting, unfinished, instruction)


def _restored(
    rig: Rig, state_directory: Path, last: LastCompensation, active: int, unfinished: UnfinishedRun | None
) -> Reconciliation:
    unproved = _unproved(last, unfinished)

    def unrestored(action: ReconcileAction, waiting: int | None, instruction: str, refused: str = "") -> Reconciliation:
        return Reconciliation(
            CompensationState.UNPROVED, action, active, waiting, unfinished, instruction, unproved, refused
        )

    former = last.former
    image = rig.store.read_table(former.number) if former.number else None
    if former.number and RecordedBank.of_image(former.number, image) != former:
        instruction = f"bank {former.number} no longer holds the former table: `volcal table restore` writes it"
        return unrestored(ReconcileAction.LEFT, None, instruction)
    _await_rest(rig)
    journal = Journal(state_directory)
    try:
        aside = journal.continue_run(last.run, last.run_id, rig.clock)[0].aside()
        engine = Engine(rig.actions(), aside)
        after_fault = rig.machine.status().state is MotionState.FAULT
        try:
            if not after_fault:
                engine.run(_permitted())
            activation = rig.store.store_limits().activation
            engine.run(publish.restore(former.number, after_fault=after_fault, activation=activation))
        except PermissionMissing as missing:
            return unrestored(ReconcileAction.LEFT, None, str(missing))
        except NotActiveYet as late:
            return unrestored(ReconcileAction.RESTORE_WAITS, former.number, f"{late.message}. {late.hint}")
        except DeviceError as error:
            if rig.store.active_bank() != former.number:  # otherwise only the answer of the controller was lost
                way_out = "" if unproved is None else unproved.way_out
                return unrestored(ReconcileAction.LEFT, None, way_out, error.message)
        aside.table("restored", former.number, image)
    finally:
        journal.close()
    # A run that was stopped is unfinished only as long as its table is active without a proof.
    left = None if unfinished is None else unfinished_run(state_directory)
    return Reconciliation(CompensationState.UNPROVED, ReconcileAction.RESTORED, former.number, None, left)


def _await_rest(rig: Rig) -> None:
    """Wait until a motion has ended that a killed process left to the watchdog of the controller; a controller that
    moves its axes refuses to activate a table."""
    deadline = Deadline.after(rig.clock, REST_WITHIN_S)
    while rig.machine.status().state is MotionState.MOVING and not deadline.expired:
        rig.clock.sleep(REST_POLL_S)


def _permitted() -> Plan[None]:
    yield CheckPermissions("reconcile/permissions")


def _last_compensation(state_directory: Path, of_run: int | None) -> LastCompensation | None:
    if not has_journal(state_directory):
        return None
    with open_journal(state_directory) as reader:
        return _read(reader, of_run)


def _read(reader: JournalReader, of_run: int | None) -> LastCompensation | None:
    backup = reader.last_backup(of_run)
    if backup is None:
        return None
    staged = reader.last_table(backup.run, "staged")
    return LastCompensation(
        run=backup.run,
        run_id=backup.run_id,
        former=RecordedBank.of_row(backup),
        staged=None if staged is None else RecordedBank.of_row(staged),
        unproved=left_unproved(reader, backup.run),
        accepted=reader.has_decision(backup.run, ACTIVATING_DECISIONS),
        restored=reader.last_table(backup.run, "restored") is not None,
    )
