"""Common part of the three methods of compensation in LinuxCNC: two banks of tables, their files and their limits."""

from __future__ import annotations

from pathlib import Path

from drivers.errors import StoreError
from drivers.linuxcnc.compensation.settings import CompensationSettings
from drivers.roles import Activation, StoreLimits, TableImage
from drivers.tables.checks import limits_violation, table_defect
from drivers.tables.files import read_if_exists, write_atomically
from drivers.tables.text import format_table, parse_table

BANKS = (1, 2)
MAX_NODES = (256, 256, 256)
MAX_TOTAL_NODES = 262_144
MAX_SLOPE = 0.1
"""Largest slope of a table in mm/mm, the same as in the loader `volcal_tables`.

The iteration of the forward kinematics converges only for small slopes.
"""


class Banks:
    """Banks (numbered storage places) of compensation tables; the table of each bank is stored in one file."""

    def __init__(self, settings: CompensationSettings, directory: Path, activation: Activation, device: str) -> None:
        self.directory = directory
        self.limits = StoreLimits(
            banks=BANKS,
            max_nodes=MAX_NODES,
            max_total_nodes=MAX_TOTAL_NODES,
            resolution_mm=settings.resolution_um * 1e-3,
            max_correction_mm=settings.max_correction_mm,
            activation=activation,
        )
        self._device = device

    def path(self, bank: int) -> Path:
        return self.directory / f"bank{bank}.table"

    def write(self, bank: int, table: TableImage) -> None:
        write_atomically(self.path(bank), format_table(table))

    def read(self, bank: int) -> TableImage | None:
        """Return the compensation table in the file of `bank`; None if there is no file.

        Raises StoreError if the file does not contain a valid table.
        """
        text = read_if_exists(self.path(bank))
        return None if text is None else parse_table(text, file=str(self.path(bank)), device=self._device, bank=bank)

    def require_known(self, bank: int) -> None:
        if bank not in BANKS:
            raise self.error(f"no bank {bank}; there are {BANKS}")

    def require_stageable(self, bank: int, table: TableImage, taken: tuple[int | None, ...]) -> None:
        """Raise StoreError if the table cannot be staged in (written to) `bank`.

        `taken` contains the banks that must not be written: the active bank and the bank selected for activation.
        """
        self.require_known(bank)
        if bank in taken:
            raise self.error(f"bank {bank} is active and cannot be written", hint="stage into another bank")
        objection = limits_violation(self.limits, table) or table_defect(table, MAX_SLOPE)
        if objection:
            raise self.error(objection)

    def error(self, text: str, hint: str = "") -> StoreError:
        return StoreError(text, hint=hint, device=self._device)

    @property
    def where(self) -> dict[str, str]:
        return {"device": self._device}
