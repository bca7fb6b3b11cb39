"""FANUC stored pitch error compensation. It uses increments, each of which is an integer number of detection units
times a magnification.

Parameters 3620 to 3624 are described with an example in the parameter manual 0i-PB (B-63980EN). According to the
manual, compensation number n belongs to an interval of the axis. This interval ends, in the positive direction, at the
reference position plus (n - P3620) × P3624. Here P3620 and P3624 are the values of parameters 3620 and 3624. The
compensation at a position is the sum of the increments from the reference point to this position.

The form of a parameter in a data file (punched data) is described in the parameter manual 30i-A (B-63950EN, 3.3). After
the parameter number, Q1 identifies the block as parameter data, A is the number of the axis, and P is the value.
Earlier controllers have no Q.

Two facts are known only from experience. The controller adds the sum to the command, and Q0 identifies pitch error data
from the 30i on.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from twin.arrays import Array
from twin.compensation.controllers.all_options import CONTROL
from twin.compensation.controllers.detection_units import (
    CountArray,
    CountUnit,
    format_reference,
    smallest_unit,
)
from twin.compensation.controllers.export_format import ControllerExport, ExportFormat, ExportSource, Facts
from twin.compensation.controllers.format_options import REFERENCE_MM, ExportOptions
from twin.compensation.controllers.grids import even_steps, reference_nodes, reference_point, require_points
from twin.compensation.controllers.reduction import own_axis_profiles, sum_of_own_axis_profiles
from twin.machine.kinematic_chain import AXES

MOST_POINTS = 128
LARGEST_INCREMENT = 7
_DATA_NUMBERS_FROM = 10000

LOSSES = (
    "straightness, squareness and rotation: an axis is corrected by its own position only",
    "whole detection units only",
)


def export(source: ExportSource, choices: ExportOptions) -> ControllerExport:
    """Return the export of a compensation table as the texts of two files: `pitch-error.txt`, which contains the
    compensation data, and `parameters.txt`, which contains the controller parameters. Both have the form of data files
    that the controller reads (punched data).
    """
    table = source.table
    require_points(table, (MOST_POINTS, MOST_POINTS, MOST_POINTS), "an axis")
    steps = even_steps(table)
    reference = reference_point(table, choices[REFERENCE_MM])
    indices = reference_nodes(table, reference)
    profiles = list(own_axis_profiles(table, reference))
    unit = smallest_unit([one.values for one in profiles], choices, LARGEST_INCREMENT, increments=True)
    counts = [unit.counts(one.values) for one in profiles]
    written = [replace(one, values=unit.values(count)) for one, count in zip(profiles, counts, strict=True)]
    # The compensation numbers of the three axes follow each other.
    firsts = np.concatenate(([0], np.cumsum([len(count) for count in counts])))[:3].tolist()
    with_q = choices[CONTROL] == "30i"
    files = {
        "pitch-error.txt": _data([choices.sign * count for count in counts], firsts, "Q0" if with_q else ""),
        "parameters.txt": _parameters(counts, firsts, indices, steps, unit, "Q1" if with_q else ""),
    }

    def correction(axis_positions: Array) -> Array:
        return sum_of_own_axis_profiles(written, axis_positions)

    facts: Facts = {"magnification": unit.magnification, "counted_from_mm": format_reference(reference)}
    return ControllerExport(files, correction, LOSSES, facts)


def _data(counts: list[CountArray], firsts: list[int], identifier: str) -> str:
    lines = ["%"]
    for count, first in zip(counts, firsts, strict=True):
        # Number n is the increment over the interval that ends at node n. No interval ends at the first node: 0.
        increments = np.diff(count, prepend=count[:1])
        numbered = enumerate(increments.tolist(), start=_DATA_NUMBERS_FROM + first)
        lines += [f"N{number}{identifier}P{value}" for number, value in numbered]
    return "\n".join([*lines, "%"]) + "\n"


def _parameters(
    counts: list[CountArray],
    firsts: list[int],
    indices: tuple[int, int, int],
    steps: tuple[float, float, float],
    unit: CountUnit,
    identifier: str,
) -> str:
    """Return lines `N number Q1 A axis P value ...` for the parameters 3620 to 3624.

    3620 is the number of the reference point, 3621 that of the farthest point in negative direction, 3622 that of the
    farthest point in positive direction, 3623 the magnification and 3624 the interval.
    """
    rows = {
        3620: [first + index for first, index in zip(firsts, indices, strict=True)],
        # The interval of the number first + 1 ends at the second node. If the reference point is the first node, no
        # interval lies in the negative direction.
        3621: [first + min(index, 1) for first, index in zip(firsts, indices, strict=True)],
        3622: [first + len(count) - 1 for first, count in zip(firsts, counts, strict=True)],
        3623: [unit.magnification] * 3,
        3624: [unit.whole(step, f"the interval of {axis}") for axis, step in zip(AXES, steps, strict=True)],
    }
    lines = [
        f"N{number:05d}{identifier}" + "".join(f"A{axis}P{value}" for axis, value in enumerate(values, start=1))
        for number, values in rows.items()
    ]
    return "\n".join(["%", *lines, "%"]) + "\n"


FORMAT = ExportFormat("fanuc-pitch", export)
