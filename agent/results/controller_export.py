"""Export of a compensation table in the format of a controller. Either all files of an export are written completely,
or no file is written."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from agent.files import present_file, read_text, translated, write_all_atomically
from drivers.errors import InputError
from twin.arrays import Array
from twin.compensation.controllers.export_format import ControllerExport, ExportSource, TableEstimate
from twin.compensation.controllers.format_options import ExportOptions
from twin.compensation.controllers.grids import Shape, require_small_corrections, resample_table
from twin.compensation.controllers.loss import (
    CompensationLoss,
    compensation_loss,
    largest_correction,
    require_same_machine,
)
from twin.compensation.controllers.registry import FORMATS
from twin.compensation.table import CompensationTable
from twin.compensation.table_file import checksum, format_table, parse_table
from twin.formats.estimate_file import parse_estimate

RECORD = "export.json"


@dataclass(frozen=True, eq=False)
class TableToExport:
    """Compensation table to be exported, with its origin.

    `origin` is the name of the table's file, or of the bank that contains it, as it is shown to people. `estimate_file`
    contains the estimate of the machine. If it is None, the machine is assumed to have exactly the errors that the
    table corrects. `resolution_mm` is the resolution of the integers in which a controller stored the table; it is 0
    for a table from a file.
    """

    table: CompensationTable
    origin: str
    estimate_file: Path | None
    resolution_mm: float = 0.0


@dataclass(frozen=True)
class TableExportRequest:
    """Format, folder and options of an export.

    `points` contains the numbers of grid points along X, Y and Z; if it is None, the grid of the table is used.
    `largest_um` is the largest correction in µm that is allowed.
    """

    format: str
    out: Path
    points: Shape | None
    largest_um: float
    options: ExportOptions


@dataclass(frozen=True, eq=False)
class TableExportResult:
    """Result of an export.

    `check` contains two values in mm: the axis positions (3,) at which the correction is largest, and that correction
    (3,).
    """

    request: TableExportRequest
    source: TableToExport
    exported: ControllerExport
    loss: CompensationLoss
    check: tuple[Array, Array]
    table_crc32: str

    def as_json(self) -> dict[str, Any]:
        """Return the JSON object that the command-line option `--json` prints. The file `export.json` has the keys of
        this object and the key `software`."""
        table, loss = self.source.table, self.loss
        points = self.request.points or table.corrections.shape[:3]
        return {
            "format": self.request.format,
            "machine": table.machine or None,
            "artefact": table.artefact or None,
            "table": self.source.origin,
            "table_crc32": self.table_crc32,
            "estimate": None if self.source.estimate_file is None else str(self.source.estimate_file),
            "points": list(points),
            "tool_offset_mm": table.tool_offset.tolist(),
            "largest_um": round(1e3 * float(np.abs(table.corrections).max()), 3),
            "extrapolated_percent": round(100.0 * float(np.mean(table.extrapolated)), 1),
            "opposite_sign": self.request.options.opposite_sign,
            "ve_before_um": round(loss.before.aligned_um, 3),
            "ve_full_um": round(loss.full.aligned_um, 3),
            "ve_reduced_um": round(loss.reduced.aligned_um, 3),
            "ve_before_raw_um": round(loss.before.raw_um, 3),
            "ve_full_raw_um": round(loss.full.raw_um, 3),
            "ve_reduced_raw_um": round(loss.reduced.raw_um, 3),
            "kept_percent": round(100.0 * loss.retained_share, 1),
            "unknown_um": None if loss.unknown_mm is None else round(1e3 * loss.unknown_mm, 3),
            "check_at_mm": [round(value, 3) for value in self.check[0].tolist()],
            "check_moves_um": [round(1e3 * value, 1) + 0.0 for value in self.check[1].tolist()],
            "gates_not_passed": list(table.gates_not_passed),
            "lost": list(self.exported.losses),
            "facts": dict(self.exported.facts),
            "files": [str(self.request.out / name) for name in self.exported.files],
        }


def load_table_to_export(path: Path, estimate: Path | None) -> TableToExport:
    """Return the compensation table from `path`, the folder of a run or a CSV file, with the path of an estimate of the
    machine.

    If `estimate` is None, the estimate is the file `estimate.json` beside the table, if it exists. Raises InputError if
    the table cannot be read.
    """
    if path.is_dir():
        path = path / "table.csv"
    side = path.with_suffix(".json")
    text, side_text = read_text(path), read_text(side)
    with translated(InputError, file=str(path)):
        table = parse_table(text, side_text, str(path), str(side))
    beside = present_file(path.parent / "estimate.json")
    return TableToExport(table, str(path), estimate or (beside if beside.exists() else None))


def export_table(source: TableToExport, request: TableExportRequest) -> TableExportResult:
    """Write the files of the table in the requested format and `export.json` into `request.out`. If UserError is
    raised, no file has been written."""
    with translated(InputError, file=source.origin):
        full = ExportSource(source.table, _load_estimate(source.estimate_file))
        require_small_corrections(full.table, 1e-3 * request.largest_um)
        require_same_machine(full, source.resolution_mm)
        table = full.table if request.points is None else resample_table(full.table, request.points)
        exported = FORMATS[request.format].export(ExportSource(table, full.estimate), request.options)
        loss, check = compensation_loss(full, exported.correction), largest_correction(table, exported.correction)
    result = TableExportResult(request, source, exported, loss, check, checksum(format_table(source.table)))
    write_all_atomically(request.out, _contents(result))
    return result


def _contents(result: TableExportResult) -> Mapping[str, str]:
    record = {"software": f"volcal {version('volcal')}", **result.as_json()}
    return {**result.exported.files, RECORD: json.dumps(record, indent=2, ensure_ascii=False) + "\n"}


def _load_estimate(path: Path | None) -> TableEstimate | None:
    if path is None:
        return None
    stored = parse_estimate(read_text(path), str(path))
    return TableEstimate(stored.model, stored.parameters, stored.covariance)
