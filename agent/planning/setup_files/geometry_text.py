"""Sections `[mount]` and `[probe]`, which settings and scenario have in common."""

from __future__ import annotations

from agent.planning.setup_files.toml_text import TomlText
from agent.planning.setup_proposal.machine_setup import MachineSetup
from agent.planning.setup_proposal.spindle import holder_direction, points_up
from agent.planning.setup_proposal.station_setup import PROPOSED, STATED, StationSetup

PROBE_COMMENTS = {
    "tip_radius_mm": "radius of the stylus ball",
    "stem_length_mm": "from the stylus centre to the body of the probe",
    "body_radius_mm": "radius of the body of the probe",
    "reach_mm": "from the stylus centre to the ram face; not longer than the tool offset",
    "ram_half_width_mm": "half the width of the ram, quill or spindle nose",
    "ram_length_mm": "length of the ram that must not hit anything",
}


def add_mount(text: TomlText, machine: MachineSetup, stations: StationSetup) -> None:
    """Add the section `[mount]`."""
    text.section("mount", "Rotary mount of the artefact: dimensions for its pose and for the collision check.")
    text.key("shaft_mm", stations.shaft_mm, "from the azimuth axis to the origin of the artefact frame")
    hanging = points_up(machine.spindle)
    if machine.spindle.is_vertical:
        meaning = "in the artefact frame: it " + ("hangs below" if hanging else "stands above") + " the azimuth axis"
        text.key("shaft_direction", list(holder_direction(machine.spindle)), meaning)
    if hanging:
        text.key("hanging", True, "the mount hangs from a surface above it, and the stylus probes from below")
    text.key(
        "pedestal_radius_mm",
        stations.pedestal_radius_mm,
        "post above the azimuth axis, up to its surface"
        if hanging
        else "post under the azimuth axis, down to the table",
    )
    text.key("head_mm", stations.head_mm, "end of the post beyond the place of the mount")
    surface = "surface from which the mount hangs" if hanging else "table surface"
    table = f"height of the {surface}, workpiece frame (axis position + tool offset)"
    text.key("table_z_mm", stations.table_z_mm, f"{table}; {stations.origins['table_z_mm']}")


def add_probe(text: TomlText, machine: MachineSetup) -> None:
    """Add the section `[probe]`."""
    text.section("probe", "Dimensions of the probe for the collision check. What is proposed: measure yours.")
    for name, value in machine.probe.items():
        text.key(name, value, f"{PROBE_COMMENTS[name]}; {STATED if name in machine.stated_probe else PROPOSED}")
