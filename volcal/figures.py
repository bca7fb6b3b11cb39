"""Figures of an estimate. The library matplotlib is imported when the first figure is drawn."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from twin.arrays import Array
from twin.compensation.table import CompensationTable
from twin.identification import Estimate, field_uncertainty
from twin.machine.error_model import ErrorModel
from twin.machine.volumetric import evaluation_grid
from volcal.estimation import aligned_error, tool_offset

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.image import AxesImage

    from volcal.notebook_figure import NotebookFigure

SHAPE = (61, 31)
WIDTH_IN = 10.0
ROOM_IN = 1.6  # part of a figure's height for titles and labels


def error_map(
    estimate: Estimate, *, heights_mm: Sequence[float] | None = None, tool_offset_mm: ArrayLike | None = None
) -> NotebookFigure:
    """Draw the estimated machine error and its uncertainty over XY planes of the workspace, and return the matplotlib
    figure, which a notebook shows as a picture.

    The upper row shows the length of the estimated deviation in µm after the best rigid motion of the workspace has
    been removed. The lower row shows the predicted length of the deviation that remains after compensation.
    `heights_mm` contains the Z axis position of each plane. If it is None, the planes are at the bottom, the middle and
    the top of the workspace.

    >>> figure = volcal.error_map(estimate)
    >>> [axes.get_title(loc="left") for axes in figure.axes[:3]]
    ['Z = 0 mm', 'Z = 750 mm', 'Z = 1500 mm']
    """
    from volcal.notebook_figure import NotebookFigure  # noqa: PLC0415  slow to import, and needed for figures only

    model, offset = estimate.model, tool_offset(estimate, tool_offset_mm)
    heights = np.linspace(*model.ranges_mm[2], 3) if heights_mm is None else np.asarray(heights_mm, dtype=np.float64)
    points = _planes(model, heights)
    grid = evaluation_grid(model.ranges_mm)
    # The rigid motion is that of the grid on which every volumetric error is stated.
    rows = (
        ("estimated / µm", aligned_error(estimate, points, offset)),
        ("remaining / µm", field_uncertainty(estimate, points, offset, aligned_over=grid)),
    )
    figure = NotebookFigure(
        figsize=(WIDTH_IN, _height_in(*model.ranges_mm[:2], rows=2, columns=len(heights))), layout="constrained"
    )
    panels = figure.subplots(2, len(heights), sharex=True, sharey=True, squeeze=False)
    for (label, field), row in zip(rows, panels, strict=True):
        lengths_um = 1e3 * np.linalg.norm(field, axis=1).reshape(len(heights), *SHAPE)
        images = [_draw(axes, model, plane, lengths_um.max()) for axes, plane in zip(row, lengths_um, strict=True)]
        figure.colorbar(images[-1], ax=list(row), label=label, pad=0.01, aspect=12)
        row[0].set_ylabel("Y / mm")
    for axes, height in zip(panels[0], heights, strict=True):
        axes.set_title(f"Z = {height:g} mm", loc="left", fontsize=10)
    for axes in panels[-1]:
        axes.set_xlabel("X / mm")
    return figure


def table_map(table: CompensationTable) -> NotebookFigure:
    """Draw the length of the corrections of a compensation table in µm over its lowest, middle and highest XY plane of
    nodes, and return the matplotlib figure. Nodes outside the measured region are marked by dots.

    >>> figure = volcal.table_map(volcal.compensation_table(estimate, balls))
    >>> [axes.get_title(loc="left") for axes in figure.axes[:3]]
    ['Z = 0 mm', 'Z = 800 mm', 'Z = 1500 mm']
    """
    from volcal.notebook_figure import NotebookFigure  # noqa: PLC0415  slow to import, and needed for figures only

    chosen = sorted({0, len(table.z) // 2, len(table.z) - 1})
    lengths_um = 1e3 * np.linalg.norm(table.corrections, axis=3)
    height_in = _height_in(table.x, table.y, rows=1, columns=len(chosen))
    figure = NotebookFigure(figsize=(WIDTH_IN, height_in), layout="constrained")
    (row,) = figure.subplots(1, len(chosen), sharex=True, sharey=True, squeeze=False)
    for axes, index in zip(row, chosen, strict=True):
        mesh = axes.pcolormesh(
            table.x, table.y, lengths_um[:, :, index].T, vmin=0.0, vmax=float(lengths_um.max()), shading="nearest"
        )
        x, y = np.nonzero(table.extrapolated[:, :, index])
        axes.plot(table.x[x], table.y[y], ".", color="white", markersize=1.5)
        axes.set_aspect("equal")
        axes.set_title(f"Z = {table.z[index]:g} mm", loc="left", fontsize=10)
        axes.set_xlabel("X / mm")
    row[0].set_ylabel("Y / mm")
    figure.colorbar(mesh, ax=list(row), label="correction / µm", pad=0.01, aspect=12, shrink=0.7)
    if table.extrapolated[:, :, chosen].any():
        figure.supxlabel("dots: nodes outside the measured region", fontsize=9)
    return figure


def _planes(model: ErrorModel, heights: Array) -> Array:
    """Return the axis positions (n, 3) of one XY grid per height, plane by plane."""
    (x_low, x_high), (y_low, y_high), _ = model.ranges_mm
    x, y = np.linspace(x_low, x_high, SHAPE[0]), np.linspace(y_low, y_high, SHAPE[1])
    return np.concatenate([np.stack(np.meshgrid(x, y, [z], indexing="ij"), axis=-1).reshape(-1, 3) for z in heights])


def _height_in(x_mm: ArrayLike, y_mm: ArrayLike, *, rows: int, columns: int) -> float:
    """Return the height in inches of a figure with `rows` times `columns` panels that cover the positions `x_mm` and
    `y_mm`, with equal scales of X and Y."""
    return float(rows * (WIDTH_IN - 1.5) / columns * np.ptp(np.asarray(y_mm)) / np.ptp(np.asarray(x_mm))) + ROOM_IN


def _draw(axes: Axes, model: ErrorModel, lengths_um: Array, top_um: float) -> AxesImage:
    (x_low, x_high), (y_low, y_high), _ = model.ranges_mm
    extent = (x_low, x_high, y_low, y_high)
    return axes.imshow(
        lengths_um.T, origin="lower", extent=extent, vmin=0.0, vmax=top_um, cmap="viridis", interpolation="bilinear"
    )
