"""Klipper `[skew_correction]`: three skew factors, as a profile for printer.cfg and as the command SET_SKEW.

Klipper moves to `x - y·xy - z·(xz - xy·yz)` and `y - z·yz` instead of x and y (`calc_skew` in skew_correction.py). A
factor is the tangent of the angle by which the second axis leans towards the first. SET_SKEW does not take factors but
lengths that were measured on a printed parallelogram ABCD: its diagonals AC and BD and its side AD. The lengths written
here are those of a rhombus with the skew.
"""

from __future__ import annotations

import math

import numpy as np

from twin.arrays import Array
from twin.compensation.controllers.export_format import ControllerExport, ExportFormat, ExportSource
from twin.compensation.controllers.format_options import ExportOptions
from twin.compensation.controllers.linear_part import linear_part, require_worthwhile, shears

PROFILE = "volcal"
SIDE_MM = 100.0
_DECIMALS = 9

LOSSES = (
    "everything but squareness: scale, pitch, straightness, rotation and cross-effect",
    "the constant part: nothing is added at the machine's origin, so positions shift there against the table",
)


def export(source: ExportSource, choices: ExportOptions) -> ControllerExport:
    """Return the export of a compensation table as the texts of `skew-profile.cfg`, for printer.cfg, and of
    `set-skew.gcode`, which sets the same factors until Klipper restarts.
    """
    matrix = linear_part(source.table)
    factors = _factors(matrix)
    added = _added(factors)

    def correction(axis_positions: Array) -> Array:
        return np.asarray(axis_positions @ added.T, dtype=np.float64)

    share = require_worthwhile(source.table, correction, "skew_correction")
    written = _factors(choices.sign * matrix)
    profile = "".join(
        f"{plane}_skew = {factor + 0.0:.{_DECIMALS}f}\n"
        for plane, factor in zip(("xy", "xz", "yz"), written, strict=True)
    )
    words = " ".join(
        f"{plane}={','.join(f'{length:.{_DECIMALS}f}' for length in _lengths(factor))}"
        for plane, factor in zip(("XY", "XZ", "YZ"), written, strict=True)
    )
    files = {
        "skew-profile.cfg": f"[skew_correction]\n\n[skew_correction {PROFILE}]\n{profile}",
        "set-skew.gcode": f"SET_SKEW {words}\n",
    }
    facts: dict[str, str | int | float] = {"linear_share_percent": share, "load": f"SKEW_PROFILE LOAD={PROFILE}"}
    return ControllerExport(files, correction, LOSSES, facts)


def _factors(matrix: Array) -> tuple[float, float, float]:
    """Return Klipper's factors xy, xz and yz, as written, with which it adds the shears of `matrix`."""
    xy, xz, yz = (-shear for shear in shears(matrix))
    # Klipper adds -(f_xz - f_xy·f_yz) z to x, which is -xz·z for f_xz = xz + xy·yz.
    return round(xy, _DECIMALS), round(xz + xy * yz, _DECIMALS), round(yz, _DECIMALS)


def _added(factors: tuple[float, float, float]) -> Array:
    xy, xz, yz = factors
    return np.array([[0.0, -xy, -(xz - xy * yz)], [0.0, 0.0, -yz], [0.0, 0.0, 0.0]])


def _lengths(factor: float) -> tuple[float, float, float]:
    """Return AC, BD and AD of a rhombus with a skew factor: Klipper computes the factor as tan(90° - angle at A)."""
    # With A the angle at A: factor = cot A, so cos A = factor / √(1 + factor²). The diagonals of a rhombus with the
    # side s follow from the law of cosines: AC² = 2 s² (1 + cos A) and BD² = 2 s² (1 - cos A).
    cosine = factor / math.hypot(1.0, factor)
    return SIDE_MM * math.sqrt(2.0 + 2.0 * cosine), SIDE_MM * math.sqrt(2.0 - 2.0 * cosine), SIDE_MM


FORMAT = ExportFormat("klipper-skew", export)
