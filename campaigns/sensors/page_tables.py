"""Tables and figure of the documents about temperature sensors, from the stored results of the campaigns.

python -m campaigns.sensors.page_tables    # draws docs/images/temperature-sensors.png and prints the tables
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from agent.figures.style import BLUE, GREEN, ORANGE, QUIET, picture
from agent.files import write_all_atomically
from campaigns.sensors.drifting_machine import KINDS
from campaigns.sensors.judged_sensors import HOURS, JudgedMachine, machine_of, summary
from campaigns.sensors.measured_season import STATES, SeasonScore, seasons_of
from campaigns.sensors.measured_season import summary as season_summary
from campaigns.sensors.table_file import read_rows

DOCS = Path(__file__).parents[2] / "docs"
MACHINES, SEASONS = DOCS / "data" / "temperature-sensors.csv", DOCS / "data" / "temperature-hours.csv"
KIND_TEXTS = {
    "thermal": "follows column, ram and bed",
    "unrelated": "drifts for other reasons",
    "decoys": "two sensors hang in another hall",
    "stuck": "one sensor sticks",
}
STATE_TEXTS = {
    "nightly": "nightly estimate alone",
    "temperatures": "moved by temperatures",
    "positions": "two positions, no sensors",
    "both": "temperatures and two positions",
}


def stored_machines() -> list[JudgedMachine]:
    return [machine_of(row) for row in read_rows(MACHINES)]


def stored_seasons() -> list[SeasonScore]:
    return seasons_of(read_rows(SEASONS))


def machine_table(machines: Sequence[JudgedMachine]) -> str:
    """Return the table of the page about machines of all kinds."""
    lines = [
        "| machine | machines | explained | decoy or stuck sensor taken | change after 6, 12, 18 h / µm "
        "| left by the prediction / µm | inside 95 % |",
        "|---|---|---|---|---|---|---|",
    ]
    for kind in KINDS:
        found = summary([one for one in machines if one.kind == kind])
        wrong = found["decoy_taken_percent"] + found["stuck_taken_percent"]
        before, after = (", ".join(f"{value:.2f}" for value in found[name]) for name in ("drift_um", "left_um"))
        lines.append(
            f"| {KIND_TEXTS[kind]} | {found['machines']} | {found['taken_percent']:.0f} % | {wrong:.0f} % "
            f"| {before} | {after} | {found['coverage_percent']:.0f} % |"
        )
    return "\n".join(lines)


def season_table(seasons: Sequence[SeasonScore]) -> str:
    """Return the table of the page about the estimate at hours of the day."""
    found = season_summary(seasons)["true_stated_um"]
    lines = [
        "| estimate | " + " | ".join(f"after {hour} h: true, stated / µm" for hour in HOURS) + " |",
        "|---|" + "---|" * len(HOURS),
    ]
    for state in STATES:
        cells = (f"{found[str(hour)][state][0]:.2f}, {found[str(hour)][state][1]:.2f}" for hour in HOURS)
        lines.append(f"| {STATE_TEXTS[state]} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def draw(machines: Sequence[JudgedMachine], seasons: Sequence[SeasonScore], path: Path) -> None:
    """Draw both results into a PNG file."""
    found = picture(path.stem, lambda figure: _draw(figure, machines, seasons), (9.0, 3.8))
    write_all_atomically(path.parent, {path.name: found.png})


def _draw(figure: Figure, machines: Sequence[JudgedMachine], seasons: Sequence[SeasonScore]) -> None:
    left, right = figure.subplots(1, 2)
    _draw_machines(left, machines)
    _draw_seasons(right, seasons)


def _draw_machines(axes: Axes, machines: Sequence[JudgedMachine]) -> None:
    """Draw the change after 18 h and what the prediction leaves of it, one point per machine."""
    colours = dict(zip(KINDS, (BLUE, QUIET, ORANGE, GREEN), strict=True))
    for kind in KINDS:
        pairs = np.array([one.rms_um[-1] for one in machines if one.kind == kind and not one.refused])
        axes.plot(*pairs.T, "o", color=colours[kind], markersize=3.5, alpha=0.7, label=KIND_TEXTS[kind])
    ends = [0.05, 20.0]
    axes.plot(ends, ends, color=QUIET, linewidth=0.8, linestyle=":")
    axes.set(xscale="log", yscale="log", xlim=ends, ylim=(ends[0], 60.0))
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_formatter("{x:g}")
    axes.set_xlabel("change 18 h after the night / µm")
    axes.set_ylabel("left by the prediction / µm")
    axes.set_title("24 errors, sensors alone", loc="left")
    axes.legend(loc="upper left", fontsize="x-small", frameon=False)


def _draw_seasons(axes: Axes, seasons: Sequence[SeasonScore]) -> None:
    """Draw true and stated errors at the hours of the day."""
    found = season_summary(seasons)["true_stated_um"]
    for place, (state, colour) in enumerate(zip(STATES, (QUIET, ORANGE, GREEN, BLUE), strict=True)):
        at = np.arange(len(HOURS)) + 0.2 * (place - 1.5)
        true, stated = np.array([found[str(hour)][state] for hour in HOURS]).T
        axes.bar(at, true, 0.19, color=colour, label=STATE_TEXTS[state])
        stated_label = "stated" if place == 0 else None
        axes.plot(at, stated, "_", color="black", markersize=11, label=stated_label)
    axes.set_xticks(range(len(HOURS)), [f"{hour} h" for hour in HOURS])
    axes.set_ylim(0.0, 1.6 * axes.get_ylim()[1])
    axes.set_xlabel("after the last night")
    axes.set_ylabel("true VCE, rms / µm")
    axes.set_title("Measured ball by ball", loc="left")
    axes.legend(loc="upper left", fontsize="x-small", frameon=False, ncols=2)


if __name__ == "__main__":
    draw(stored_machines(), stored_seasons(), DOCS / "images" / "temperature-sensors.png")
    print(machine_table(stored_machines()), season_table(stored_seasons()), sep="\n\n")
