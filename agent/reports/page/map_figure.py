"""Figure with maps of the workspace. A map shows the length of the deviation, or its uncertainty, over an XY plane;
there are maps at several heights."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.image import AxesImage

from agent.figures.style import INK, MAP_COLOURS, Drawing, Margins
from agent.reports.page.workspace_maps import PlaneMap

WIDTH_IN = 10.4
GAP_IN = 0.25
BAR_IN = 0.12
ROOM = Margins(right=0.5, bottom=0.38)
HIGHEST_IN = 4.0


def draw_planes(name: str, planes: Sequence[PlaneMap], label: str, *, dots: bool) -> str:
    """Return an SVG with the maps of all `planes` (XY planes of the workspace) side by side. All maps have one colour
    scale, which starts at zero. If `dots` is set, the measured balls are drawn as dots."""
    top = max(float(plane.length_um.max()) for plane in planes) or 1.0
    width, high = _panel_size(planes)
    total = high + ROOM.bottom + ROOM.top
    drawing = Drawing(name, WIDTH_IN, total)
    with drawing as figure:

        def box(left: float, across: float) -> tuple[float, float, float, float]:
            return left / WIDTH_IN, ROOM.bottom / total, across / WIDTH_IN, high / total

        for count, plane in enumerate(planes):
            panel = figure.add_axes(box(ROOM.left + count * (width + GAP_IN), width))
            image = _draw(panel, plane, top, dots)
            panel.set_xlabel("X / mm", labelpad=1)
            if count:
                panel.tick_params(labelleft=False)
            else:
                panel.set_ylabel("Y / mm")
        end = ROOM.left + len(planes) * (width + GAP_IN)
        bar = figure.colorbar(image, cax=figure.add_axes(box(end - 0.1, BAR_IN)))
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


def _panel_size(planes: Sequence[PlaneMap]) -> tuple[float, float]:
    """Return the width and height in inches with which panels of equal X and Y scale fill the page."""
    plane = planes[0]
    ratio = float(np.ptp(plane.y_mm) / np.ptp(plane.x_mm))
    width = (WIDTH_IN - ROOM.left - ROOM.right - BAR_IN) / len(planes) - GAP_IN
    high = min(width * ratio, HIGHEST_IN)
    return high / ratio, high
