"""Plans that write a compensation table to an inactive bank, read it back, compare it, activate the bank, and check
that it is active."""

from __future__ import annotations

from dataclasses import dataclass

from agent.execution.encoding import is_same_table, table_digest
from agent.execution.steps import (
    ActivateBank,
    AwaitActive,
    Plan,
    ReadActiveBank,
    ReadTable,
    Record,
    ResetFault,
    StageTable,
)
from drivers.errors import ReadBackMismatch, StoreError
from drivers.roles import Activation, TableImage


@dataclass(frozen=True)
class ActiveCompensation:
    """Active compensation. `bank` is the number of the controller's active bank, or 0 if there is no compensation.
    `table` is the table in that bank, or None if `bank` is 0."""

    bank: int
    table: TableImage | None


def read_state(prefix: str) -> Plan[ActiveCompensation]:
    """Read the number of the controller's active bank and the compensation table in it. Both are needed to restore the
    compensation after a fault. Raises StoreError if the active bank contains no table.

    Bank 0 is read as empty, so that the steps are the same with and without compensation.
    """
    bank = yield ReadActiveBank(f"{prefix}/active-bank")
    table = yield ReadTable(f"{prefix}/active-table", bank)
    if bank and table is None:
        raise StoreError(f"bank {bank} is active but holds no table", hint="check the banks on the controller")
    return ActiveCompensation(bank, table)


def choose_bank(banks: tuple[int, ...], active: int) -> int:
    """Return a bank of `banks` that is inactive and can be written. Bank 0 means no compensation and is never written.
    Raises StoreError if no such bank exists."""
    free = [bank for bank in banks if bank not in (0, active)]
    if not free:
        raise StoreError(
            f"no inactive bank to write: the controller has {list(banks)}, bank {active} is active",
            hint="a store needs two banks, so that the old table stays until the new one is proved",
        )
    return free[0]


def stage_table(bank: int, table: TableImage) -> Plan[None]:
    """Write `table` to the inactive `bank`, read it back and compare every value. Raises ReadBackMismatch if a value
    differs."""
    yield StageTable("publish/stage", bank, table)
    back = yield ReadTable("publish/read-back", bank)
    if back is None or not back.same_as(table):
        raise ReadBackMismatch(
            f"bank {bank} reads back differently from what was written",
            hint="the bank is not activated; run `volcal doctor` on the link",
        )
    yield Record("publish/staged", "decision", {"bank": bank, "crc32": table_digest(table)})


def restore(bank: int, *, after_fault: bool, activation: Activation = Activation.IMMEDIATE) -> Plan[None]:
    """Reactivate the compensation table in `bank`, which was active before the run. If `after_fault` is set, the
    controller's fault is cleared first, because a controller in fault accepts no table command."""
    if after_fault:
        yield ResetFault("restore/reset")
    yield from activate("restore", bank, activation)


def read_restored(bank: int) -> Plan[ActiveCompensation]:
    """Read the table in `bank`, which has been reactivated. It may differ from the one that was found there before: the
    bank was inactive meanwhile, and anybody could write to it."""
    table = yield ReadTable("restore/active-table", bank)
    return ActiveCompensation(bank, table)


def require_as_found(found: ActiveCompensation, held: ActiveCompensation) -> None:
    """Raise ReadBackMismatch if the reactivated bank contains another table than before the run. `found` is the
    compensation before the run, `held` the one after its reactivation."""
    if not is_same_table(found.table, held.table):
        raise ReadBackMismatch(
            f"bank {found.bank} holds another table than before the run",
            hint="it was written meanwhile: find out by whom, or write the former table with `volcal table restore`",
        )


def activate(prefix: str, bank: int, activation: Activation = Activation.IMMEDIATE) -> Plan[None]:
    """Activate the controller's compensation bank `bank` and check that it is active. Raises ReadBackMismatch if the
    controller reports a different active bank.

    Raises NotActiveYet if a person must act before the bank becomes active. The plan can be resumed after the person
    has acted.
    """
    yield ActivateBank(f"{prefix}/activate", bank)
    if activation is Activation.RESET:
        yield ResetFault(f"{prefix}/reset-to-take-effect")
    if activation is not Activation.IMMEDIATE:
        yield AwaitActive(f"{prefix}/takes-effect", bank)
    active = yield ReadActiveBank(f"{prefix}/active-bank")
    if active != bank:
        raise ReadBackMismatch(
            f"bank {bank} was activated, but the controller reports that bank {active} is active",
            hint="check the controller before measuring or machining",
        )
    yield Record(f"{prefix}/activated", "decision", {"bank": bank})
