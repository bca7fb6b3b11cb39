"""Draw docs/images/mount-angles.png: zero and sense of azimuth and elevation, and the order in which they turn.

.venv/bin/python docs/images/draw_mount_angles.py
"""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl
import numpy as np

mpl.use("Agg")
import matplotlib.pyplot as plt

BLUE, GREY, RED = "#1f5fa8", "#8a8a8a", "#c8482e"
BAR_MM = 1.0
CASES = ((0.0, 0.0), (45.0, 0.0), (0.0, 45.0), (45.0, 45.0))


def bar_direction(azimuth_deg: float, elevation_deg: float) -> np.ndarray:
    """Return the direction (3,) of the artefact's X axis: elevation about its own Y axis, then azimuth about Z."""
    az, el = np.radians([azimuth_deg, elevation_deg])
    return np.array([np.cos(az) * np.cos(el), np.sin(az) * np.cos(el), np.sin(el)])


def draw(axes: plt.Axes, azimuth_deg: float, elevation_deg: float) -> None:
    """Draw the machine axes, the arcs of both angles and the artefact's X axis into 3-D `axes`."""
    for direction, name in zip(np.eye(3), "XYZ", strict=True):
        axes.quiver(0, 0, 0, *direction, color=GREY, arrow_length_ratio=0.08, linewidth=1)
        axes.text(*(1.1 * direction), name, color=GREY)
    turned = np.linspace(0.0, azimuth_deg, 30)
    axes.plot(*np.array([0.6 * bar_direction(a, 0.0) for a in turned]).T, color=BLUE)
    raised = np.linspace(0.0, elevation_deg, 30)
    axes.plot(*np.array([0.8 * bar_direction(azimuth_deg, e) for e in raised]).T, color=RED)
    bar = bar_direction(azimuth_deg, elevation_deg)
    axes.quiver(0, 0, 0, *(BAR_MM * bar), color="black", arrow_length_ratio=0.1, linewidth=3)
    axes.set_title(f"azimuth {azimuth_deg:g}°, elevation {elevation_deg:g}°", fontsize=9)
    axes.set_box_aspect((1, 1, 1))
    axes.set(xlim=(0, 1), ylim=(0, 1), zlim=(0, 1))
    axes.view_init(elev=22, azim=-60)
    axes.set_axis_off()


def main() -> None:
    figure = plt.figure(figsize=(9.0, 2.9), dpi=110)
    for number, (azimuth_deg, elevation_deg) in enumerate(CASES, start=1):
        draw(figure.add_subplot(1, len(CASES), number, projection="3d"), azimuth_deg, elevation_deg)
    figure.subplots_adjust(left=0.0, right=1.0, bottom=0.0, top=0.9, wspace=0.0)
    figure.savefig(Path(__file__).parent / "mount-angles.png")


if __name__ == "__main__":
    main()
