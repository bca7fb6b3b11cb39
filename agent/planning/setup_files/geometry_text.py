"""Sections `[mount]` and `[probe]`, which settings and scenario have in common."""

from __future__ import annotations

from agent.planning.setup_files.toml_text import TomlText
from agent.planning.setup_proposal.machine_setup import MachineSetup
from agent.planning.setup_proposal.station_setup import StationSetup

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
    text.key("shaft_mm", stations.shaft_mm, "from the azimuth axis to the axis of the bar, along the holders")
    if machine.spindle.is_vertical:
        text.key("shaft_direction", [0.0, 0.0, 1.0], "in the artefact frame: the bar stands above the azimuth axis")
    text.key("pedestal_radius_mm", stations.pedestal_radius_mm, "post under the azimuth axis, down to the table")
    text.key("head_mm", stations.head_mm, "top of the post above the place of the mount")
    table = "height of the table surface, workpiece frame (axis position + tool offset)"
    text.key("table_z_mm", stations.table_z_mm, f"{table}; {stations.origins['table_z_mm']}")


def add_probe(text: TomlText, machine: MachineSetup) -> None:
    """Add the section `[probe]`."""
    text.section("probe", "Dimensions of the probe for the collision check. Proposed: measure yours.")
    for name, value in machine.probe.items():
        text.key(name, value, PROBE_COMMENTS[name])
