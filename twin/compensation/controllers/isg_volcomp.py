"""Volumetric compensation of the CNC kernel of ISG (Beckhoff TwinCAT CNC TF5280). Its input is the error motions
according to ISO 230-1 in the file format ISG_CSV.

The format is described in the section "ISG CSV format" of the manual TF5280. A file consists of blocks separated by
`#`. Each block has a header line with its argument axes and parameter names. Values are in mm and rad, and `//` begins
a comment. A block may have several argument columns. They are used here for the cross-effect, which depends on Y and Z.
In the interpolation mode GRID, the kernel interpolates linearly on a grid. The parameters are errors, and the kernel
moves against them (`negate` in P-VOLC-00009 reverses the direction).

The squareness parameters A0Z, B0Z and C0Y are written as zeros in the first block. The manual does not state clearly
whether these parameters also rotate the parts that the axis carries. Squareness is therefore written as slopes of the
straightness errors, whose meaning is unambiguous.

The anchor of the compensation table, at which its correction is zero, determines a rigid motion that the table leaves
uncorrected. This rigid motion is subtracted from the error motions, so the kernel adds the same correction as the
table. The rotation is also written as slopes of the straightness errors, and the translation as constants.
"""

from __future__ import annotations

from collections.abc import Mapping
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
_CROSSED_WITH_LEVER = ("EYZ", "EZZ", "EAZ")

LOSSES = ("terms of second order, nanometres", "the misfit of the estimate, as in the table itself")


@dataclass(frozen=True, eq=False)
class Motions:
    """Error motions of the axes X, Y and Z at the nodes of the compensation table.

    `series[axis]` (6, n) contains the error motions of one axis at its n nodes: EX, EY and EZ in mm, and EA, EB and EC
    in rad. The straightness error EYZ and the roll EAZ depend on Y and Z (cross-effect), so they are zero in `series`.
    Their values, by name, are in `crossed`: arrays (ny, nz) on a grid of ny nodes along Y and nz nodes along Z. The
    positioning error EZZ is there, too, if the zero of Y is not the lower end of its range.
    """

    series: tuple[Array, Array, Array]
    crossed: Mapping[str, Array]


def export(source: ExportSource, choices: ExportOptions) -> ControllerExport:
    """Return the export as the texts of `volcomp.csv`, which contains the error motions, and of the list file
    `volcomp.lis`. The user has to add the axis numbers to `volcomp.lis`.
    """
    table, identified = source.table, source.estimate
    if identified is None:
        hint = "Give it with --estimate, or the folder of the run with --table"
        raise DataError("this format contains error motions, so it needs the estimate", hint=hint)
    if identified.model.structure:
        name = identified.model.structure[0].name
        raise DataError(
            f"this format contains only the cross-effect of column and ram, not {name}",
            hint="Choose a format that contains the table itself, such as neutral",
        )
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
    # An axis e that is turned by the small angles θ moves along e + θ × e: Y turned by c about Z leans to -X, Z turned
    # by a and b leans to (b, -a).
    y[0] -= c * (table.y - low[1])
    z[0] += b * (table.z - low[2])
    z[1] -= a * (table.z - low[2])
    # the model measures lever arms from the lower ends of the ranges, the kernel from the zeros of the axes
    levers = _lower_ends_of_arms(model)
    for one, lever in zip(series, levers, strict=True):
        # θ × (arm - lever) = θ × arm - θ × lever: the second part becomes a displacement.
        one[:3] -= np.cross(one[3:].T, lever).T
    v, w = cross_arguments(model, table.y[:, None], table.z[None, :])
    terms = model.column_and_ram(values)
    twist = (terms["c0"] + terms["c1"] * w) * v
    # The roll of Z turns about X, and -(twist, 0, 0) × lever = (0, twist l_z, -twist l_y).
    crossed = {
        "EYZ": (terms["b0"] + terms["b1"] * w + terms["b2"] * w**2) * v + twist * levers[2, 2] + z[1],
        "EZZ": z[2] - twist * levers[2, 1],
        "EAZ": twist + z[3],
    }
    names = _CROSSED_WITH_LEVER if levers[2, 1] and twist.any() else _CROSSED
    z[[DIRECTIONS.index(name[1]) for name in names]] = 0.0
    return Motions((x, y, z), {name: crossed[name] for name in names})


def _lower_ends_of_arms(model: ErrorModel) -> Array:
    """Return, for X, Y and Z, the vector (3, 3) in mm from the zeros to the lower ends of those axes whose travel is
    part of the lever arm of this axis."""
    low, arm, found = np.array(model.ranges_mm)[:, 0], np.zeros(3), np.zeros((3, 3))
    for letter in model.chain.axes:
        axis = AXES.index(letter)
        if letter in model.chain.tool_side:
            found[axis] = arm
        arm[axis] += low[axis]
        if letter in model.chain.workpiece_side:
            found[axis] = arm
    return found


def _without_rigid_motion(motions: Motions, source: ExportSource) -> Motions:
    """Return the motions minus the rigid motion that the table leaves uncorrected because of its anchor.

    The kernel then adds the same correction as the table.
    """
    (shift_x, shift_y, shift_z, turn_x, turn_y, turn_z), _ = rigid_difference(source)
    table = source.table
    from_x, from_y, from_z = (
        nodes - anchor for nodes, anchor in zip(table.nodes, table.anchor.point_mm.tolist(), strict=True)
    )
    # The rigid motion shift + turn × r is the sum of the turns of (x, 0, 0), (0, y, 0) and (0, 0, z), one for each
    # axis. Each axis takes the component of the shift along itself.
    x, y, z = (one.copy() for one in motions.series)
    x[0] -= shift_x
    x[1] -= turn_z * from_x
    x[2] += turn_y * from_x
    y[0] += turn_z * from_y
    y[1] -= shift_y
    y[2] -= turn_x * from_y
    z[0] -= turn_y * from_z
    z[2] -= shift_z
    crossed = dict(motions.crossed)
    crossed["EYZ"] = crossed["EYZ"] + turn_x * from_z
    if "EZZ" in crossed:
        crossed["EZZ"] = crossed["EZZ"] - shift_z
        z[2] = 0.0
    return Motions((x, y, z), crossed)


def _rounded(motions: Motions) -> Motions:
    decimals = [_MM_DECIMALS] * 3 + [_RAD_DECIMALS] * 3
    x, y, z = (np.array([np.round(row, d) for row, d in zip(one, decimals, strict=True)]) for one in motions.series)
    crossed = {name: np.round(values, decimals[_row(name)]) for name, values in motions.crossed.items()}
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
            for name, values in motions.crossed.items():
                moved[_row(name)] += _over_y_and_z(values, table, axis_positions)
        # As in the forward model: the lever arm of an axis contains the travels of the axes nearer to the tool, and its
        # own travel only if the axis moves the workpiece.
        carried = arm.copy()
        arm[:, axis] += axis_positions[:, axis]
        lever = carried if letter in model.chain.tool_side else arm
        total += np.stack(moved[:3], axis=1) + np.cross(np.stack(moved[3:], axis=1), lever)
    return total


def _over_y_and_z(values: Array, table: CompensationTable, axis_positions: Array) -> Array:
    """Interpolate `values` bilinearly at axis positions (n, 3) and return the result (n,).

    The values are given at the nodes of Y and Z. Beyond the outermost nodes they are constant.
    """
    # Bilinear: first along Z in every row of Y nodes, then along Y between the two rows.
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
        blocks.append(_block(letter, motions, motions.series[axis], table.nodes[axis], sign))
    crossed = ["// straightness and roll of Z, which depend on Y too", f"Y Z {' '.join(motions.crossed)}"]
    for j, y in enumerate(table.y.tolist()):
        for k, z in enumerate(table.z.tolist()):
            cells = [_number(name, sign * float(values[j, k])) for name, values in motions.crossed.items()]
            crossed.append(" ".join([f"{y:.10g}", f"{z:.10g}", *cells]))
    return "\n#\n".join("\n".join(block) for block in [*blocks, crossed]) + "\n"


def _block(letter: str, motions: Motions, series: Array, nodes: Array, sign: int) -> list[str]:
    used = [name for direction in DIRECTIONS if (name := f"E{direction}{letter}") not in motions.crossed]
    lines = [f"// errors of {letter}", " ".join([letter, *used])]
    for index, position in enumerate(nodes.tolist()):
        cells = [_number(name, sign * float(series[_row(name), index])) for name in used]
        lines.append(" ".join([f"{position:.10g}", *cells]))
    return lines


def _row(name: str) -> int:
    """Return the row of an error motion, such as EYZ, in the series of its axis."""
    return DIRECTIONS.index(name[1])


def _number(name: str, value: float) -> str:
    """Return the text of a value in mm or rad of an error motion."""
    return f"{value + 0.0:.{_MM_DECIMALS if _row(name) < 3 else _RAD_DECIMALS}f}"


def _list_file(model: ErrorModel) -> str:
    # The kernel counts the axes from the workpiece to the tool.
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
