"""Estimate and table of a prediction, from files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from agent.files import present_file, read_text, translated
from drivers.errors import InputError
from twin.arrays import Array
from twin.compensation.table import CompensationTable
from twin.compensation.table_file import parse_table
from twin.formats.estimate_file import StoredEstimate, parse_estimate

ESTIMATE_NAME, TABLE_NAME = "estimate.json", "table.csv"


@dataclass(frozen=True, eq=False)
class EstimateAndTable:
    """Estimate of a machine with a compensation table, and the offset (3,) in mm of the tool for which errors are
    predicted. `table` and its name (its file, as a rule) are None if the machine is predicted without compensation
    only."""

    estimate: StoredEstimate
    table: CompensationTable | None
    table_name: str | None
    tool_offset_mm: Array


def read_estimate_and_table(
    estimate: Path, table: Path | None, without_table: bool, tool_offset_mm: tuple[float, float, float] | None
) -> EstimateAndTable:
    """Return what the files contain.

    `estimate` is an estimate file, or the folder of a run or of `volcal identify`. The table beside it is taken, unless
    `table` names another one or `without_table` is True. `tool_offset_mm` is None for the tool of the table or of the
    measurement. Raises InputError, which names the file and the row, column or key, if a file is invalid.
    """
    stored = _estimate(estimate)
    file = None if without_table else table or _beside(estimate)
    found = None if file is None else _table(file)
    name = None if file is None else str(file)
    return EstimateAndTable(stored, found, name, _tool_offset(tool_offset_mm, stored, found))


def files_read(estimate: Path, table: Path | None) -> tuple[Path, ...]:
    """Return the files that `read_estimate_and_table` may read for the same arguments: the estimate, the table beside
    it and the one that is named, each table with its side file."""
    folder = estimate if estimate.is_dir() else estimate.parent
    tables = [folder / TABLE_NAME, *([] if table is None else [table])]
    whole = folder / ESTIMATE_NAME if estimate.is_dir() else estimate
    return (whole, *(file for one in tables for file in (one, one.with_suffix(".json"))))


def _estimate(path: Path) -> StoredEstimate:
    file = path / ESTIMATE_NAME if path.is_dir() else path
    with translated(file=str(file)):
        return parse_estimate(read_text(file), str(file))


def _beside(estimate: Path) -> Path | None:
    table = (estimate if estimate.is_dir() else estimate.parent) / TABLE_NAME
    return table if present_file(table).exists() else None


def _table(path: Path) -> CompensationTable:
    side = path.with_suffix(".json")
    with translated(file=str(path)):
        return parse_table(read_text(path), read_text(side), str(path), str(side))


def _tool_offset(
    stated: tuple[float, float, float] | None, estimate: StoredEstimate, table: CompensationTable | None
) -> Array:
    if stated is not None:
        return np.array(stated)
    if table is not None:
        return table.tool_offset
    if len(estimate.tool_offsets) != 1:
        raise InputError(
            f"the estimate was measured with {len(estimate.tool_offsets)} tools",
            hint="state the one that is meant with --tool-offset",
        )
    return np.asarray(estimate.tool_offsets[0])
