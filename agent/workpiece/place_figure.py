"""Map of the errors that a workpiece gets at each place of the table."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from agent.figures.style import ORANGE, Picture, headed, picture
from twin.workpiece.best_place import PlaceMap
from twin.workpiece.placement import Placement

_WIDTH_IN = 7.5
_LEAST_HEIGHT_IN, _MOST_HEIGHT_IN = 2.6, 6.0
_ROOM_IN = 1.3  # for title, labels and colour bar


def draw_places(places: PlaceMap, placement: Placement, heading: str) -> Picture:
    """Return the map of the places of a workpiece, with the best one and the present one `placement` marked."""
    x, y = places.x_mm, places.y_mm
    unit = "largest error / tolerance" if places.of_tolerance else "largest error / µm"

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        mesh = axes.pcolormesh(x, y, places.criterion.T, shading="nearest" if min(len(x), len(y)) > 1 else "auto")
        best = places.best_placement.origin_mm
        axes.plot(*best[:2], "*", color="white", markeredgecolor="black", markersize=13, label="best place")
        if not np.allclose(best, placement.origin_mm):
            axes.plot(
                *placement.origin_mm[:2], "o", color=ORANGE, markeredgecolor="white", markersize=8, label="stated place"
            )
        axes.grid(visible=False)
        axes.set(xlabel="X of the origin of the workpiece / mm", ylabel="Y / mm", aspect="equal")
        axes.legend(loc="upper left", bbox_to_anchor=(0.0, -0.2), ncols=2)
        figure.colorbar(mesh, ax=axes, label=unit, pad=0.02, shrink=0.8, aspect=14)

    high = _WIDTH_IN * float(np.ptp(y)) / max(float(np.ptp(x)), 1.0) + _ROOM_IN
    size = (_WIDTH_IN, float(np.clip(high, _LEAST_HEIGHT_IN, _MOST_HEIGHT_IN)))
    return picture("places", headed(draw, heading), size)
