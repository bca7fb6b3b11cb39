"""Text of the machine file of a new machine."""

from __future__ import annotations

from agent.planning.setup_files.toml_text import TomlText
from agent.planning.setup_proposal.error_family import propose_family
from agent.planning.setup_proposal.machine_setup import MachineSetup
from agent.planning.setup_proposal.spindle import spindle_name
from twin.machine.kinematic_chain import AXES

FAMILY_COMMENTS = {
    "positioning_um": "error along each axis, by Legendre order 1, 2, …",
    "straightness_um": "errors across each axis, by Legendre order 2, 3, …",
    "rotation_urad": "pitch, yaw and roll of each axis, by Legendre order 1, 2, …",
    "squareness_urad": "deviation of each pair of axes from 90°",
    "cross_displacement_um": "bending of the machine as its ram extends: displacement",
    "cross_rotation_urad": "the same: rotation",
}


def machine_text(machine: MachineSetup) -> str:
    """Return the machine file, in which every line is explained and has the origin of its value."""
    text = TomlText()
    origin = machine.origins.get
    text.comment(
        f"{machine.name}: {machine.kind.description}. Written by `volcal init`; every value may be changed. Paths in "
        "this file are relative to it. All keys: docs/reference/files.md."
    )
    text.key("name", machine.name, "appears in every report, table and history of this machine")
    text.key("chain", machine.chain, _with("from the tool to the workpiece", origin("chain")))
    for index, letter in enumerate(AXES):
        text.section(f"axes.{letter}")
        low, high = machine.limits_mm[index]
        text.key(
            "range_mm",
            [float(low), float(high)],
            _with("axis positions at the ends of the travel (soft limits)", origin("limits_mm")),
        )
        text.key("rapid_mm_per_min", machine.rapid_mm_per_min[index], _with("rapid", origin("rapid_mm_per_min")))
        text.key("feed_mm_per_min", machine.feed_mm_per_min[index], _with("feed", origin("feed_mm_per_min")))
        text.key(
            "acceleration_mm_per_s2",
            machine.acceleration_mm_per_s2[index],
            _with("for predicted minutes", origin("acceleration_mm_per_s2")),
        )
    text.section("tools.probe", "Vector from the ram reference (spindle nose) to the stylus centre.")
    text.key(
        "offset_mm",
        [float(value) for value in machine.tool_offset_mm],
        _with(f"stylus {machine.stylus_mm:g} mm along {spindle_name(machine.spindle)}", origin("stylus_mm")),
    )
    text.section("model", "Model of the geometric errors that is identified from the measurements.")
    text.key("order", 5, "highest Legendre order of each error along its axis")
    text.key(
        "cross_effect", machine.kind.cross_effect, "whether a ram that extends bends the machine (large ram machines)"
    )
    text.section(
        "model.family",
        f"How large the errors of such a machine may be: half-widths of the prior, lowest order first. Proposed for "
        f"class {machine.kind.name} with a longest axis of {max(machine.travel_mm):g} mm, as "
        f"{machine.kind.tolerance_share:g} times reference tolerances of the size that acceptance tests of machining "
        "centres allow, scaled with the length of the axis. Typical values, neither those of a standard nor measured "
        "on this machine: the report of a run says how well they agree with it.",
    )
    for name, value in propose_family(machine.kind, machine.travel_mm).items():
        text.key(name, value, FAMILY_COMMENTS[name])
    return str(text)


def _with(meaning: str, origin: str | None) -> str:
    return f"{meaning}; {origin}" if origin else meaning
