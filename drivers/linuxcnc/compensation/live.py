"""Compensation store whose banks are loaded and activated while LinuxCNC runs.

The corrections are applied either by external offsets or by volcal's own kinematics module. In both cases the HAL
component `volcal_tables` (the loader) loads and activates the tables; this module uses only the pins of the loader.
"""

from __future__ import annotations

from collections.abc import Callable

from drivers.clock import Clock, Deadline
from drivers.errors import ChecksumMismatch, CommandRejected, DeadlineExpired, ReadBackMismatch, StoreError
from drivers.linuxcnc.compensation.banks import Banks
from drivers.linuxcnc.pins import Pins, PinValue
from drivers.roles import DiagnosticFinding, StoreLimits, TableImage
from drivers.tables.text import counts_crc32

POLL_S = 0.01
COMPLETE, DAMAGED = 1, 2
BANK_USED, CRC_DIFFERS, NO_FILE = 2, 5, 3
RESULTS = {
    1: "no such bank",
    BANK_USED: "the bank is in use",
    NO_FILE: "the table file cannot be read: wrong directory, or no permission",
    4: "the table file is malformed",
    CRC_DIFFERS: "CRC-32 differs",
    6: "a correction is too large or too steep for the loader",
    7: "the bank holds no table",
}
FAULTS = {
    1: "the components share no memory: another version is running",
    2: "the selected bank is empty",
    3: "the active table was damaged; its last correction is held",
}
FAULTS_WITHOUT_BANK = (1, 3)


class LiveStore:
    """Compensation store whose tables LinuxCNC loads and activates while it runs.

    The store is controlled through the pins of the HAL component `volcal_tables` (the loader), which loads and
    activates the tables.
    """

    def __init__(self, pins: Pins, banks: Banks, clock: Clock, within_s: float) -> None:
        self._pins = pins
        self._banks = banks
        self._clock = clock
        self._within_s = within_s

    def store_limits(self) -> StoreLimits:
        return self._banks.limits

    def active_bank(self) -> int:
        """Return the number of the active bank, whose table corrects the motion; 0 means no compensation.

        Raises StoreError if the loader (the HAL component `volcal_tables`) reports a fault that leaves no bank active.
        These faults are listed in `FAULTS_WITHOUT_BANK`.
        """
        fault = int(self._get("acting-fault"))
        if fault in FAULTS_WITHOUT_BANK:
            raise self._banks.error(FAULTS[fault], hint="activate bank 0, then check the controller")
        return int(self._get("acting-bank"))

    def pending_bank(self) -> int | None:
        return None

    def read_table(self, bank: int) -> TableImage | None:
        """Return the compensation table in the file of `bank`; None for bank 0 (no compensation) or an empty bank.

        Raises ChecksumMismatch if the file differs from the table in the memory of the controller.
        """
        if bank == 0:
            return None
        self._banks.require_known(bank)
        state = int(self._get(f"bank{bank}-state"))
        if state == DAMAGED:
            raise self._mismatch(f"the table of bank {bank} is damaged in the controller's memory")
        if state != COMPLETE:
            if bank == int(self._get("acting-bank")):
                raise self._banks.error(f"the active bank {bank} holds no complete table")
            return None
        table = self._banks.read(bank)
        if table is None or counts_crc32(table.counts) != int(self._get(f"bank{bank}-crc")):
            raise self._mismatch(f"the file of bank {bank} does not match the table in the controller's memory")
        return table

    def stage(self, bank: int, table: TableImage) -> None:
        """Write a table to the file of an inactive bank, load the file into the controller, and read the table back.

        The file is loaded by the HAL component `volcal_tables` (the loader). Raises StoreError if the bank is active or
        the table is refused, and ReadBackMismatch if the table is read back differently.
        """
        active, selected = int(self._get("acting-bank")), int(self._get("bank"))
        self._banks.require_stageable(bank, table, (active, selected))
        self._require_alive()
        self._banks.write(bank, table)
        self._request("load", {"load-bank": bank}, bank)
        back = self.read_table(bank)
        if back is None or not back.same_as(table):
            raise ReadBackMismatch(
                f"bank {bank} reads back differently from what was written",
                hint="do not activate it; stage it again",
                bank=bank,
                **self._banks.where,
            )

    def activate(self, bank: int) -> None:
        """Activate a bank of the store, so that its table corrects the motion, and wait until it is active.

        The bank is activated by the HAL component `volcal_tables` (the loader). The bank is first armed with the CRC-32
        of its table. The activation is then confirmed with a number that the loader has issued for this activation only
        (a nonce). If the loader is applying corrections to the axes, the method also waits until the axes have settled
        at the new correction.
        """
        self._require_alive()
        crc = 0
        if bank != 0:
            table = self.read_table(bank)
            if table is None:
                raise self._banks.error(f"bank {bank} holds no complete table", hint="stage it first")
            crc = counts_crc32(table.counts)
        self._request("arm", {"arm-bank": bank, "arm-crc": crc}, bank)
        nonce = int(self._get("armed-nonce"))
        if nonce == 0 or int(self._get("armed-bank")) != bank:
            raise self._banks.error(f"bank {bank} was not armed", hint="another program switches banks; try again")
        self._set("confirm-nonce", nonce)
        self._await(lambda: int(self._get("bank")) == bank, f"bank {bank} to be selected")
        self._await(lambda: self._is_active(bank), f"bank {bank} to become active and settle")

    def diagnose(self) -> list[DiagnosticFinding]:
        """Report the state of the loader (the HAL component `volcal_tables`), the active table and the faults.

        Nothing is written.
        """
        subject = "compensation"
        try:
            self._require_alive()
        except StoreError as error:
            return [DiagnosticFinding(subject, ok=False, text=str(error))]
        fault = int(self._get("acting-fault"))
        bank, crc = int(self._get("acting-bank")), int(self._get("acting-crc"))
        applied = "applied" if self._get("acting") else "not applied while the machine is off or not homed"
        age_s = float(self._get("age"))
        text = f"bank {bank}, CRC-32 {crc:08X}, loaded {age_s:.0f} s ago, {applied}" if bank else "no table is active"
        findings = [DiagnosticFinding(subject, ok=fault == 0, text=FAULTS.get(fault, text))]
        if self._get("limited"):
            text = "an axis is at its soft limit, where LinuxCNC cuts off the offset; move it inwards"
            findings.append(DiagnosticFinding(subject, ok=False, text=text))
        if self._get("table-lost"):
            text = "the table active before the restart is lost, so nothing is compensated: restore it"
            findings.append(DiagnosticFinding(subject, ok=False, text=text))
        return findings

    def _is_active(self, bank: int) -> bool:
        fault = int(self._get("acting-fault"))
        if fault in FAULTS_WITHOUT_BANK and int(self._get("acting-bank")) == bank:
            raise self._banks.error(FAULTS[fault])
        settled = bool(self._get("settled")) or not self._get("acting")
        return settled and int(self._get("acting-bank")) == bank

    def _request(self, name: str, operands: dict[str, int], bank: int) -> None:
        """Send the request `name` to the loader and wait until it is done.

        Raises StoreError or ChecksumMismatch if the loader refuses the request.

        The operands are set first, then a new sequence number; the request is done once the loader shows that number.
        """
        for pin, value in operands.items():
            self._set(pin, value)
        sequence = (int(self._get(f"{name}-done")) + 1) & 0xFFFFFFFF
        self._set(f"{name}-sequence", sequence)
        self._await(lambda: int(self._get(f"{name}-done")) == sequence, f"volcal_tables to answer ({name})")
        result = int(self._get(f"{name}-result"))
        if result == 0:
            return
        kind = ChecksumMismatch if result == CRC_DIFFERS else StoreError
        raise kind(
            f"volcal_tables refuses to {name} bank {bank}: {RESULTS.get(result, f'result {result}')}",
            hint="the active table is unchanged",
            bank=bank,
            **self._banks.where,
        )

    def _require_alive(self) -> None:
        beat = self._get("beat")
        try:
            self._await(lambda: self._get("beat") != beat, "the loader's heartbeat")
        except DeadlineExpired as silent:
            raise self._banks.error(
                "the loader volcal_tables no longer runs; the active table remains active and cannot be changed",
                hint="restart LinuxCNC",
            ) from silent

    def _await(self, reached: Callable[[], bool], awaited: str) -> None:
        deadline = Deadline.after(self._clock, self._within_s)
        while not reached():
            deadline.raise_if_expired(awaited, hint="check the log of LinuxCNC", **self._banks.where)
            self._clock.sleep(POLL_S)

    def _get(self, pin: str) -> PinValue:
        try:
            return self._pins.get(f"volcal-tables.{pin}")
        except CommandRejected as missing:
            raise self._banks.error(
                f"LinuxCNC has no pin volcal-tables.{pin}",
                hint="load the compensation's HAL file: docs/explanation/linuxcnc-compensation.md",
            ) from missing

    def _set(self, pin: str, value: int) -> None:
        self._pins.set(f"volcal-tables.{pin}", value)

    def _mismatch(self, text: str) -> ChecksumMismatch:
        return ChecksumMismatch(text, hint="stage the table again", **self._banks.where)
