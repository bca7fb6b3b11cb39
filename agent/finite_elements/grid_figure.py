"""Figure of deflection grids: the plane of Y and Z in the middle of X, and the line along X through its middle."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from agent.figures.style import MARKERS, SERIES, Picture, headed, picture
from twin.arrays import Array
from twin.finite_elements.tool_displacements import middle_of
from twin.machine.deflection import DeflectionGrid
from twin.units import UM_PER_MM

_WIDTH_IN, _ROW_IN, _HEADING_IN = 9.6, 2.9, 0.4
_FINE = 81
_COMPONENTS = ("ux", "uy", "uz")


def draw_grids(grids: Mapping[str, DeflectionGrid], heading: str, filled_mm: Array | None = None) -> Picture:
    """Return the figure of one or more deflection grids, one row for each with its name. The axis positions `filled_mm`
    (m, 3) in mm, nodes that were interpolated from others, are marked with circles."""

    def draw(figure: Figure) -> None:
        rows = figure.subplots(len(grids), 3, squeeze=False, width_ratios=(1.0, 1.0, 1.15))
        for panels, (name, grid) in zip(rows, grids.items(), strict=True):
            for panel, component in zip(panels[:2], (1, 2), strict=True):
                _draw_plane(figure, panel, grid, component, filled_mm)
            panels[0].set_title(name)
            _draw_line(panels[2], grid)

    size = (_WIDTH_IN, _HEADING_IN + _ROW_IN * len(grids))
    return picture("deflection", headed(draw, heading), size)


def _draw_plane(figure: Figure, panel: Any, grid: DeflectionGrid, component: int, filled_mm: Array | None) -> None:
    y, z = (np.linspace(nodes[0], nodes[-1], _FINE) for nodes in grid.nodes[1:])
    inner_y, inner_z = np.meshgrid(y, z, indexing="ij")
    x = np.full(inner_y.size, middle_of(grid)[0])
    values = UM_PER_MM * grid.at(np.column_stack((x, inner_y.ravel(), inner_z.ravel())))[:, component]
    mesh = panel.pcolormesh(y, z, values.reshape(inner_y.shape).T, shading="gouraud", rasterized=True)
    if filled_mm is not None and len(filled_mm):
        panel.plot(filled_mm[:, 1], filled_mm[:, 2], "o", fillstyle="none", color="white", clip_on=False)
    panel.grid(visible=False)
    panel.set(xlabel="Y / mm", ylabel="Z / mm")
    figure.colorbar(mesh, ax=panel, label=f"{_COMPONENTS[component]} / µm", pad=0.02, aspect=18)


def _draw_line(panel: Any, grid: DeflectionGrid) -> None:
    x = grid.x
    _, y, z = middle_of(grid)
    values = UM_PER_MM * grid.at(np.column_stack((x, np.full(x.size, y), np.full(x.size, z))))
    for component, name in enumerate(_COMPONENTS):
        panel.plot(x, values[:, component], marker=MARKERS[component], color=SERIES[component], label=name)
    low, high = float(values.min()), float(values.max())
    if high - low < 0.1:  # a line that does not vary is not a mountain of rounding errors
        panel.set_ylim(0.5 * (low + high) - 0.1, 0.5 * (low + high) + 0.1)
    panel.set(xlabel="X / mm", ylabel="displacement / µm")
    panel.set_title("in the middle of Y and Z", fontweight="normal", fontsize=8.5)
    panel.legend(ncols=3, loc="upper center", bbox_to_anchor=(0.5, -0.2))
