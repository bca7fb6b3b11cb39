"""Map of the length of the deviation vector over one XY plane of the workspace."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.image import AxesImage

from agent.figures.style import MAP_COLOURS
from twin.arrays import Array
from twin.machine.error_model import Ranges

MAP_HEIGHT_MM = 800.0
PLANE_SHAPE = (81, 27)


@dataclass(frozen=True, eq=False)
class Plane:
    """Values of a map of the length of the deviation vector over one XY plane of the workspace. `length_um` is an array
    (nx, ny) with this length in µm at each node of a grid. The grid has nx nodes along X (`x_mm`) and ny nodes along Y
    (`y_mm`).
    """

    title: str
    x_mm: Array
    y_mm: Array
    length_um: Array


def map_nodes(ranges_mm: Ranges) -> tuple[Array, Array, float]:
    """Return the X coordinates, the Y coordinates and the height Z, all in mm, of the nodes of a map over one XY plane.
    The height is `MAP_HEIGHT_MM` (800 mm), as in a published map. If the machine does not reach this height, the middle
    of its Z range is returned instead.
    """
    x, y, (low, high) = ranges_mm
    height_mm = MAP_HEIGHT_MM if low <= MAP_HEIGHT_MM <= high else 0.5 * (low + high)
    return np.linspace(*x, PLANE_SHAPE[0]), np.linspace(*y, PLANE_SHAPE[1]), height_mm


def draw_plane(axes: Axes, plane: Plane, top_um: float) -> AxesImage:
    """Draw the map `plane` of the length of the deviation in colours, with contour lines. The colour scale extends from
    zero to `top_um`.
    """
    extent = (plane.x_mm[0], plane.x_mm[-1], plane.y_mm[0], plane.y_mm[-1])
    values = plane.length_um.T
    image = axes.imshow(
        values, origin="lower", extent=extent, cmap=MAP_COLOURS, vmin=0.0, vmax=top_um, interpolation="bilinear"
    )
    lines = axes.contour(plane.x_mm, plane.y_mm, values, 6, colors="white", linewidths=0.6, alpha=0.8)
    axes.clabel(lines, fmt="%g", fontsize=7)
    axes.set_title(plane.title)
    axes.set_xlabel("X / mm")
    axes.set_ylabel("Y / mm")
    axes.grid(visible=False)
    axes.spines[:].set_visible(True)
    return image
