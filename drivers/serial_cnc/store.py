"""Compensation store with two banks in files, for a controller without tables.

While a bank is active, the driver corrects commanded positions and removes the correction from latched positions.
`volcal gcode correct` corrects a part program in the same way. A verification therefore measures the accuracy of
corrected programs. A program that was not corrected runs without compensation.

The correction is interpolated as in a controller that stores tables: trilinearly between the nodes. Outside the grid,
the correction at the nearest point of the grid's border applies.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from drivers.errors import ChecksumMismatch, ReadBackMismatch, StoreError
from drivers.roles import Activation, StoreLimits, TableImage, Vector
from drivers.serial_cnc.bank_files import BankFiles
from drivers.serial_cnc.settings import BankSettings
from drivers.tables.checks import limits_violation, table_defect
from drivers.tables.text import counts_crc32

BANKS = (1, 2)
MAX_SLOPE = 0.1
"""Largest slope of a table in mm/mm.

It ensures that the inversion of a correction gains at least one digit per iteration.
"""
ITERATIONS = 8
"""Number of fixed-point iterations of the inverse.

The slope of a table is far below 1 (the gates allow 0.5 µm/mm), so each iteration gains three digits or more.
"""


class BankStore:
    """Compensation store in files.

    The function `require_rest` must raise an error if an axis is moving, because an activation during a motion would
    make the displayed position jump.
    """

    def __init__(
        self, settings: BankSettings, files: BankFiles, where: Mapping[str, str], require_rest: Callable[[], None]
    ) -> None:
        most = settings.max_nodes
        self._limits = StoreLimits(
            banks=BANKS,
            max_nodes=(most, most, most),
            max_total_nodes=settings.max_total_nodes,
            resolution_mm=settings.resolution_mm,
            max_correction_mm=settings.max_correction_mm,
            activation=Activation.IMMEDIATE,
        )
        self._files = files
        self._where = where
        self._require_rest = require_rest
        self._active = 0
        self.correction = Correction(None)

    def open(self) -> None:
        """Load the table of the active bank.

        Raises StoreError if the file is missing, or if its table is not the one that was activated.
        """
        bank, crc = self._files.active()
        self._active, self.correction = bank, Correction(self._verified_table(bank, crc) if bank else None)

    def store_limits(self) -> StoreLimits:
        return self._limits

    def active_bank(self) -> int:
        return self._active

    def pending_bank(self) -> int | None:
        """Return None, because an activation takes effect at once."""
        return None

    def read_table(self, bank: int) -> TableImage | None:
        if bank == 0:
            return None
        self._require_known(bank)
        return self._files.read(bank)

    def stage(self, bank: int, table: TableImage) -> None:
        self._require_known(bank)
        if bank == self._active:
            raise self._error(f"bank {bank} is active and cannot be written", hint="stage into another bank")
        objection = limits_violation(self._limits, table) or table_defect(table, MAX_SLOPE)
        if objection:
            raise self._error(objection)
        self._files.write(bank, table)
        back = self._files.read(bank)
        if back is None or not back.same_as(table):
            raise ReadBackMismatch(
                f"bank {bank} reads back differently from what was written",
                hint="do not activate it; stage it again",
                bank=bank,
                **self._where,
            )

    def activate(self, bank: int) -> None:
        """Read the table of `bank` from its file, check its CRC-32, record the bank as active, and only then use the
        table.
        """
        table = None
        if bank != 0:
            self._require_known(bank)
            table = self._files.read(bank)
            if table is None:
                raise self._error(f"bank {bank} holds no table", hint="stage it first")
        self._require_rest()
        self._files.set_active(bank, counts_crc32(table.counts) if table is not None else 0)
        self._active, self.correction = bank, Correction(table)

    def _verified_table(self, bank: int, crc: int) -> TableImage:
        if bank not in BANKS:
            raise self._error(f"bank {bank} is recorded as active, but there is no such bank")
        table = self._files.read(bank)
        if table is None:
            raise self._error(
                f"bank {bank} is active, but its file is missing", hint="restore it, or remove the file 'active'"
            )
        if counts_crc32(table.counts) != crc:
            raise ChecksumMismatch(
                f"bank {bank} is active with CRC-32 {crc:08x}, its file has {counts_crc32(table.counts):08x}",
                hint="another program has changed the file; restore it, or remove the file 'active'",
                bank=bank,
                **self._where,
            )
        return table

    def _require_known(self, bank: int) -> None:
        if bank not in BANKS:
            raise self._error(f"no bank {bank}; there are {BANKS}")

    def _error(self, text: str, hint: str = "") -> StoreError:
        return StoreError(text, hint=hint, **self._where)


class Correction:
    """Correction that a compensation table defines. Without a table, the correction is zero.

    The grid of the table and the positions are displayed axis positions in mm.
    """

    def __init__(self, table: TableImage | None) -> None:
        self._table = table
        if table is not None:
            self._values = table.counts.astype(np.float64) * table.resolution_mm
            self._origin = np.array(table.origin_mm)
            self._step = np.array(table.step_mm)
            self._last = np.array(table.shape) - 1

    def at(self, position_mm: Vector) -> Vector:
        """Return the correction in mm, shape (3,), at the displayed axis position `position_mm`."""
        if self._table is None:
            return np.zeros(3)
        # Grid coordinates, limited to the grid; `cell` is the lower node of the cell, `share` the position within it.
        steps = np.clip((position_mm - self._origin) / self._step, 0.0, self._last)
        cell = np.minimum(steps.astype(np.intp), np.maximum(self._last - 1, 0))
        share = steps - cell
        upper = np.minimum(cell + 1, self._last)
        values = self._values[cell[0] : upper[0] + 1, cell[1] : upper[1] + 1, cell[2] : upper[2] + 1]
        # Trilinear interpolation, one axis after the other: v = v0 + share (v1 - v0).
        for axis in range(3):
            first = values[0]
            values = first + share[axis] * (values[-1] - first)
        result: Vector = values
        return result

    def apply(self, position_mm: Vector) -> Vector:
        """Return the commanded axis position for the displayed axis position `position_mm`: commanded = displayed +
        correction(displayed).
        """
        return position_mm + self.at(position_mm)

    def remove(self, sent_mm: Vector) -> Vector:
        """Return the displayed position for a commanded position, as the inverse of `apply`.

        The result is found by the fixed-point iteration displayed = commanded - correction(displayed).
        """
        if self._table is None:
            return sent_mm
        displayed = sent_mm
        for _ in range(ITERATIONS):
            displayed = sent_mm - self.at(displayed)
        return displayed
