"""Figure of a season of nightly runs: the true volumetric error after compensation (VCE) of every morning, the true VCE
that a full calibration would leave, and the decision of every run.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from agent.figures.style import BLUE, GREEN, INK, ORANGE, PURPLE, QUIET, from_zero, picture
from agent.files import write_all_atomically
from agent.results.run_outcome import Decision
from campaigns.nights.row import NightRow

LARGEST_RATIO = 1.5


def draw(rows: Sequence[NightRow], step: int, path: Path) -> None:
    """Draw the errors and decisions of a season of nightly runs from `rows` (one for each night) and write the figure
    to the PNG file `path`. `step` is the night of the collision.
    """
    found = picture(path.stem, lambda figure: _draw(figure, rows, step), (8.0, 5.6))
    write_all_atomically(path.parent, {path.name: found.png})


def _draw(figure: Figure, rows: Sequence[NightRow], step: int) -> None:
    above, below = figure.subplots(2, 1, sharex=True, gridspec_kw={"height_ratios": [3, 1]})
    _draw_errors(above, rows, step)
    nights = [row.night for row in rows]
    below.bar(nights, [row.minutes for row in rows], color=BLUE, width=0.7)
    below.axhline(15.0, color=QUIET, linewidth=0.9, linestyle="--")
    below.annotate("slot of 15 min", (nights[-1], 15.0), (0, 3), textcoords="offset points", ha="right", color=QUIET)
    below.set_ylabel("machine time / min")
    below.set_xlabel("night")
    below.set_xlim(-0.7, nights[-1] + 0.7)


def _draw_errors(axes: Axes, rows: Sequence[NightRow], step: int) -> None:
    nights = [row.night for row in rows]
    reach = [row.reach for row in rows]
    axes.fill_between(nights, 0.0, [LARGEST_RATIO * one for one in reach], color=GREEN, alpha=0.10, linewidth=0.0)
    axes.plot(nights, [LARGEST_RATIO * one for one in reach], "--", color=GREEN, label="limit: 1.5 times that")
    axes.plot(nights, reach, "-", color=GREEN, label="a full calibration that night would reach")
    later = rows[1:]
    axes.plot(
        [row.night for row in later],
        [row.true_before for row in later],
        "o",
        color=ORANGE,
        fillstyle="none",
        label="in the evening, table of the night before",
    )
    untouched = [row.untouched for row in rows]
    axes.plot(nights, untouched, ":", color=QUIET, label="with the table of the first night only")
    axes.plot(nights, [row.true_after for row in rows], "-o", color=BLUE, label="in the morning, after the slot")
    if step < len(rows):
        _mark_step(axes, rows, step)
    from_zero(axes, "true VCE, rigidly aligned / µm")
    axes.set_ylim(0.0, 1.35 * max(*untouched, *(row.true_before for row in later), LARGEST_RATIO * max(reach)))
    axes.set_title("Thirty nights of a machine that drifts" if len(rows) == 31 else "Nights of a machine that drifts")
    axes.legend(loc="upper left", ncols=2)


def _mark_step(axes: Axes, rows: Sequence[NightRow], step: int) -> None:
    row = rows[step]
    axes.axvline(step, color=PURPLE, linewidth=0.8, linestyle=":")
    named = row.named.replace(", ", "\n") or "not noticed"
    axes.annotate(
        f"collision; the slot says:\n{named}",
        (step, row.true_after),
        (8, 4),
        textcoords="offset points",
        color=INK,
        va="bottom",
    )
    for one in rows:
        if one.decision in (Decision.FULL_DONE.value, "calibrated"):
            axes.plot(one.night, one.true_after, "s", color=BLUE, markersize=8, fillstyle="none")
