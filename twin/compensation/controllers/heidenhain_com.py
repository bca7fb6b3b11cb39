"""HEIDENHAIN nonlinear axis error compensation. It uses one `.COM` table for each causing axis, which is the axis whose
position causes the errors. A `.CMA` table lists the `.COM` tables.

The formats are described in the technical manuals MANUALplus 620, 6.10.3, and TNC 407. A `.COM` table has up to 256
evenly spaced rows. Each row belongs to a position of the causing axis and has a column for each affected axis. The
`.CMA` table has one column per causing axis, in which it lists the `.COM` table of this axis.

The tables contain the measured error, and the control moves against it. Only one line of the `.CMA` table is active at
a time, so two lines serve as two banks, between which the compensation can be switched.
"""

from __future__ import annotations

from twin.arrays import Array
from twin.compensation.controllers.all_options import ACTIVE_BANK
from twin.compensation.controllers.export_format import ControllerExport, ExportFormat, ExportSource
from twin.compensation.controllers.format_options import (
    AXIS_NAMES,
    REFERENCE_MM,
    ExportOptions,
    Names,
)
from twin.compensation.controllers.grids import even_steps, reference_point, require_points
from twin.compensation.controllers.reduction import (
    Profile,
    cross_axis_profiles,
    round_profile,
    sum_of_cross_axis_profiles,
)

MOST_ROWS = 256
USUAL_NAMES = ("X", "Y", "Z")
_DECIMALS = 4
_NUMBER, _CELL = 5, 14

LOSSES = (
    "rotation and cross-effect: every column depends on one axis only, so the workspace's average is corrected",
    "steps of 0.1 µm",
)


def export(source: ExportSource, choices: ExportOptions) -> ControllerExport:
    """Return the export of a compensation table as the texts of three `.COM` files, one per causing axis, for the
    requested bank (A or B), and of `CONFIG.CMA`, in which the line of this bank is active.
    """
    table, names = source.table, choices[AXIS_NAMES] or USUAL_NAMES
    require_points(table, (MOST_ROWS, MOST_ROWS, MOST_ROWS), "a .COM table")
    even_steps(table)
    wanted = cross_axis_profiles(table, reference_point(table, choices[REFERENCE_MM]))
    written = tuple(tuple(round_profile(one, _DECIMALS) for one in row) for row in wanted)
    files = {
        f"{_stem(choices[ACTIVE_BANK], name)}.COM": _com(_stem(choices[ACTIVE_BANK], name), row, names, choices.sign)
        for name, row in zip(names, written, strict=True)
    }
    files["CONFIG.CMA"] = _cma(names, choices[ACTIVE_BANK])

    def correction(axis_positions: Array) -> Array:
        return sum_of_cross_axis_profiles(written, axis_positions)

    return ControllerExport(files, correction, LOSSES, {"bank": choices[ACTIVE_BANK]})


def _stem(bank: str, name: str) -> str:
    return f"VOLCAL{bank}_{name}"


def _com(stem: str, row: tuple[Profile, ...], names: Names, sign: int) -> str:
    lines = [f"BEGIN {stem}.COM MM", _line("NR", "AXISPOS", "BACKLASH", *names)]
    for index, position in enumerate(row[0].nodes.tolist()):
        # The control moves against the error in the table: the error is minus the correction. Adding 0.0 turns -0.0
        # into 0.0.
        cells = [f"{-sign * float(one.values[index]) + 0.0:+.{_DECIMALS}f}" for one in row]
        lines.append(_line(str(index), f"{position:+.4f}", "", *cells))
    return "\n".join([*lines, "[END]"]) + "\n"


def _cma(names: Names, active: str) -> str:
    lines = ["BEGIN CONFIG.CMA MM", _line("NR", "ACTIVE", *names)]
    for index, bank in enumerate(("A", "B")):
        tables = [f"VOLCAL{bank}_{name}" for name in names]
        lines.append(_line(str(index), "*" if bank == active else "", *tables))
    return "\n".join([*lines, "[END]"]) + "\n"


def _line(number: str, *cells: str) -> str:
    return (number.ljust(_NUMBER) + "".join(cell.ljust(_CELL) for cell in cells)).rstrip()


FORMAT = ExportFormat("heidenhain-com", export)
