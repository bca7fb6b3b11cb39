"""LinuxCNC kinematics `matrixkins`: nine HAL parameters C_xx … C_zz, set by a HAL file.

The module multiplies the commanded axis positions by the matrix C and moves the joints to the product
(`kinematicsInverse` in matrixkins.comp). A table adds its corrections to the commanded axis positions, so C is the
identity matrix plus the linear part of the table. A product such as `X_joint = C_xx X + C_xy Y + C_xz Z` adds
nothing at the machine's origin.
"""

from __future__ import annotations

import numpy as np

from twin.arrays import Array
from twin.compensation.controllers.export_format import ControllerExport, ExportFormat, ExportSource
from twin.compensation.controllers.format_options import ExportOptions
from twin.compensation.controllers.linear_part import linear_part, require_worthwhile
from twin.machine.kinematic_chain import AXES

FILE = "matrixkins.hal"
_DECIMALS = 12

LOSSES = (
    "everything but scale and squareness: pitch, straightness, rotation and cross-effect",
    "the constant part: nothing is added at the machine's origin, so positions shift there against the table",
)


def export(source: ExportSource, choices: ExportOptions) -> ControllerExport:
    """Return the export of a compensation table as the text of the HAL file `matrixkins.hal`, which sets the matrix,
    and of the line for the INI file of LinuxCNC.
    """
    added = np.round(linear_part(source.table), _DECIMALS)

    def correction(axis_positions: Array) -> Array:
        return np.asarray(axis_positions @ added.T, dtype=np.float64)

    share = require_worthwhile(source.table, correction, "matrixkins")
    # Rounded values, so that `correction` describes exactly what the file does.
    written = np.eye(3) + choices.sign * added
    lines = [
        f"setp matrixkins.C_{joint.lower()}{axis.lower()} {written[row, column] + 0.0:.{_DECIMALS}f}\n"
        for row, joint in enumerate(AXES)
        for column, axis in enumerate(AXES)
    ]
    files = {FILE: "".join(lines), "ini-lines.txt": f"[KINS]\nKINEMATICS = matrixkins\n[HAL]\nHALFILE = {FILE}\n"}
    return ControllerExport(files, correction, LOSSES, {"linear_share_percent": share})


FORMAT = ExportFormat("linuxcnc-matrixkins", export)
