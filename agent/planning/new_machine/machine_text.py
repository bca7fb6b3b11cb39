"""Text of the machine file of a new machine."""

from __future__ import annotations

from agent.planning.new_machine.error_family import propose_family
from agent.planning.new_machine.fields import ACCELERATION, CHAIN, FEED, RAPID, STYLUS, TRAVEL
from agent.planning.new_machine.machine_setup import MachineSetup
from agent.planning.new_machine.spindle import spindle_name
from agent.planning.new_machine.toml_text import TomlText
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
    origin = f"; {machine.origins[STYLUS.name]}" if STYLUS.name in machine.origins else ""
    text.comment(
        f"{machine.name}: {machine.kind.description}. Written by `volcal init`; every value may be changed. Paths in "
        "this file are relative to it. All keys: docs/reference/files.md."
    )
    text.key("name", machine.name, "appears in every report, table and history of this machine")
    CHAIN.write(text, machine.chain, machine.origins)
    for index, letter in enumerate(AXES):
        text.section(f"axes.{letter}")
        TRAVEL.write(text, [float(end) for end in machine.limits_mm[index]], machine.origins)
        RAPID.write(text, machine.rapid_mm_per_min[index], machine.origins)
        FEED.write(text, machine.feed_mm_per_min[index], machine.origins)
        ACCELERATION.write(text, machine.acceleration_mm_per_s2[index], machine.origins)
    text.section("tools.probe", "Vector from the ram reference (spindle nose) to the stylus centre.")
    text.key(
        "offset_mm",
        [float(value) for value in machine.tool_offset_mm],
        f"stylus {machine.stylus_mm:g} mm along {spindle_name(machine.spindle)}{origin}",
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
