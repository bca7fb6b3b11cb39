"""SINUMERIK leadscrew and measuring system error compensation (LEC, MSEC) with `$AA_ENC_COMP`.

The source is the Function Manual Extended Functions K3, 6FC5397-1BP40-3BA1, 4.4.2. A positive value makes the axis move
in the negative direction. The compensation is linear between the points and constant beyond the first and the last
point. It is zero at the reference point. The values can be loaded only while MD32700 $MA_ENC_COMP_ENABLE is 0. The
number of points is set in MD38000 $MA_MM_ENC_COMP_MAX_POINTS.
"""

from __future__ import annotations

from twin.arrays import Array
from twin.compensation.controllers.all_options import ENCODER
from twin.compensation.controllers.export_format import ControllerExport, ExportFormat, ExportSource
from twin.compensation.controllers.format_options import (
    AXIS_NAMES,
    REFERENCE_MM,
    ExportOptions,
)
from twin.compensation.controllers.grids import even_steps, reference_point, require_points
from twin.compensation.controllers.reduction import Profile, own_axis_profiles, round_profile, sum_of_own_axis_profiles
from twin.machine.kinematic_chain import AXES

USUAL_NAMES = ("X1", "Y1", "Z1")
MOST_POINTS = 5000
DECIMALS = 6

LOSSES = ("straightness, squareness and rotation: an axis is corrected by its own position only",)


def export(source: ExportSource, choices: ExportOptions) -> ControllerExport:
    """Return the export of a compensation table as the texts of three INI files, one for each axis."""
    table, names = source.table, choices[AXIS_NAMES] or USUAL_NAMES
    require_points(table, (MOST_POINTS, MOST_POINTS, MOST_POINTS), "MD38000")
    steps = even_steps(table)
    profiles = [
        round_profile(one, DECIMALS) for one in own_axis_profiles(table, reference_point(table, choices[REFERENCE_MM]))
    ]
    files = {
        f"{name}_EEC.INI": _ini(name, profile, step, choices)
        for name, profile, step in zip(names, profiles, steps, strict=True)
    }
    facts = {f"MD38000_at_least_{name}": len(table.nodes[axis]) for axis, name in enumerate(names)}

    def correction(axis_positions: Array) -> Array:
        return sum_of_own_axis_profiles(profiles, axis_positions)

    return ControllerExport(files, correction, LOSSES, facts)


def _ini(name: str, profile: Profile, step: float, choices: ExportOptions) -> str:
    encoder = choices[ENCODER]
    lines = [
        f"%_N_{name}_EEC_INI",
        "CHANDATA(1)",
        f"; axis {AXES[profile.axis]}; load with MD32700 $MA_ENC_COMP_ENABLE[{encoder},{name}]=0",
        f"; MD38000 $MA_MM_ENC_COMP_MAX_POINTS[{encoder},{name}] must be at least {len(profile.nodes)}",
    ]
    # A positive value moves the axis in the negative direction, so the correction is written with the opposite sign.
    # Adding 0.0 turns -0.0 into 0.0.
    for index, value in enumerate((-choices.sign * profile.values + 0.0).tolist()):
        lines.append(f"$AA_ENC_COMP[{encoder},{index},{name}]={value:.{DECIMALS}f}")
    lines += [
        f"$AA_ENC_COMP_STEP[{encoder},{name}]={number(step)}",
        f"$AA_ENC_COMP_MIN[{encoder},{name}]={number(float(profile.nodes[0]))}",
        f"$AA_ENC_COMP_MAX[{encoder},{name}]={number(float(profile.nodes[-1]))}",
        f"$AA_ENC_COMP_IS_MODULO[{encoder},{name}]=0",
        "M17",
    ]
    return "\n".join(lines) + "\n"


def number(value: float) -> str:
    """Format a position with as many digits as it needs. The text contains a decimal point or an exponent, so the
    control reads it as REAL.
    """
    text = f"{value:.12g}"
    return text if "." in text or "e" in text else f"{text}.0"


FORMAT = ExportFormat("siemens-lec", export)
