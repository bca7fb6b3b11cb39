"""LinuxCNC `COMP_FILE`, type 0. There is one file per joint, with three numbers per row.

A row contains the numbers `nominal`, `forward` and `reverse`, and the rows are in ascending order of `nominal`. The
motion module computes the trim, which is `nominal` minus `forward`, and adds it to the motor's command
(`usrmotLoadComp` in usrmotintf.cc, `compute_screw_comp` in control.c). LinuxCNC stops reading at the first row that
does not consist of three numbers, without a message. The file therefore has neither a header nor comments.
"""

from __future__ import annotations

from twin.arrays import Array
from twin.compensation.controllers.export_format import ControllerExport, ExportFormat, ExportSource
from twin.compensation.controllers.format_options import REFERENCE_MM, ExportOptions
from twin.compensation.controllers.grids import reference_point, require_points
from twin.compensation.controllers.reduction import Profile, own_axis_profiles, round_profile, sum_of_own_axis_profiles
from twin.machine.kinematic_chain import AXES

MOST_ROWS = 256
_DECIMALS = 7

LOSSES = (
    "straightness, squareness and rotation: a joint is corrected by its own position only",
    "the correction acts while the joint moves, and BACKLASH of the joint is ignored",
)


def export(source: ExportSource, choices: ExportOptions) -> ControllerExport:
    """Return the export of a compensation table as the texts of `x.comp`, `y.comp` and `z.comp`, and of a file with the
    lines to be added to the INI file of LinuxCNC.
    """
    table = source.table
    require_points(table, (MOST_ROWS, MOST_ROWS, MOST_ROWS), "a COMP_FILE")
    profiles = [
        round_profile(one, _DECIMALS) for one in own_axis_profiles(table, reference_point(table, choices[REFERENCE_MM]))
    ]
    files = {f"{letter.lower()}.comp": _rows(one, choices.sign) for letter, one in zip(AXES, profiles, strict=True)}
    files["ini-lines.txt"] = "".join(
        f"[JOINT_{joint}]\nCOMP_FILE = {letter.lower()}.comp\nCOMP_FILE_TYPE = 0\n" for joint, letter in enumerate(AXES)
    )

    def correction(axis_positions: Array) -> Array:
        return sum_of_own_axis_profiles(profiles, axis_positions)

    return ControllerExport(
        files, correction, LOSSES, {"rows_x": len(table.x), "rows_y": len(table.y), "rows_z": len(table.z)}
    )


def _rows(profile: Profile, sign: int) -> str:
    lines = []
    for nominal, value in zip(profile.nodes.tolist(), profile.values.tolist(), strict=True):
        # The trim that LinuxCNC adds is nominal - forward, so forward = nominal - correction.
        position = f"{nominal - sign * value:.{_DECIMALS}f}"
        lines.append(f"{nominal:.6f} {position} {position}")
    return "\n".join(lines) + "\n"


FORMAT = ExportFormat("linuxcnc-comp", export)
