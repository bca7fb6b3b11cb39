"""Conversion between the compensation table of the machine model (twin) and the integers that a controller stores."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from agent.errors import GateRefused
from drivers.roles import StoreLimits, TableImage
from twin.arrays import Array
from twin.compensation.table import CompensationTable
from twin.machine.anchor import Anchor
from twin.units import UM_PER_MM


def image_of(table: CompensationTable, limits: StoreLimits) -> TableImage:
    """Return the compensation table `table` as integers in units of the resolution with which the controller stores
    tables. Raises GateRefused if the grid of the table has too many nodes for the controller, or if the controller
    applies too little of it."""
    shape = table.corrections.shape[:3]
    if any(n > most for n, most in zip(shape, limits.max_nodes, strict=True)) or (
        np.prod(shape) > limits.max_total_nodes
    ):
        raise GateRefused(
            f"a table of {shape[0]} × {shape[1]} × {shape[2]} nodes does not fit the controller "
            f"(at most {limits.max_nodes}, {limits.max_total_nodes} in total)",
            key="table.step_mm",
            hint="choose a wider step",
        )
    origin, step = zip(*((float(n[0]), float(n[1] - n[0])) for n in table.nodes), strict=True)
    _require_small_loss(table, limits)
    counts = np.rint(_applied_part(table, limits) / limits.resolution_mm).astype(np.int32)
    return TableImage((origin[0], origin[1], origin[2]), (step[0], step[1], step[2]), limits.resolution_mm, counts)


def table_as_applied(table: CompensationTable, limits: StoreLimits) -> CompensationTable:
    """Return the compensation table `table` with the corrections that the controller applies if it stores the table:
    whole multiples of its resolution and, if each axis is corrected by its own position alone, the own-axis part."""
    counts = np.rint(_applied_part(table, limits) / limits.resolution_mm)
    return replace(table, corrections=counts * limits.resolution_mm)


def _applied_part(table: CompensationTable, limits: StoreLimits) -> Array:
    """Return the corrections (nx, ny, nz, 3) in mm of `table` that the controller can apply. If it corrects each axis
    by its own position alone, these are the means over the nodes with the same position of the axis, which fit the
    table best."""
    if limits.own_axis_loss_mm is None:
        return table.corrections
    part = np.empty_like(table.corrections)
    for axis in range(3):
        others = tuple(other for other in range(3) if other != axis)
        part[..., axis] = table.corrections[..., axis].mean(axis=others, keepdims=True)
    return part


def _require_small_loss(table: CompensationTable, limits: StoreLimits) -> None:
    if limits.own_axis_loss_mm is None:
        return
    lost_mm = float(np.abs(table.corrections - _applied_part(table, limits)).max())
    if lost_mm > limits.own_axis_loss_mm + 0.5 * limits.resolution_mm:
        raise GateRefused(
            f"the controller corrects each axis by its own position alone: up to {UM_PER_MM * lost_mm:.1f} µm of the "
            f"table would be lost, {UM_PER_MM * limits.own_axis_loss_mm:.1f} µm are accepted",
            hint="compensate by external offsets or kinematics, or raise accepted_loss_um of the store",
        )


def table_of(image: TableImage, tool_offset_mm: Array) -> CompensationTable:
    """Return the compensation table with the corrections that a controller applies if it stores `image`. The controller
    interpolates between the nodes trilinearly and keeps the corrections constant outside the grid.

    A controller stores neither the anchor nor the measured region. In the returned table, the anchor is therefore the
    first node of the grid, and no node counts as extrapolated.
    """
    nodes = [
        origin + step * np.arange(count, dtype=np.float64)
        for origin, step, count in zip(image.origin_mm, image.step_mm, image.shape, strict=True)
    ]
    return CompensationTable(
        x=nodes[0],
        y=nodes[1],
        z=nodes[2],
        corrections=image.counts.astype(np.float64) * image.resolution_mm,
        tool_offset=tool_offset_mm,
        anchor=Anchor(np.array(image.origin_mm)),
        extrapolated=np.zeros(image.shape, dtype=bool),
    )
