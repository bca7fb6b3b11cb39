"""Compensation store that uses the screw-compensation files of LinuxCNC.

LinuxCNC reads these files when it starts. It then corrects each axis as a function of the position of this axis only;
this is the own-axis part of a table. The rest of the table, which depends on the positions of the other axes, is lost.
The directory of the store contains the following files for each bank, and one link:

::

    bank1.table                 the whole table as it was staged
    bank1/x.comp y.comp z.comp  own-axis part of this table, COMP_FILE_TYPE = 0
    bank1/bank.hal              HAL signals with the number of the bank and the CRC-32 of its table
    acting -> bank1             link named in the INI file; activation changes only this link
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drivers.errors import ChecksumMismatch, CommandRejected, StoreError
from drivers.foreign_errors import cause_of
from drivers.linuxcnc.compensation.banks import Banks
from drivers.linuxcnc.pins import Pins
from drivers.roles import DiagnosticFinding, StoreLimits, TableImage
from drivers.tables.files import read_if_exists, sync_directory, write_atomically
from drivers.tables.text import counts_crc32

ACTIVE_LINK = "acting"
BANK_SIGNAL, CRC_SIGNAL = "volcal-comp-bank", "volcal-comp-crc"
SETUP_HINT = "set up the INI and HAL files as described in docs/explanation/linuxcnc-compensation.md"
Values = NDArray[np.float64]


class CompFileStore:
    """Compensation store that uses screw-compensation files and a symbolic link to the selected bank of tables.

    The selected bank becomes active at the next start of LinuxCNC.
    """

    def __init__(self, pins: Pins, banks: Banks, accepted_loss_mm: float) -> None:
        self._pins = pins
        self._banks = banks
        self._accepted_loss_mm = accepted_loss_mm

    def store_limits(self) -> StoreLimits:
        return replace(self._banks.limits, own_axis_loss_mm=self._accepted_loss_mm)

    def active_bank(self) -> int:
        """Return the number of the bank of tables that was selected when LinuxCNC was started."""
        return self._signal(BANK_SIGNAL)

    def pending_bank(self) -> int | None:
        chosen = self._selected_bank()
        return None if chosen == self.active_bank() else chosen

    def read_table(self, bank: int) -> TableImage | None:
        """Return the whole table of an inactive bank as it was staged (written); None for bank 0 (no compensation) or
        an empty bank. Of the table in the active bank, return the part that LinuxCNC applies: its own-axis part.

        For the active bank, the method raises ChecksumMismatch if LinuxCNC was started with a different table, and
        StoreError if there is no table.
        """
        if bank == 0:
            return None
        self._banks.require_known(bank)
        table = self._banks.read(bank)
        if bank != self.active_bank():
            return table
        if table is None:
            raise self._banks.error(f"the active bank {bank} holds no table")
        if counts_crc32(table.counts) != self._signal(CRC_SIGNAL):
            raise self._mismatch(f"bank {bank} is not what LinuxCNC was started with")
        return _applied_image(table)

    def stage(self, bank: int, table: TableImage) -> None:
        """Write the whole table and its own-axis part to the files of an inactive bank.

        The own-axis part, in which the correction of each axis depends only on the position of this axis, is the only
        part that LinuxCNC applies. Raises StoreError if the rest of the table is larger than the settings accept.
        """
        self._banks.require_stageable(bank, table, (self.active_bank(), self._selected_bank()))
        part = own_axis_part(table)
        self._require_acceptable(part)
        folder = self._banks.directory / f"bank{bank}"
        try:
            folder.mkdir(exist_ok=True)
        except OSError as error:
            raise self._banks.error(f"cannot create {folder}: {cause_of(error)}") from error
        self._banks.write(bank, table)
        for name, text in _bank_texts(bank, table).items():
            write_atomically(folder / name, text)

    def activate(self, bank: int) -> None:
        """Select the bank that becomes active at the next start of LinuxCNC.

        All files of the bank are verified first. A new symbolic link to the bank is then created and renamed over the
        old one. Raises StoreError if the bank is empty or the link cannot be replaced, and ChecksumMismatch if a file
        of the bank does not match its table.
        """
        if bank == self._selected_bank():
            return
        if bank != 0:
            self._verify(bank)
        elif not (self._banks.directory / "bank0").is_dir():
            raise self._banks.error("the directory bank0 (no compensation) is missing", hint=SETUP_HINT)
        armed = self._banks.directory / f"{ACTIVE_LINK}.part"
        try:
            armed.unlink(missing_ok=True)
            armed.symlink_to(f"bank{bank}")
            armed.replace(self._link)
            sync_directory(self._banks.directory)
        except OSError as error:
            raise self._banks.error(f"cannot replace the link {self._link}: {cause_of(error)}") from error

    def diagnose(self) -> list[DiagnosticFinding]:
        """Report the active bank, the pending bank, and the part of the active table that LinuxCNC does not apply.

        Nothing is written.
        """
        subject = "compensation"
        try:
            active, pending = self.active_bank(), self.pending_bank()
            self.read_table(active)  # raises an error if it is not what LinuxCNC was started with
            table = self._banks.read(active) if active else None
        except StoreError as error:
            return [DiagnosticFinding(subject, ok=False, text=str(error))]
        text = f"bank {active} is active, joint by joint" if active else "no table is active"
        pending_text = "" if pending is None else f"; bank {pending} waits for a restart of LinuxCNC"
        findings = [DiagnosticFinding(subject, ok=True, text=text + pending_text)]
        if table is not None:
            lost_um = own_axis_part(table).lost_mm * 1e3
            findings.append(
                DiagnosticFinding(subject, ok=True, text=f"up to {lost_um:.1f} µm of its table have no effect")
            )
        return findings

    def _verify(self, bank: int) -> None:
        self._banks.require_known(bank)
        table = self._banks.read(bank)
        if table is None:
            raise self._banks.error(f"bank {bank} holds no table", hint="stage it first")
        folder = self._banks.directory / f"bank{bank}"
        for name, text in _bank_texts(bank, table).items():
            if read_if_exists(folder / name) != text:
                raise self._mismatch(f"{folder / name} does not match the table of bank {bank}")

    def _require_acceptable(self, part: OwnAxisPart) -> None:
        if part.lost_mm <= self._accepted_loss_mm + 0.5 * self._banks.limits.resolution_mm:
            return
        raise self._banks.error(
            f"screw-compensation files correct each joint separately; {part.lost_mm * 1e3:.1f} µm of this table would "
            f"be lost, {self._accepted_loss_mm * 1e3:.1f} µm are accepted",
            hint="compensate by external offsets or kinematics, or raise accepted_loss_um",
        )

    @property
    def _link(self) -> Path:
        return self._banks.directory / ACTIVE_LINK

    def _selected_bank(self) -> int:
        """Return the bank that becomes active at the next start."""
        try:
            name = self._link.readlink().name
        except OSError as error:
            raise self._banks.error(f"there is no link {self._link}", hint=SETUP_HINT) from error
        if name not in ("bank0", "bank1", "bank2"):
            raise self._banks.error(f"the link {self._link} leads to {name}, which is not a bank", hint=SETUP_HINT)
        return int(name.removeprefix("bank"))

    def _signal(self, name: str) -> int:
        try:
            return int(self._pins.get(name))
        except CommandRejected as missing:
            raise self._banks.error(f"LinuxCNC has no signal {name}", hint=SETUP_HINT) from missing

    def _mismatch(self, text: str) -> ChecksumMismatch:
        return ChecksumMismatch(text, hint="stage the table again", **self._banks.where)


def _bank_texts(bank: int, table: TableImage) -> dict[str, str]:
    """Return the texts of the files that LinuxCNC reads for this bank, by file name."""
    part = own_axis_part(table)
    files = {
        f"{letter}.comp": _comp_text(nominal.tolist(), correction.tolist())
        for letter, nominal, correction in zip("xyz", part.nominal_mm, part.correction_mm, strict=True)
    }
    files["bank.hal"] = (
        f"newsig {BANK_SIGNAL} u32\nsets {BANK_SIGNAL} {bank}\n"
        f"newsig {CRC_SIGNAL} u32\nsets {CRC_SIGNAL} {counts_crc32(table.counts)}\n"
    )
    return files


def _comp_text(nominal_mm: list[float], correction_mm: list[float]) -> str:
    """Return the text of a type 0 file: lines of nominal, forward and reverse position.

    LinuxCNC adds (nominal - position) to the motor command, so position = nominal - correction, with corrections in mm.
    """
    if len(nominal_mm) == 1:
        nominal_mm, correction_mm = [nominal_mm[0], nominal_mm[0] + 1.0], correction_mm * 2
    rows = zip(nominal_mm, correction_mm, strict=True)
    return "".join(f"{at:.9f} {at - shift:.9f} {at - shift:.9f}\n" for at, shift in rows)


@dataclass(frozen=True)
class OwnAxisPart:
    """Own-axis part of a compensation table: the correction of each axis as a function of its own position only.

    `nominal_mm` contains the node positions of each axis in the grid of the table. `correction_mm` contains the
    corrections along the axis at these positions. Each correction is the mean over all grid nodes that have this
    position of the axis, which is the least-squares fit over the grid. `lost_mm` is the largest absolute difference
    between the table and this fit.
    """

    nominal_mm: tuple[Values, Values, Values] = field(repr=False)
    correction_mm: tuple[Values, Values, Values] = field(repr=False)
    lost_mm: float


def _applied_image(table: TableImage) -> TableImage:
    """Return the table whose corrections are those of the own-axis part of `table`, in whole counts."""
    counts = np.empty_like(table.counts)
    for axis, correction in enumerate(own_axis_part(table).correction_mm):
        along = np.rint(correction / table.resolution_mm).astype(np.int32)
        counts[..., axis] = along.reshape([-1 if other == axis else 1 for other in range(3)])
    return replace(table, counts=counts)


def own_axis_part(table: TableImage) -> OwnAxisPart:
    """Return the own-axis part of a compensation table: each correction depends on the position of its axis only.

    The part of a correction that depends on the positions of the other axes is lost; its largest value is returned,
    too.
    """
    corrections = table.counts.astype(np.float64) * table.resolution_mm
    nominal, along, lost = [], [], 0.0
    for axis in range(3):
        others = tuple(other for other in range(3) if other != axis)
        # c_a(x_a) = mean of the correction along axis a over the other two axes; the remainder is |c - c_a|.
        mean = corrections[..., axis].mean(axis=others, keepdims=True)
        lost = max(lost, float(np.abs(corrections[..., axis] - mean).max()))
        nominal.append(table.origin_mm[axis] + table.step_mm[axis] * np.arange(table.shape[axis], dtype=np.float64))
        along.append(mean.ravel())
    return OwnAxisPart((nominal[0], nominal[1], nominal[2]), (along[0], along[1], along[2]), lost)
