"""Volumetric compensation of the CNC kernel of ISG (Beckhoff TwinCAT CNC TF5280). Its input is the error motions
according to ISO 230-1 in the file format ISG_CSV.

The format is described in the section "ISG CSV format" of the manual TF5280. A file consists of blocks separated by
`#`. Each block has a header line with its argument axes and parameter names. Values are in mm and rad, and `//` begins
a comment. A block may have several argument columns. They are used here for the cross-effect (bending of the column by
the weight of the extended ram), which depends on Y and Z. In the interpolation mode GRID, the kernel interpolates
linearly on a grid. The parameters are errors, and the kernel moves against them (`negate` in P-VOLC-00009 reverses the
direction).

The squareness parameters A0Z, B0Z and C0Y are written as zeros in the first block. The manual does not state clearly
whether these parameters also rotate the parts that the axis carries. Squareness is therefore written as slopes of the
straightness errors, whose meaning is unambiguous.

The anchor of the compensation table, at which its correction is zero, determines a rigid motion that the table leaves
uncorrected. This rigid motion is subtracted from the error motions, so the kernel adds the same correction as the
table. The rotation is also written as slopes of the straightness errors, and the translation as constants.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin.arrays import Array
from twin.compensation.controllers.export_format import ControllerExport, ExportFormat, ExportSource, TableEstimate
from twin.compensation.controllers.format_options import ExportOptions
from twin.compensation.controllers.loss import rigid_difference
from twin.compensation.table import CompensationTable
from twin.errors import DataError
from twin.machine.deviation_basis import cross_arguments
from twin.machine.error_model import DIRECTIONS, ErrorModel
from twin.machine.kinematic_chain import AXES
from twin.machine.legendre import legendre_values, normalise_positions

MOST_RECORDS = 100_000
_MM_DECIMALS, _RAD_DECIMALS = 7, 10
_CROSSED = ("EYZ", "EAZ")

LOSSES = ("terms of second order, nanometres", "the misfit of the estimate, as in the table itself")


@dataclass(frozen=True, eq=False)
class Motions:
    """Error motions of the axes X, Y and Z at the nodes of the compensation table.

    `series[axis]` (6, n) contains the error motions of one axis at its n nodes: EX, EY and EZ in mm, and EA, EB and EC
    in rad. The straightness error EYZ and the roll EAZ depend on Y and Z (cross-effect), so they are zero in `series`.
    Their values are in `crossed` (2, ny, nz), on a grid of ny nodes along Y and nz nodes along Z.
    """

    series: tuple[Array, Array, Array]
    crossed: Array


def export(source: ExportSource, choices: ExportOptions) -> ControllerExport:
    """Return the export as the texts of `volcomp.csv`, which contains the error motions, and of the list file
    `volcomp.lis`. The user has to add the axis numbers to `volcomp.lis`.
    """
    table, identified = source.table, source.estimate
    if identified is None:
        hint = "Give it with --estimate, or the folder of the run with --table"
        raise DataError("this format contains error motions, so it needs the estimate", hint=hint)
    records = 1 + sum(len(nodes) for nodes in table.nodes) + len(table.y) * len(table.z)
    if records > MOST_RECORDS:
        raise DataError(f"{records} records are more than {MOST_RECORDS}", hint="Thin the grid with --points")
    motions = _rounded(_without_rigid_motion(_motions(identified, table), source))

    def correction(axis_positions: Array) -> Array:
        return -_deviation(motions, identified.model, table, axis_positions)

    files = {"volcomp.csv": _csv(motions, table, choices.sign), "volcomp.lis": _list_file(identified.model)}
    return ControllerExport(files, correction, LOSSES, {"max_records_at_least": records})


def _motions(identified: TableEstimate, table: CompensationTable) -> Motions:
    model, values = identified.model, identified.parameters
    series = []
    for axis, nodes in enumerate(table.nodes):
        polynomials = legendre_values(normalise_positions(nodes, model.ranges_mm[axis]), max(model.highest_order))
        series.append(model.coefficients(axis, values) @ polynomials)
    x, y, z = series
    a, b, c = model.squareness(values)
    low = np.array(model.ranges_mm)[:, 0]
    y[0] -= c * (table.y - low[1])
    z[0] += b * (table.z - low[2])
    z[1] -= a * (table.z - low[2])
    v, w = cross_arguments(model, table.y[:, None], table.z[None, :])
    terms = model.cross_terms(values)
    straightness = (terms["b0"] + terms["b1"] * w + terms["b2"] * w**2) * v + z[1]
    roll = (terms["c0"] + terms["c1"] * w) * v + z[3]
    z[[1, 3]] = 0.0
    return Motions((x, y, z), np.stack((straightness, roll)))


def _without_rigid_motion(motions: Motions, source: ExportSource) -> Motions:
    """Return the motions minus the rigid motion that the table leaves uncorrected because of its anchor.

    The kernel then adds the same correction as the table.
    """
    (shift_x, shift_y, shift_z, turn_x, turn_y, turn_z), _ = rigid_difference(source)
    table = source.table
    from_x, from_y, from_z = (
        nodes - anchor for nodes, anchor in zip(table.nodes, table.anchor.point_mm.tolist(), strict=True)
    )
    x, y, z = (one.copy() for one in motions.series)
    x[0] -= shift_x
    x[1] -= turn_z * from_x
    x[2] += turn_y * from_x
    y[0] += turn_z * from_y
    y[1] -= shift_y
    y[2] -= turn_x * from_y
    z[0] -= turn_y * from_z
    z[2] -= shift_z
    crossed = motions.crossed.copy()
    crossed[0] += turn_x * from_z
    return Motions((x, y, z), crossed)


def _rounded(motions: Motions) -> Motions:
    decimals = [_MM_DECIMALS] * 3 + [_RAD_DECIMALS] * 3
    x, y, z = (np.array([np.round(row, d) for row, d in zip(one, decimals, strict=True)]) for one in motions.series)
    crossed = np.stack((np.round(motions.crossed[0], _MM_DECIMALS), np.round(motions.crossed[1], _RAD_DECIMALS)))
    return Motions((x, y, z), crossed)


def _deviation(motions: Motions, model: ErrorModel, table: CompensationTable, axis_positions: Array) -> Array:
    """Return the deviation (n, 3) mm to first order.

    Each axis adds its displacements, and its rotations rotate the parts it carries.
    """
    arm = np.repeat(table.tool_offset[None, :], len(axis_positions), axis=0)
    total = np.zeros_like(axis_positions)
    for letter in model.chain.axes:
        axis = AXES.index(letter)
        moved = [np.interp(axis_positions[:, axis], table.nodes[axis], row) for row in motions.series[axis]]
        if letter == "Z":
            moved[1] += _over_y_and_z(motions.crossed[0], table, axis_positions)
            moved[3] += _over_y_and_z(motions.crossed[1], table, axis_positions)
        carried = arm.copy()
        arm[:, axis] += axis_positions[:, axis]
        lever = carried if letter in model.chain.tool_side else arm
        total += np.stack(moved[:3], axis=1) + np.cross(np.stack(moved[3:], axis=1), lever)
    return total


def _over_y_and_z(values: Array, table: CompensationTable, axis_positions: Array) -> Array:
    """Interpolate `values` bilinearly at axis positions (n, 3) and return the result (n,).

    The values are given at the nodes of Y and Z.

    Beyond the border the values are constant.
    """
    over_z = np.array([np.interp(axis_positions[:, 2], table.z, row) for row in values])
    inside = np.clip(axis_positions[:, 1], table.y[0], table.y[-1])
    cell = np.clip(np.searchsorted(table.y, inside, side="right") - 1, 0, len(table.y) - 2)
    share = (inside - table.y[cell]) / (table.y[cell + 1] - table.y[cell])
    rows = np.arange(len(inside))
    return np.asarray((1.0 - share) * over_z[cell, rows] + share * over_z[cell + 1, rows])


def _csv(motions: Motions, table: CompensationTable, sign: int) -> str:
    tool = " ".join(f"{value:.10g}" for value in table.tool_offset.tolist())
    blocks = [["// position errors, and the tool that the values hold for", "A0Z B0Z C0Y P0X P0Y P0Z", f"0 0 0 {tool}"]]
    for axis, letter in enumerate(AXES):
        blocks.append(_block(axis, letter, motions.series[axis], table.nodes[axis], sign))
    crossed = ["// straightness and roll of Z, which depend on Y too", f"Y Z {' '.join(_CROSSED)}"]
    for j, y in enumerate(table.y.tolist()):
        for k, z in enumerate(table.z.tolist()):
            straightness, roll = sign * motions.crossed[:, j, k]
            crossed.append(f"{y:.10g} {z:.10g} {_mm(straightness)} {_rad(roll)}")
    return "\n#\n".join("\n".join(block) for block in [*blocks, crossed]) + "\n"


def _block(axis: int, letter: str, series: Array, nodes: Array, sign: int) -> list[str]:
    names = [f"E{direction}{letter}" for direction in DIRECTIONS]
    used = [row for row, name in enumerate(names) if name not in _CROSSED]
    lines = [f"// errors of {letter}", " ".join([letter, *(names[row] for row in used)])]
    for index, position in enumerate(nodes.tolist()):
        cells = [(_mm if row < 3 else _rad)(sign * float(series[row, index])) for row in used]
        lines.append(" ".join([f"{position:.10g}", *cells]))
    return lines


def _mm(value: float) -> str:
    return f"{value + 0.0:.{_MM_DECIMALS}f}"


def _rad(value: float) -> str:
    return f"{value + 0.0:.{_RAD_DECIMALS}f}"


def _list_file(model: ErrorModel) -> str:
    chain = "".join(reversed(model.chain.axes))
    rows = (
        ("workpiece_axes", str(len(model.chain.workpiece_side))),
        ("chain", chain),
        *((letter, str(number)) for number, letter in enumerate(AXES, start=1)),
        ("interpolation", "GRID"),
        ("alternative_model", "FALSE"),
        ("file[0]", "volcomp.csv"),
        ("file_format[0]", "ISG_CSV"),
    )
    return "# axis numbers (X, Y, Z) as in the channel; path as on the controller\n" + "".join(
        f"{name:<24} {value}\n" for name, value in rows
    )


FORMAT = ExportFormat("isg-volcomp", export)
