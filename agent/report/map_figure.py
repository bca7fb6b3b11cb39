"""Maps of the workspace: the length of a deviation over XY planes at several heights."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.image import AxesImage
from numpy.typing import NDArray

from agent.report.style import INK, MAP_COLOURS, Drawing

Array = NDArray[np.float64]

WIDTH_IN = 10.4


@dataclass(frozen=True)
class PlaneMap:
    """Lengths in µm, (nx, ny), over x and y in mm at height `z_mm`; `measured` (m, 2) are x, y of balls near it."""

    z_mm: float
    x_mm: Array
    y_mm: Array
    length_um: Array
    measured: Array


def draw_planes(name: str, planes: Sequence[PlaneMap], label: str, *, dots: bool) -> str:
    """SVG of the planes side by side under one colour scale that starts at zero."""
    top = max(float(plane.length_um.max()) for plane in planes) or 1.0
    drawing = Drawing(name, WIDTH_IN, _height(planes))
    with drawing as figure:
        panels = np.atleast_1d(figure.subplots(1, len(planes), sharey=True))
        for panel, plane in zip(panels, planes, strict=True):
            image = _draw(panel, plane, top, dots)
            panel.set_xlabel("X / mm", labelpad=1)
        panels[0].set_ylabel("Y / mm")
        bar = figure.colorbar(image, ax=list(panels), pad=0.01, aspect=14)
        bar.set_label(label)
        bar.outline.set_linewidth(0.4)
    return drawing.svg()


def _draw(panel: Axes, plane: PlaneMap, top: float, dots: bool) -> AxesImage:
    extent = (plane.x_mm[0], plane.x_mm[-1], plane.y_mm[0], plane.y_mm[-1])
    image = panel.imshow(
        plane.length_um.T,
        origin="lower",
        extent=extent,
        cmap=MAP_COLOURS,
        vmin=0.0,
        vmax=top,
        interpolation="bilinear",
        aspect="equal",
    )
    panel.contour(plane.x_mm, plane.y_mm, plane.length_um.T, 6, colors="white", linewidths=0.35, alpha=0.7)
    if dots and len(plane.measured):
        panel.plot(plane.measured[:, 0], plane.measured[:, 1], ".", color="white", markersize=1.6, alpha=0.9)
    panel.set_xlim(extent[:2])
    panel.set_ylim(extent[2:])
    panel.set_title(f"Z = {plane.z_mm:g} mm", loc="left", pad=3)
    panel.grid(visible=False)
    panel.spines[:].set_visible(True)
    panel.spines[:].set_edgecolor(INK)
    panel.locator_params(nbins=4)
    return image


def _height(planes: Sequence[PlaneMap]) -> float:
    """As high as equal scales on both axes need, with room for the labels."""
    plane = planes[0]
    ratio = np.ptp(plane.y_mm) / np.ptp(plane.x_mm)
    return float(np.clip(0.75 + ratio * (WIDTH_IN - 1.4) / len(planes), 1.5, 5.0))
