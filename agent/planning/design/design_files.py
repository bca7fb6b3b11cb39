"""Files of a designed position set: one position file per tool, a file with the held-out positions, and the Pareto
front of expected error against machine time as CSV, PNG and SVG.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path

from agent.figures.heading import subject
from agent.figures.style import headed, picture
from agent.files import write_all_atomically
from agent.planning.design.design_result import DesignResult
from agent.planning.design.pareto_figure import ReferenceSet, draw_front
from agent.planning.design.pareto_front import format_front
from drivers.errors import InputError
from twin.formats.position_set_file import format_positions

FIGURE_SIZE_IN = (7.0, 4.2)


def check_target(path: Path) -> None:
    """Raise InputError if the name of `path` does not end in ``.csv``.

    `volcal calibrate` would not accept a file with a different ending as a position set.
    """
    if path.suffix != ".csv":
        raise InputError("a position set is written as CSV", hint=f"call it {path.stem}.csv", key="--out")


def write_design(found: DesignResult, rivals: Sequence[ReferenceSet], path: Path) -> list[Path]:
    """Write all files of the design into the folder that contains `path`, or none of them.

    Return the paths of the files, with the position sets first. There is one position file for each tool, because a run
    uses one tool. The existing position sets `rivals` are drawn in the figure for comparison. Every file names the
    machine and the artefact: a position set and a figure in their first line, the Pareto front in two columns.
    """
    machine, artefact = found.problem.job.machine, found.problem.job.artefact
    heading = subject(machine.name, artefact.name)
    contents: dict[str, str | bytes] = {}
    by_tool = list(found.problem.by_tool(found.positions))
    for job, positions in by_tool:
        name = path.name if len(by_tool) == 1 else f"{path.stem}-{job.settings.tool}.csv"
        contents[name] = format_positions(positions, heading)
    if found.held_out:
        contents[f"{path.stem}-verify.csv"] = format_positions(found.held_out, heading)
    draw = headed(partial(draw_front, points=found.front, rivals=rivals), heading)
    drawn = picture(path.stem, draw, FIGURE_SIZE_IN)
    contents[f"{path.stem}-front.csv"] = format_front(found.front, machine.name, artefact.name)
    contents[f"{path.stem}-front.png"] = drawn.png
    contents[f"{path.stem}-front.svg"] = drawn.svg
    write_all_atomically(path.parent, contents)
    return [path.parent / name for name in contents]
