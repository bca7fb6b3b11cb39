"""Figure of the warming trial: temperatures, and the errors that remain with and without the correction of the thermal
drift.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from agent.figures.style import BLUE, GREEN, ORANGE, QUIET, picture
from agent.files import write_all_atomically
from campaigns.warming.row import WarmingRow


@dataclass(frozen=True)
class WarmingTrace:
    """Temperatures of machine and ball bar over one calibration.

    The temperatures in °C are those recorded with each measured ball, and `minutes` is the machine time at which each
    ball was measured.
    """

    minutes: tuple[float, ...]
    machine_c: tuple[float, ...]
    artefact_c: tuple[float, ...]


def draw(rows: Sequence[WarmingRow], trace: WarmingTrace, path: Path) -> None:
    """Draw the temperatures and the remaining errors of the warming trial, and write the figure to the PNG
    file `path`.
    """
    found = picture(path.stem, lambda figure: _draw(figure, rows, trace), (8.0, 3.6))
    write_all_atomically(path.parent, {path.name: found.png})


def _draw(figure: Figure, rows: Sequence[WarmingRow], trace: WarmingTrace) -> None:
    left, right = figure.subplots(1, 2, gridspec_kw={"width_ratios": [2, 3]})
    left.plot(trace.minutes, trace.machine_c, ".", color=BLUE, markersize=3, label="machine")
    left.plot(trace.minutes, trace.artefact_c, ".", color=ORANGE, markersize=3, label="bar")
    left.set_xlabel("machine time / min")
    left.set_ylabel("temperature / °C")
    left.set_title("Reported with every ball")
    left.legend(loc="lower right")
    _draw_errors(right, rows)


def _draw_errors(axes: Axes, rows: Sequence[WarmingRow]) -> None:
    place = np.arange(len(rows))
    bars = (
        ("constant, 23 °C", GREEN, [row.settled for row in rows]),
        ("while it warms by 3 K", BLUE, [row.warm for row in rows]),
        ("the same, machine taken as constant", ORANGE, [row.undrifted for row in rows]),
        ("the same, bar taken as 20 °C too", QUIET, [row.untold for row in rows]),
    )
    for number, (name, colour, values) in enumerate(bars):
        axes.bar(place + 0.2 * (number - 1.5), values, 0.19, color=colour, label=name)
    axes.set_yscale("log")
    ticks = [1, 2, 5, 10, 20, 50, 100]
    axes.set_yticks(ticks, [str(tick) for tick in ticks])
    axes.set_ylim(1.0, 30.0 * max(row.untold for row in rows))
    axes.set_xticks(place, [str(row.seed) for row in rows])
    axes.set_xlabel("machine, bar and noise of seed")
    axes.set_ylabel("true VCE, rigidly aligned / µm")
    axes.set_title("Residual error with the table")
    axes.legend(loc="upper left")
