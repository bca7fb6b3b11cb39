"""CSV file of a compensation table that is readable without further documentation. It is for controllers whose own
format is not public, and for spreadsheets.

The columns are `x_mm,y_mm,z_mm,dx_um,dy_um,dz_um,extrapolated`. The first three contain the axis position of a node.
The next three contain the correction that is added to the command at this node. The last column is 1 if the node is
outside the measured region, else 0. There is one row for each node of the grid. Z varies fastest from row to row, X
slowest.
"""

from __future__ import annotations

import numpy as np

from twin.compensation.controllers.export_format import ControllerExport, ExportFormat, ExportSource
from twin.compensation.controllers.format_options import ExportOptions

COLUMNS = ("x_mm", "y_mm", "z_mm", "dx_um", "dy_um", "dz_um", "extrapolated")


def export(source: ExportSource, choices: ExportOptions) -> ControllerExport:
    """Return the export of a compensation table as the text of the file `compensation.csv`."""
    table = source.table
    points = np.stack(np.meshgrid(*table.nodes, indexing="ij"), axis=-1).reshape(-1, 3)
    corrections = 1e3 * choices.sign * table.corrections.reshape(-1, 3)
    lines = [",".join(COLUMNS)]
    marks = table.extrapolated.reshape(-1).tolist()
    for point, values, mark in zip(points.tolist(), corrections.tolist(), marks, strict=True):
        position = ",".join(f"{value:.10g}" for value in point)
        lines.append(f"{position}," + ",".join(f"{round(value, 4) + 0.0:.4f}" for value in values) + f",{int(mark)}")
    facts = {f"tool_offset_{letter}_mm": float(v) for letter, v in zip("xyz", table.tool_offset, strict=True)}
    return ControllerExport({"compensation.csv": "\n".join(lines) + "\n"}, table.at, ("nothing",), facts)


FORMAT = ExportFormat("neutral", export)
