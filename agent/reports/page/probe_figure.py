"""Figure of the stylus qualification. It shows the residuals of all touches and the map of the pretravel, both over the
angle about the stylus."""

from __future__ import annotations

from agent.figures.report_style import BLUE, GREEN, INK, ORANGE, PURPLE, Drawing, Margins
from agent.results.facts import ProbeFacts

RING_LOOK = ((BLUE, "o"), (ORANGE, "s"), (GREEN, "^"), (PURPLE, "D"))


def draw_qualification(probe: ProbeFacts) -> str:
    """Return an SVG of the stylus qualification with one colour for each latitude on the ball. Points show the
    residuals of the touches. Lines show the map of the pretravel, which is subtracted from the touches of the run."""
    drawing = Drawing("qualification", 10.4, 2.4, Margins(right=1.9))
    with drawing as figure:
        panel = figure.subplots()
        for count, ring in enumerate(probe.rings):
            colour, marker = RING_LOOK[count % len(RING_LOOK)]
            panel.plot(
                ring.angle_deg, ring.residual_um, marker, color=colour, markersize=4, label=_name(ring.latitude_deg)
            )
            if ring.map_um.size:
                panel.plot(ring.map_angle_deg, ring.map_um, color=colour, linewidth=0.9)
        panel.axhline(0.0, color=INK, linewidth=0.6)
        panel.set_xlim(0.0, 360.0)
        panel.set_xticks(range(0, 361, 45))
        panel.set_xlabel("angle about the stylus / °")
        panel.set_ylabel("residual / µm")
        panel.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.1)
    return drawing.svg()


def _name(latitude_deg: float) -> str:
    named = {90.0: "pole", 0.0: "equator"}
    return named.get(latitude_deg, f"{latitude_deg:.0f}° above the equator")
