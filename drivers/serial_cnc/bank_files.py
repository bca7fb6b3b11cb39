"""Files of the compensation tables: one file for each bank, and one file that names the active bank.

After a power cut, each file has its complete old or its complete new contents.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

from drivers.errors import StoreError
from drivers.foreign_errors import cause_of
from drivers.roles import TableImage
from drivers.tables.files import read_if_exists, write_atomically
from drivers.tables.text import format_table, parse_table

_ACTIVE = re.compile(r"volcal-active-bank 1\nbank (\d)\ncounts_crc32 ([0-9A-F]{8})\n")


class BankFiles:
    """Directory that contains the files of the compensation tables.

    Methods raise StoreError if a file is invalid or inaccessible, and ChecksumMismatch if a stored table was changed.
    """

    def __init__(self, directory: Path, where: Mapping[str, str]) -> None:
        self.directory = directory
        self._where = where

    def read(self, bank: int) -> TableImage | None:
        """Return the table of `bank`, or None if the bank has no file."""
        path = self.directory / f"bank{bank}.table"
        text = read_if_exists(path)
        return None if text is None else parse_table(text, file=str(path), bank=bank, **self._where)

    def write(self, bank: int, table: TableImage) -> None:
        self._create_directory()
        write_atomically(self.directory / f"bank{bank}.table", format_table(table))

    def active(self) -> tuple[int, int]:
        """Return the active bank and the CRC-32 of the counts of its table, or (0, 0) if no bank was ever activated."""
        text = read_if_exists(self._active_path)
        if text is None:
            return 0, 0
        match = _ACTIVE.fullmatch(text)
        if match is None:
            raise StoreError(
                "the file that names the active bank is invalid",
                hint="check it, or delete it: then no bank is active",
                file=str(self._active_path),
                **self._where,
            )
        return int(match[1]), int(match[2], 16)

    def set_active(self, bank: int, crc32: int) -> None:
        self._create_directory()
        write_atomically(self._active_path, f"volcal-active-bank 1\nbank {bank}\ncounts_crc32 {crc32:08X}\n")

    @property
    def _active_path(self) -> Path:
        return self.directory / "active"

    def _create_directory(self) -> None:
        try:
            self.directory.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise StoreError(
                f"the directory of the banks cannot be created: {cause_of(error)}",
                hint="check banks.directory and its permissions",
                file=str(self.directory),
                **self._where,
            ) from error
