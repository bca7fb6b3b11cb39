"""Compensation tables and their export to the file formats of controllers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from twin.compensation.controllers.all_options import OPTIONS_OF_FORMATS
from twin.compensation.controllers.export_format import ControllerExport, ExportSource, TableEstimate
from twin.compensation.controllers.format_options import ExportOptions
from twin.compensation.controllers.loss import require_same_machine
from twin.compensation.controllers.registry import FORMATS
from twin.compensation.table import CompensationTable, MeasuredRegion, build_table, regular_nodes
from twin.errors import DataError
from twin.formats.ball_file import BallFile
from twin.machine.anchor import Anchor
from volcal.estimation import AnyEstimate, tool_offset
from volcal.files import PathName, write_texts

CONTROLLER_FORMATS = tuple(FORMATS)
"""Names of the formats that `export_table` writes."""


def compensation_table(
    estimate: AnyEstimate,
    balls: BallFile | ArrayLike,
    *,
    step_mm: tuple[float, float, float] | None = None,
    anchor_mm: Sequence[float] = (0.0, 0.0, 0.0),
    tool_offset_mm: ArrayLike | None = None,
) -> CompensationTable:
    """Build the compensation table that corrects the machine error described by `estimate`.

    The table contains corrections in mm, which the controller adds to the commanded axis position.

    `balls` are the measured balls, or axis positions of shape (n, 3) in mm; nodes within the region around them are
    marked as measured. `step_mm` is the largest distance between neighbouring nodes of the table along X, Y and Z; if
    it is None, it is 100 mm, or a twelfth of the range of the axis if that is less.
    `anchor_mm` is the axis position at which the correction is zero; a position outside the workspace is moved to the
    border of the workspace. `tool_offset_mm`, shape (3,), is the offset of the tool for which the table is valid. If it
    is None, the tool used in the measurement is taken. Raises ModelError or DataError if a value is invalid.

    >>> table = volcal.compensation_table(estimate, balls)
    >>> table.corrections.shape
    (41, 14, 16, 3)
    """
    model = estimate.model
    ranges = np.array(model.ranges_mm)
    anchor = Anchor(np.clip(np.asarray(anchor_mm, dtype=np.float64), ranges[:, 0], ranges[:, 1]))
    measured = balls.observations.axis_positions if isinstance(balls, BallFile) else balls
    return build_table(
        model,
        estimate.parameters,
        regular_nodes(model.ranges_mm, step_mm),
        tool_offset(estimate, tool_offset_mm),
        anchor,
        MeasuredRegion.around(measured),
    )


def export_table(
    table: CompensationTable,
    format_name: str,
    folder: PathName,
    *,
    estimate: AnyEstimate | None = None,
    opposite_sign: bool = False,
    **options: object,
) -> ControllerExport:
    """Write `table` into `folder` in the file format of a controller, and return the export (the files written and
    their properties).

    The returned export lists what the format cannot represent (`losses`) and what has to be set by hand (`facts`).

    `format_name` is one of `CONTROLLER_FORMATS`. `estimate` is the estimate from which the table was built; some
    formats need it. If `opposite_sign` is True, every value is written with the opposite of the sign that the
    controller's manual documents. `options` are the options of the format. Their names are those of the command `volcal
    table export`, with underscores instead of hyphens. Raises DataError if the format or an option is unknown, or if
    the format cannot represent the table. In these cases no file is written.

    >>> table = volcal.compensation_table(estimate, balls)
    >>> export = volcal.export_table(table, "linuxcnc-comp", folder)
    >>> sorted(export.files)
    ['ini-lines.txt', 'x.comp', 'y.comp', 'z.comp']
    """
    if format_name not in FORMATS:
        raise DataError(f"unknown format '{format_name}'", hint=f"Known: {', '.join(FORMATS)}")
    _refuse_unknown(options, format_name)
    known = None if estimate is None else TableEstimate(estimate.model, estimate.parameters, estimate.covariance)
    source = ExportSource(table, known)
    require_same_machine(source)
    exported = FORMATS[format_name].export(source, ExportOptions(options, opposite_sign))
    write_texts(Path(folder), exported.files)
    return exported


def _refuse_unknown(options: Mapping[str, object], format_name: str) -> None:
    declared = [option.key for option in OPTIONS_OF_FORMATS[format_name]]
    for key in options:
        if key not in declared:
            hint = f"Options of the format: {', '.join(declared) or 'none'}"
            raise DataError(f"the format '{format_name}' has no option '{key}'", hint=hint)
