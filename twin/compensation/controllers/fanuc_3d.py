"""FANUC three-dimensional error compensation. It uses a lattice of at most 25 points per axis and trilinear
interpolation.

The interpolation is described in the additional manual Series 30i-A, A-79351E: the eight corners of a cell are weighted
by the position within the cell. The parameter numbers, the order of the points and the sign are known only from
experience. Its parameters are written as path parameters of the 30i (Q1 for parameter data, L1 for the first path). The
format of the data files that the controller reads (punched data) is not public. The export therefore
lists the points, and they have to be entered with the machine builder's tool.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from twin.compensation.controllers.detection_units import (
    CountArray,
    CountUnit,
    format_reference,
    smallest_unit,
)
from twin.compensation.controllers.export_format import ControllerExport, ExportFormat, ExportSource, Facts
from twin.compensation.controllers.format_options import REFERENCE_MM, ExportOptions
from twin.compensation.controllers.grids import even_steps, reference_nodes, reference_point, require_points
from twin.compensation.table import CompensationTable
from twin.machine.kinematic_chain import AXES

MOST_POINTS = 25
# The largest value of a signed byte.
LARGEST_COUNT = 127
_FIRST_PARAMETER = {"points": 10803, "reference": 10806, "magnification": 10809, "interval": 10812}

LOSSES = ("curvature between points that are farther apart than those of the table, and fractions of a detection unit",)


def export(source: ExportSource, choices: ExportOptions) -> ControllerExport:
    """Return the export of a compensation table as the texts of two files. `points.csv` contains the number and the
    position of each point and its corrections as integer counts. `parameters.txt` contains the controller parameters.
    """
    table = source.table
    require_points(table, (MOST_POINTS, MOST_POINTS, MOST_POINTS), "the lattice")
    steps = even_steps(table)
    reference = reference_point(table, choices[REFERENCE_MM])
    indices = reference_nodes(table, reference)
    # The controller adds nothing at its reference point. The constant that is missing is a translation of the whole
    # workspace.
    wanted = table.corrections - table.at(reference[None, :])[0]
    unit = smallest_unit([wanted], choices, LARGEST_COUNT, increments=False)
    counts = unit.counts(wanted)
    written = replace(table, corrections=unit.values(counts))
    files = {
        "points.csv": _points(table, choices.sign * counts),
        "parameters.txt": _parameters(table, indices, steps, unit),
    }
    facts: Facts = {"magnification": unit.magnification, "counted_from_mm": format_reference(reference)}
    return ControllerExport(files, written.at, LOSSES, facts)


def _points(table: CompensationTable, counts: CountArray) -> str:
    """Return the CSV list of the points.

    They are numbered from 1; X varies fastest, then Y, then Z.
    """
    lines = ["number,x_mm,y_mm,z_mm,x_counts,y_counts,z_counts"]
    shape = table.corrections.shape[:3]
    # ndindex varies its last index fastest; with the shape reversed this is X.
    for number, index in enumerate(np.ndindex(shape[::-1]), start=1):
        k, j, i = index
        position = ",".join(f"{nodes[at]:.10g}" for nodes, at in zip(table.nodes, (i, j, k), strict=True))
        lines.append(f"{number},{position}," + ",".join(str(value) for value in counts[i, j, k].tolist()))
    return "\n".join(lines) + "\n"


def _parameters(
    table: CompensationTable, indices: tuple[int, int, int], steps: tuple[float, float, float], unit: CountUnit
) -> str:
    rows = {
        "points": [len(nodes) for nodes in table.nodes],
        "reference": [index + 1 for index in indices],
        "magnification": [unit.magnification] * 3,
        "interval": [unit.whole(step, f"the interval of {axis}") for axis, step in zip(AXES, steps, strict=True)],
    }
    lines = ["%", *(f"N{10800 + axis}Q1L1P{axis + 1}" for axis in range(3))]
    for name, values in rows.items():
        lines += [f"N{_FIRST_PARAMETER[name] + axis}Q1L1P{value}" for axis, value in enumerate(values)]
    return "\n".join([*lines, "%"]) + "\n"


FORMAT = ExportFormat("fanuc-3d", export)
