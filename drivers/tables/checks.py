"""Checks of a compensation table before it is staged."""

from __future__ import annotations

import math

import numpy as np

from drivers.roles import StoreLimits, TableImage


def limits_violation(limits: StoreLimits, table: TableImage) -> str:
    """Return the reason why a compensation store with the limits `limits` cannot store a table, or an empty string if
    it can.
    """
    if any(have > most for have, most in zip(table.shape, limits.max_nodes, strict=True)) or (
        math.prod(table.shape) > limits.max_total_nodes
    ):
        return f"grid {table.shape} exceeds {limits.max_nodes} nodes per axis, or {limits.max_total_nodes} in total"
    # Both are float64 of a decimal number; only their last bits may differ.
    if not math.isclose(table.resolution_mm, limits.resolution_mm, rel_tol=1e-9):
        return f"one count of the table is {table.resolution_mm} mm, one of the controller {limits.resolution_mm} mm"
    largest_mm = float(np.max(np.abs(table.counts.astype(np.int64)), initial=0)) * table.resolution_mm
    if largest_mm > limits.max_correction_mm * (1.0 + 1e-9):
        return f"correction of {largest_mm} mm exceeds the largest allowed, {limits.max_correction_mm} mm"
    return ""


def table_defect(table: TableImage, max_slope: float) -> str:
    """Return the reason why a table is invalid, or an empty string if the table is valid.

    A table is invalid if its grid is empty, a number is not finite, or a grid step is not positive. It is also invalid
    if the slope of the correction between two neighbouring nodes exceeds `max_slope`, in mm of correction per mm.
    """
    if min(table.shape) < 1:
        return f"grid {table.shape} has no nodes"
    if not all(map(math.isfinite, (*table.origin_mm, *table.step_mm))) or min(table.step_mm) <= 0.0:
        return f"origin {table.origin_mm} and step {table.step_mm} do not define a grid"
    for axis, step_mm in enumerate(table.step_mm):
        # 64 bits, because the difference of two int32 may overflow.
        rise_mm = np.abs(np.diff(table.counts.astype(np.int64), axis=axis)) * table.resolution_mm
        slope = float(np.max(rise_mm, initial=0.0)) / step_mm
        if slope > max_slope:
            return f"corrections change by {slope:.3g} mm per mm along {'XYZ'[axis]}; at most {max_slope:g} is allowed"
    return ""
