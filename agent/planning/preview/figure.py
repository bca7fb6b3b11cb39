"""Preview of a plan as one picture with three views.

One view is three-dimensional. The other two are views to scale: from above (XY) and from one side. The side view shows
the direction of the stylus.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Polygon
from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection
from mpl_toolkits.mplot3d.axes3d import Axes3D
from scipy.spatial import ConvexHull

from agent.figures.style import AMBER, BLUE, GREEN, INK, PURPLE, QUIET, SKY, picture
from agent.planning.preview.scene import ArtefactPlacement, Preview
from twin.arrays import Array
from twin.collision.bodies import Body
from twin.collision.geometry import Box, Capsule, Shape, point
from twin.machine.kinematic_chain import AXES

SIZE_IN = (12.0, 9.0)
RED = "#d01c1f"
STEEL = "#8b97a5"
STATION_COLOURS = (BLUE, AMBER, GREEN, PURPLE, SKY, "#6a51a3", "#7a8a00", "#8c564b")
ELEVATION_DEG, AZIMUTH_DEG = 28.0, -118.0
SLAB_MM = 40.0
"""Drawn thickness of the table in mm, smaller than the real thickness to save space."""

ROOM_MM = 40.0
BEHIND_MM = 300.0
"""Length along the stylus by which the drawing extends behind the travel to show the ram."""

_SIDES = ((0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5))
_EDGES = ((0, 1), (2, 3), (4, 5), (6, 7), (0, 2), (1, 3), (4, 6), (5, 7), (0, 4), (1, 5), (2, 6), (3, 7))


def draw_png(preview: Preview) -> bytes:
    """Return a PNG image of the whole plan that `preview` contains.

    If the plan was refused because of a collision, the two bodies that would collide are marked.
    """
    return picture("plan", lambda figure: _draw(figure, preview), SIZE_IN).png


def _draw(figure: Figure, preview: Preview) -> None:
    """Draw all views at fixed locations, because the automatic layout takes seconds with so many points."""
    figure.set_layout_engine("none")
    space: Axes3D = figure.add_axes((0.14, 0.40, 0.86, 0.56), projection="3d", computed_zorder=False)
    _draw_space(space, preview)
    _draw_plane(figure.add_axes((0.06, 0.05, 0.58, 0.34)), preview, (0, 1), "XY, from above")
    side, along = ((0, 2), "XZ, along Y") if preview.frame.axis == 0 else ((1, 2), "YZ, along X")
    _draw_plane(figure.add_axes((0.71, 0.05, 0.28, 0.34)), preview, side, along)
    figure.suptitle(_title(preview), y=0.985, fontsize=11, color=RED if preview.refusal else INK)
    figure.legend(handles=_legend(preview), loc="center left", bbox_to_anchor=(0.01, 0.82))


def _title(preview: Preview) -> str:
    what = f"{preview.position_set} on {preview.machine} with {preview.artefact}"
    refusal = preview.refusal
    if refusal is None:
        return f"{what}: preflight passed, {preview.minutes:.1f} min"
    bodies = f"\ncolliding bodies: {' and '.join(refusal.bodies)}" if refusal.bodies else ""
    return f"{what}: REFUSED at step {refusal.step}{bodies}"


# ------------------------------------------------------------------ space


def _draw_space(axes: Axes3D, preview: Preview) -> None:
    corners = _corners(_slab(preview.table))
    axes.add_collection3d(Poly3DCollection([corners[list(s)] for s in _SIDES], facecolor=STEEL, alpha=0.15, zorder=0))
    travel = _corners(preview.travel)
    edges = [travel[list(edge)] for edge in _EDGES]
    axes.add_collection3d(Line3DCollection(edges, colors=QUIET, linewidths=0.7, linestyles="--", zorder=1))
    path = np.array([point.tip_mm for point in preview.path]).reshape(-1, 3)
    axes.plot(*path.T, color=INK, linewidth=0.4, alpha=0.5, zorder=2)
    for kind, colour, width in _lines(preview):
        if not len(kind):  # an artefact that is placed by hand has no mount
            continue
        axes.add_collection3d(Line3DCollection(kind, colors=colour, linewidths=width, alpha=0.75, zorder=3))
    for centres, style in _dots(preview):
        axes.plot(*centres.T, linestyle="none", zorder=5, **style)
    for body in _probe(preview):
        _probe_in_space(axes, body, _colour_of(body, preview))
    if preview.refusal:
        axes.plot(*np.array([preview.refusal.tip_mm]).T, zorder=9, **_MEETING)
    _arrange_space(axes, preview)
    for artist in (*axes.lines, *axes.collections):
        artist.set_clip_on(False)  # the square in which mplot3d draws is smaller than its axes


def _probe_in_space(axes: Axes3D, body: Body, colour: str) -> None:
    shape = body.shape
    if isinstance(shape, Box):
        corners = _corners(shape)
        faces = [corners[list(side)] for side in _SIDES]
        axes.add_collection3d(
            Poly3DCollection(faces, facecolor=colour, edgecolor=INK, linewidth=0.4, alpha=0.2, zorder=6)
        )
    else:
        axes.plot(*np.array([shape.a, shape.b]).T, color=colour, linewidth=_width(shape.radius), zorder=7)


def _arrange_space(axes: Axes3D, preview: Preview) -> None:
    low, high = _extent(preview)
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    axes.set_box_aspect(high - low, zoom=1.38)
    axes.set_proj_type("ortho")
    axes.view_init(ELEVATION_DEG, AZIMUTH_DEG)
    axes.set(xlabel="X / mm", ylabel="Y / mm", zlabel="Z / mm")
    axes.locator_params(nbins=4, axis="y")
    axes.locator_params(nbins=4, axis="z")


# ------------------------------------------------------------------ planes


def _draw_plane(axes: Axes, preview: Preview, plane: tuple[int, int], title: str) -> None:
    travel, table = _hull(preview.travel, plane), _hull(_slab(preview.table), plane)
    axes.add_patch(Polygon(travel, fill=False, edgecolor=QUIET, linestyle="--", linewidth=0.7))
    axes.add_patch(Polygon(table, facecolor=STEEL, edgecolor=QUIET, alpha=0.15, linewidth=0.7))
    path = np.array([point.tip_mm for point in preview.path]).reshape(-1, 3)[:, plane]
    axes.plot(*path.T, color=INK, linewidth=0.4, alpha=0.4)
    for kind, colour, width in _lines(preview):
        axes.add_collection(LineCollection(list(kind[:, :, plane]), colors=colour, linewidths=width, alpha=0.7))
    for centres, style in _dots(preview):
        axes.plot(*centres[:, plane].T, linestyle="none", **style)
    for body in _probe(preview):
        _probe_in_plane(axes, body, plane, _colour_of(body, preview))
    if preview.refusal:
        axes.plot(*np.array([preview.refusal.tip_mm])[:, plane].T, **_MEETING)
    low, high = _extent(preview)
    behind = BEHIND_MM * preview.frame.stylus_axis
    low, high = low - np.maximum(behind, 0.0), high - np.minimum(behind, 0.0)
    u, v = plane
    axes.set(xlim=(low[u], high[u]), ylim=(low[v], high[v]), aspect="equal")
    axes.set_title(title)
    axes.set_xlabel(f"{AXES[plane[0]]} / mm")
    axes.set_ylabel(f"{AXES[plane[1]]} / mm")


def _probe_in_plane(axes: Axes, body: Body, plane: tuple[int, int], colour: str) -> None:
    shape = body.shape
    if isinstance(shape, Box):
        axes.add_patch(Polygon(_hull(shape, plane), facecolor=colour, edgecolor=INK, alpha=0.3, linewidth=0.6))
    else:
        ends = np.array([shape.a, shape.b])[:, plane]
        axes.plot(*ends.T, color=colour, linewidth=_width(shape.radius), solid_capstyle="round")


def _hull(box: Box, plane: tuple[int, int]) -> Array:
    flat = _corners(box)[:, plane]
    outline: Array = flat[ConvexHull(flat).vertices]
    return outline


# ------------------------------------------------------------------ common to both

_MEETING: dict[str, Any] = {
    "marker": "o",
    "markersize": 12,
    "markerfacecolor": "none",
    "color": RED,
    "markeredgewidth": 2,
}


def _lines(preview: Preview) -> Iterable[tuple[Array, str, float]]:
    """Yield segments (n, 2, 3), colour and line width for each group of bodies: the mounts, then the artefacts of
    each station with their posts, then the colliding bodies in red."""
    yield _segments(preview.placements, ("pedestal",)), STEEL, 4.0
    yield _segments(preview.placements, ("shaft",)), STEEL, 2.0
    for number, station in enumerate(preview.stations):
        there = [placement for placement in preview.placements if placement.position.station == station]
        colour = STATION_COLOURS[number % len(STATION_COLOURS)]
        yield _carriers(there), colour, 1.8
        yield _segments(there, ("post ",)), colour, 0.6
    if preview.refusal:
        hit = preview.placements[preview.visits[preview.refusal.visit].placement]
        struck = tuple(body for body in hit.bodies if body.name in preview.refusal.bodies)
        if struck:
            yield _ends(struck), RED, 3.5


def _dots(preview: Preview) -> Iterable[tuple[Array, dict[str, Any]]]:
    """Yield ball centres (n, 3) and marker style: reachable balls filled, in the colour of their station; other balls
    hollow and red."""
    for number, station in enumerate(preview.stations):
        there = [placement for placement in preview.placements if placement.position.station == station]
        colour = STATION_COLOURS[number % len(STATION_COLOURS)]
        yield _centres(there, reachable=True), {"marker": "o", "markersize": 2.6, "color": colour}
    hollow = {"marker": "o", "markersize": 4.6, "markerfacecolor": "none", "color": RED, "markeredgewidth": 1.1}
    yield _centres(preview.placements, reachable=False), hollow


def _legend(preview: Preview) -> list[Any]:
    stations = [
        Line2D([], [], color=STATION_COLOURS[i % len(STATION_COLOURS)], linewidth=2.5, label=f"station {station}")
        for i, station in enumerate(preview.stations)
    ]
    dot: dict[str, Any] = {"linestyle": "none", "marker": "o"}
    reached = preview.balls - preview.unreachable
    meeting = [Line2D([], [], linestyle="none", **_MEETING, label="tip at the collision")] if preview.refusal else []
    return [
        *stations,
        *meeting,
        Line2D([], [], color=INK, markersize=4, label=f"{reached} balls within reach", **dot),
        Line2D([], [], color=RED, markerfacecolor="none", label=f"{preview.unreachable} balls out of reach", **dot),
        Line2D([], [], color=INK, linewidth=0.7, label="path of the tip"),
        Line2D([], [], color=STEEL, linewidth=4, label="mount"),
        Line2D([], [], color=QUIET, linestyle="--", linewidth=0.8, label="travel of the tip"),
        Patch(facecolor=STEEL, alpha=0.3, label="table; probe and ram"),
    ]


def _extent(preview: Preview) -> tuple[Array, Array]:
    """Return the lower and the upper corner, each (3,), of the drawn space in mm."""
    balls = np.vstack([_centres(preview.placements, reachable=reached) for reached in (True, False)])
    everything = np.vstack([_corners(preview.travel), _corners(_slab(preview.table)), balls])
    return everything.min(axis=0) - ROOM_MM, everything.max(axis=0) + ROOM_MM


def _probe(preview: Preview) -> list[Body]:
    """Return the bodies of the probe at the last touch of the path, or at the collision if the plan was refused."""
    touched = [point.tip_mm for point in preview.path if point.touch]
    tip = preview.refusal.tip_mm if preview.refusal else touched[-1] if touched else None
    if tip is None:
        return []
    return [Body(body.name, _cut_off(body.shape, preview).translated(tip)) for body in preview.probe]


def _cut_off(shape: Shape, preview: Preview) -> Shape:
    """Return the ram cut off at the length `BEHIND_MM` behind its face; other shapes of the probe are not changed."""
    if not isinstance(shape, Box):
        return shape
    lower, upper = np.array(shape.lower), np.array(shape.upper)
    along = preview.frame.axis
    if preview.frame.sign < 0.0:
        upper[along] = min(upper[along], lower[along] + BEHIND_MM)
    else:
        lower[along] = max(lower[along], upper[along] - BEHIND_MM)
    return Box(point(lower), point(upper))


def _colour_of(body: Body, preview: Preview) -> str:
    if preview.refusal and body.name in preview.refusal.bodies:
        return RED
    return STEEL if isinstance(body.shape, Box) else "#b7791f"


def _segments(placements: Sequence[ArtefactPlacement], names: tuple[str, ...]) -> Array:
    """Return the axes (n, 2, 3) of the bodies whose name begins with one of `names`."""
    return _ends(body for placement in placements for body in placement.bodies if body.name.startswith(names))


def _carriers(placements: Sequence[ArtefactPlacement]) -> Array:
    """Return the axes (n, 2, 3) of the bodies that carry the posts: the bar, or the plate or frame."""
    others = ("ball ", "post ", "shaft", "pedestal")
    return _ends(body for placement in placements for body in placement.bodies if not body.name.startswith(others))


def _ends(bodies: Iterable[Body]) -> Array:
    ends = [(body.shape.a, body.shape.b) for body in bodies if isinstance(body.shape, Capsule)]
    return np.array(ends, dtype=np.float64).reshape(-1, 2, 3)


def _centres(placements: Sequence[ArtefactPlacement], *, reachable: bool) -> Array:
    """Return the centres (n, 3) of the reachable balls, or of the other balls if `reachable` is False."""
    kept = [ball.centre_mm for placement in placements for ball in placement.balls if ball.reachable is reachable]
    return np.array(kept, dtype=np.float64).reshape(-1, 3)


def _slab(table: Box) -> Box:
    (x, y, _), top = table.lower, table.upper[2]
    return Box((x, y, top - SLAB_MM), table.upper)


def _corners(box: Box) -> Array:
    """Return the corners (8, 3) of `box`."""
    low, high = np.array(box.lower), np.array(box.upper)
    bits = np.array([[i & 1, (i >> 1) & 1, i >> 2] for i in range(8)])
    corners: Array = low + bits * (high - low)
    return corners


def _width(radius_mm: float) -> float:
    """Return a line width in points that indicates the radius; it is not to scale, since thin bodies would be
    invisible."""
    return max(0.8, 0.12 * radius_mm)
