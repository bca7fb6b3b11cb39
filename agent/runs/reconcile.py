"""At a start: what the last run has left in the controller against what its journal says, and what is to be done.

A new table that acts and was never proved is the one state that must not stay: the former table is made to act again.
Everything else is complete and consistent whatever instant the run ended at, because a bank that acts is never written.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from agent.execution.encoding import table_digest
from agent.execution.engine import Engine
from agent.execution.journal import Journal
from agent.execution.journal_reader import JournalReader, has_journal, open_journal
from agent.execution.rig import AFTER, DO, Rig
from agent.execution.steps import CheckPermissions, Plan
from agent.probing import publish
from agent.runs.reconcile_result import Done, Found, Reconciliation
from agent.runs.reference_state import ACTIVATING_DECISIONS
from agent.runs.unfinished_run import UnfinishedRun, unfinished_run
from drivers.errors import NotActiveYet, PermissionMissing
from drivers.roles import MotionState


@dataclass(frozen=True)
class Bank:
    """A bank and the CRC-32 of what the journal says that it holds; None: nothing, as bank 0."""

    number: int
    crc32: int | None


@dataclass(frozen=True)
class Left:
    """What the last run that read the compensation has left, by its journal."""

    run: int
    run_id: str
    former: Bank
    staged: Bank | None
    accepted: bool

    @property
    def expected(self) -> Bank:
        return self.staged if self.staged is not None and self.accepted else self.former


def reconcile(rig: Rig, state_directory: Path, *, of_run: int | None = None, restore: bool = True) -> Reconciliation:
    """Compare, and where `restore` and the machine permits it make the former table act again instead of an unproved
    one. `rig` is open; nothing moves. `of_run`: look at this run only.

    Raises DeviceError where the controller cannot be asked or refuses, InputError where the journal cannot be read.
    """
    left = _left(state_directory, of_run)
    unfinished = unfinished_run(state_directory) if of_run is None else None
    active, waiting = rig.store.active_bank(), rig.store.pending_bank()
    if left is None:
        return Reconciliation(Found.UNKNOWN, Done.NOTHING, active, waiting, unfinished)
    if waiting is not None:
        return _waiting(rig, left, active, waiting, unfinished)
    found = _found(left, _acting(rig, active))
    if found is Found.UNPROVED and restore:
        return _restored(rig, state_directory, left, active, unfinished)
    done = Done.LEFT if found in (Found.UNPROVED, Found.CHANGED) else Done.NOTHING
    return Reconciliation(found, done, active, None, unfinished, _person(found, left))


def anything_left(state_directory: Path) -> bool:
    """Whether any run of the journal has ever read the compensation; without one there is nothing to compare with."""
    return _left(state_directory, None) is not None


def _person(found: Found, left: Left) -> str:
    match found:
        case Found.UNPROVED:
            return f"go on with run {left.run_id} to prove the table, or have the former one restored"
        case Found.CHANGED:
            expected = left.expected.number
            return f"run {left.run_id} left bank {expected} active: look who changed it, then calibrate anew"
        case _:
            return ""


def _found(left: Left, acting: Bank) -> Found:
    if acting == left.expected:
        return Found.AS_EXPECTED if left.staged is None or left.accepted else Found.NOT_ACTIVATED
    return Found.UNPROVED if acting == left.staged else Found.CHANGED


def _acting(rig: Rig, active: int) -> Bank:
    image = rig.store.read_table(active) if active else None
    return Bank(active, None if image is None else table_digest(image))


def _waiting(rig: Rig, left: Left, active: int, waiting: int, unfinished: UnfinishedRun | None) -> Reconciliation:
    """The controller has been told and has not done it: a restart of it, and the next start completes it."""
    event = rig.store.store_limits().activation
    former = waiting == left.former.number
    person = f"{DO[event]}: bank {waiting} acts only after {AFTER[event]}"
    if not former and unfinished is not None:
        person += f"; then go on with run {left.run_id}, which proves the table"
    done = Done.RESTORE_WAITS if former else Done.LEFT
    return Reconciliation(Found.WAITING, done, active, waiting, unfinished, person)


def _restored(
    rig: Rig, state_directory: Path, left: Left, active: int, unfinished: UnfinishedRun | None
) -> Reconciliation:
    former = left.former
    image = rig.store.read_table(former.number) if former.number else None
    if former.number and (image is None or table_digest(image) != former.crc32):
        person = f"bank {former.number} does not hold the former table any more: `volcal table restore` writes it"
        return Reconciliation(Found.UNPROVED, Done.LEFT, active, None, unfinished, person)
    journal = Journal(state_directory)
    try:
        aside = journal.continue_run(left.run, left.run_id, rig.clock)[0].aside()
        engine = Engine(rig.actions(), aside)
        after_fault = rig.machine.status().state is MotionState.FAULT
        try:
            if not after_fault:
                engine.run(_permitted())
            activation = rig.store.store_limits().activation
            engine.run(publish.restore(former.number, after_fault=after_fault, activation=activation))
        except PermissionMissing as missing:
            return Reconciliation(Found.UNPROVED, Done.LEFT, active, None, unfinished, str(missing))
        except NotActiveYet as late:
            return Reconciliation(
                Found.UNPROVED, Done.RESTORE_WAITS, active, former.number, unfinished, f"{late.message}. {late.hint}"
            )
        aside.table("restored", former.number, image)
    finally:
        journal.close()
    return Reconciliation(Found.UNPROVED, Done.RESTORED, former.number, None, unfinished)


def _permitted() -> Plan[None]:
    yield CheckPermissions("reconcile/permissions")


def _left(state_directory: Path, of_run: int | None) -> Left | None:
    if not has_journal(state_directory):
        return None
    with open_journal(state_directory) as reader:
        return _read(reader, of_run)


def _read(reader: JournalReader, of_run: int | None) -> Left | None:
    backup = reader.last_backup(of_run)
    if backup is None:
        return None
    staged = reader.last_table(backup.run, "staged")
    return Left(
        run=backup.run,
        run_id=backup.run_id,
        former=Bank(backup.bank, backup.crc32),
        staged=None if staged is None else Bank(staged.bank, staged.crc32),
        accepted=reader.has_decision(backup.run, ACTIVATING_DECISIONS),
    )
