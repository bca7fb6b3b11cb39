"""Compensation tables as files: one for each bank, one that says which bank acts.

A file is written beside its place, forced to the disk and renamed over the old one, so that after a power cut either
the old or the new one is there, whole. The CRC-32 is that over the counts, big-endian, x slowest, dx dy dz innermost:
the one the journal and every other store give for the same table.
"""

from __future__ import annotations

import json
import math
import os
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from drivers.errors import ChecksumMismatch, StoreError
from drivers.roles import TableImage

FORMAT: Literal["volcal bank 1"] = "volcal bank 1"
Triple = tuple[float, float, float]
INT32 = 2**31


class _BankFile(BaseModel):
    model_config = ConfigDict(extra="forbid")

    format: Literal["volcal bank 1"]
    meaning: Literal["counts of resolution_mm, added to the commanded axis position"]
    crc32: str = Field(pattern="^[0-9a-f]{8}$")
    origin_mm: Triple
    step_mm: Triple
    resolution_mm: float = Field(gt=0.0)
    shape: tuple[int, int, int]
    counts: list[int]


class _ActiveFile(BaseModel):
    model_config = ConfigDict(extra="forbid")

    format: Literal["volcal bank 1"]
    bank: int = Field(ge=0)
    crc32: str = Field(pattern="^[0-9a-f]{8}$")


def table_crc32(table: TableImage) -> int:
    return zlib.crc32(table.counts.astype(">i4").tobytes())


class BankFiles:
    """The directory. Raises StoreError, and ChecksumMismatch for a file whose content is not what it says."""

    def __init__(self, directory: Path, where: Mapping[str, str]) -> None:
        self._directory = directory
        self._where = where

    @property
    def directory(self) -> Path:
        return self._directory

    def read(self, bank: int) -> TableImage | None:
        """None where nothing was ever written."""
        path = self._bank_path(bank)
        document = self._read(path, _BankFile)
        if document is None:
            return None
        nx, ny, nz = document.shape
        if min(document.shape) < 1 or len(document.counts) != nx * ny * nz * 3:
            raise self._error(f"{len(document.counts)} counts for a grid of {document.shape}", path)
        if any(abs(count) >= INT32 for count in document.counts):
            raise self._error("a count is no 32-bit number", path)
        if not all(map(math.isfinite, (*document.origin_mm, *document.step_mm))) or min(document.step_mm) <= 0.0:
            raise self._error("the grid is none", path)
        counts = np.array(document.counts, dtype=np.int32).reshape(nx, ny, nz, 3)
        table = TableImage(document.origin_mm, document.step_mm, document.resolution_mm, counts)
        if f"{table_crc32(table):08x}" != document.crc32:
            raise ChecksumMismatch(
                f"CRC-32 of the counts is {table_crc32(table):08x}, the file states {document.crc32}",
                hint="the file was changed by hand or is damaged; stage the table again",
                file=str(path),
                **self._where,
            )
        return table

    def write(self, bank: int, table: TableImage) -> None:
        document = _BankFile(
            format=FORMAT,
            meaning="counts of resolution_mm, added to the commanded axis position",
            crc32=f"{table_crc32(table):08x}",
            origin_mm=table.origin_mm,
            step_mm=table.step_mm,
            resolution_mm=table.resolution_mm,
            shape=table.shape,
            counts=table.counts.reshape(-1).tolist(),
        )
        self._replace(self._bank_path(bank), document)

    def active(self) -> tuple[int, int]:
        """Bank that acts and the CRC-32 of its table; (0, 0) where no bank was ever activated."""
        document = self._read(self._active_path, _ActiveFile)
        return (0, 0) if document is None else (document.bank, int(document.crc32, 16))

    def set_active(self, bank: int, crc32: int) -> None:
        self._replace(self._active_path, _ActiveFile(format=FORMAT, bank=bank, crc32=f"{crc32:08x}"))

    def require_writable(self) -> None:
        """Make the directory and prove that files can be written there."""
        try:
            self._directory.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise self._error(f"cannot be made: {error.strerror or error}", self._directory) from error
        if not os.access(self._directory, os.W_OK | os.X_OK):
            raise self._error("may not be written to", self._directory)

    @property
    def _active_path(self) -> Path:
        return self._directory / "active.json"

    def _bank_path(self, bank: int) -> Path:
        return self._directory / f"bank-{bank}.json"

    def _read(self, path: Path, kind: type[Any]) -> Any:
        try:
            text = path.read_text(encoding="utf-8")
        except FileNotFoundError:
            return None
        except (OSError, UnicodeDecodeError) as error:
            raise self._error(f"cannot be read: {error}", path) from error
        try:
            return kind.model_validate_json(text)
        except ValidationError as error:
            first = error.errors(include_url=False)[0]
            key = ".".join(str(part) for part in first["loc"])
            raise self._error(f"is no bank file: {key} {first['msg']}".replace("  ", " "), path) from error

    def _replace(self, path: Path, document: BaseModel) -> None:
        self.require_writable()
        temporary = path.with_suffix(".new")
        try:
            with temporary.open("w", encoding="utf-8") as file:
                file.write(json.dumps(document.model_dump(mode="json"), separators=(",", ":"), allow_nan=False) + "\n")
                file.flush()
                os.fsync(file.fileno())
            temporary.replace(path)
            self._sync_directory()
        except OSError as error:
            raise self._error(f"cannot be written: {error.strerror or error}", path) from error

    def _sync_directory(self) -> None:
        """The rename itself must be on the disk."""
        descriptor = os.open(self._directory, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)

    def _error(self, text: str, path: Path) -> StoreError:
        return StoreError(
            f"bank file {text}",
            hint="the file holds the compensation that is active or was staged; look at it before deleting it",
            file=str(path),
            **self._where,
        )
