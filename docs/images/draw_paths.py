"""Draw the tip's path through one position from above, plain and proved free: docs/images/paths.png.

.venv/bin/python docs/images/draw_paths.py
"""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl
import numpy as np

mpl.use("Agg")
import matplotlib.pyplot as plt

from agent.planning.case_file import CASE_STUDY, load_case
from agent.planning.cycle_time import without_optimisation
from agent.planning.job import Job
from agent.planning.preview.tip_path import Waypoint, walk_waypoints
from twin.artefact.position_set import Position

SHOWN = Position(1, 0.0, 45.0)
KEY = "measure/station-1/az0-el45"
BLUE, GREY, RED = "#1f5fa8", "#b8b8b8", "#c8482e"


def ways(job: Job) -> tuple[np.ndarray, float]:
    """(n, 3) of the tip through the position, the way to it included, and the minutes that it takes."""
    walked: tuple[Waypoint, ...] = walk_waypoints(job)
    own = [index for index, waypoint in enumerate(walked) if waypoint.step.key.startswith(KEY + "/")]
    before = walked[own[0] - 1]
    tips = [before.tip_mm, *(walked[index].tip_mm for index in own)]
    return np.array(tips), (walked[own[-1]].ends_s - before.ends_s) / 60.0


def main() -> None:
    case = load_case(CASE_STUDY)
    balls = case.layout.nominal(SHOWN) + case.tool_offset_mm
    figure, axes = plt.subplots(2, 1, figsize=(9.0, 6.6), sharex=True, sharey=True, layout="constrained")
    jobs = (
        (without_optimisation(case), "plain: retract, retreat plane, park"),
        (case, "proved: the fastest that is free"),
    )
    for axis, (job, title) in zip(axes, jobs, strict=True):
        path, minutes = ways(job)
        axis.plot(path[:, 0], path[:, 1], color=BLUE, linewidth=0.9, label="stylus tip")
        axis.plot(balls[:, 0], balls[:, 1], "o", color=RED, markersize=5, label="balls")
        axis.axhline(250.0, color=GREY, linestyle="--", linewidth=0.8, label="retreat plane")
        axis.set_title(f"{title}: {minutes:.2f} min", loc="left", fontsize=10)
        axis.set_ylabel("Y / mm")
        axis.grid(color="#eeeeee")
        axis.spines[["top", "right"]].set_visible(False)
    axes[0].legend(loc="center right", frameon=False, fontsize=9)
    axes[1].set_xlabel("X / mm")
    figure.savefig(Path(__file__).with_name("paths.png"), dpi=130)


if __name__ == "__main__":
    main()
