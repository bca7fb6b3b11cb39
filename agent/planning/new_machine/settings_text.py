"""Texts of the settings file of a new machine and of the simulator scenario that matches it."""

from __future__ import annotations

from agent.planning.new_machine.controller_setup import (
    LINUXCNC,
    MODBUS,
    SERIAL,
    SIMULATOR_HOST,
    SIMULATOR_PORTS,
    ControllerSetup,
)
from agent.planning.new_machine.fields import PROBE_DIAMETER, STEM, TIP_DIAMETER
from agent.planning.new_machine.hand_placement import (
    TOLERANCE,
    held_out_azimuths,
    proving_stations,
)
from agent.planning.new_machine.machine_setup import PROPOSED, STATED, MachineSetup
from agent.planning.new_machine.new_setup import ARTEFACT_FILE, MACHINE_FILE, NewSetup
from agent.planning.new_machine.spindle import holder_direction, points_up
from agent.planning.new_machine.station_setup import StationSetup, outer_stations, station_axis
from agent.planning.new_machine.toml_text import TomlText
from agent.settings.schema import RELOCATION_BY_CRANE_MINUTES, RELOCATION_BY_HAND_MINUTES
from agent.settings.simulator_command import SCENARIO_FILE, simulate_command

CONTROLLER_PAGES = {
    MODBUS: "docs/how-to/plc-side-of-the-modbus-link.md",
    SERIAL: "docs/how-to/use-volcal-on-grbl.md",
    LINUXCNC: "docs/how-to/use-volcal-on-linuxcnc.md",
}
AXES_OF_MOUNT = (("azimuth", 1, 180.0), ("elevation", 2, 90.0))
"""Name, proposed CANopen node and limit in degrees of each axis of the mount."""


PROBE_COMMENTS = {
    **{field.key: field.comment for field in (TIP_DIAMETER, STEM, PROBE_DIAMETER)},
    "reach_mm": "from the stylus centre to the ram face; not longer than the tool offset",
    "ram_half_width_mm": "half the width of the ram, quill or spindle nose",
    "ram_length_mm": "length of the ram that must not hit anything",
}


def settings_text(setup: NewSetup, position_set: str) -> str:
    """Return the settings file of the agent, in which every line is explained."""
    text, machine, controller, stations = TomlText(), setup.machine, setup.controller, setup.stations
    text.comment(
        "Settings of volcal for this machine, written by `volcal init`. Every command reads this file if it is called "
        "in this directory. Paths are relative to it. All keys: docs/reference/settings.md; check a change with "
        "`volcal config check`."
    )
    text.key("machine", MACHINE_FILE, "travel, chain, tools and error family")
    text.key("artefact", ARTEFACT_FILE, "ball centres and their uncertainty")
    text.key("tool", "probe", "tool of the machine file that is used for measuring")
    text.key("state_directory", "runs", "journal, tables and reports")
    _add_clock(text, controller, has_mount=not stations.by_hand)
    _add_controller(text, machine, controller)
    if not stations.by_hand:
        _add_mount_device(text, controller)
    _add_operator(text, controller, stations)
    _add_roles(text, has_mount=not stations.by_hand)
    _add_mount(text, machine, stations)
    _add_probe(text, machine)
    _add_procedure(text, setup, position_set)
    _add_limits(text, machine, controller)
    return str(text)


def scenario_text(machine: MachineSetup, stations: StationSetup) -> str:
    """Return the scenario of a simulated machine of this family, with the same mount, probe and stations.

    Its errors are drawn from the family of the machine file with Legendre order 7, richer than the identified model.
    """
    text = TomlText()
    text.comment(
        "Scenario for `volcal simulate` and `volcal calibrate --simulated`: a machine of this family with errors of "
        "its own, which the agent does not know. All keys: docs/reference/scenario.md."
    )
    text.key("machine", MACHINE_FILE, "its travel, chain, tools and family")
    text.key("artefact", ARTEFACT_FILE, "its nominal or certified centres; the true ones differ, see below")
    text.key("tool", "probe")
    text.key("seed", 1, "of all noise, and of the errors of the mount")
    text.key("standing_at", 1, "station of mount and artefact at the start")
    text.comment("The same places, mount and probe as in the settings.")
    text.key("stations_mm", [list(place) for place in stations.places_mm])
    if stations.by_hand:
        text.section("placed_by_hand", "Errors of the person who places the artefact.")
        text.key("error_mm", 2.0)
        text.key("error_deg", 0.5)
    _add_mount(text, machine, stations)
    _add_probe(text, machine)
    text.section("truth")
    text.key("seed", 21, "a different number gives a different machine of the family")
    text.key("legendre_order", 7, "the identified model has order 5, as a real machine is richer than any model")
    text.key("scale", 1.0, "times the amplitudes of the family: 0.3 is a good machine, 3.0 a bad one")
    text.section("artefact_truth")
    text.key("certificate_error", 1.0, "the true centres differ by this many standard uncertainties")
    text.section("trigger")
    text.key("pretravel_um", 8.0, "of the probe, the same in all directions")
    text.key("lobing_um", 0.5, "its variation around the stylus, three lobes")
    text.key("touch_sigma_um", 1.0, "repeatability of a touch, 1 σ")
    text.section("axes")
    text.key("repeatability_um", 0.2)
    text.key("backlash_um", 0.2)
    text.section("temperatures")
    text.key("artefact_c", 20.5)
    text.key("machine_c", 21.0)
    text.key("ambient_c", 20.8)
    return str(text)


def _add_clock(text: TomlText, controller: ControllerSetup, *, has_mount: bool) -> None:
    if not controller.is_simulated:
        return
    at = {name: f"{SIMULATOR_HOST}:{port}" for name, port in SIMULATOR_PORTS.items()}
    command = simulate_command(
        SCENARIO_FILE,
        modbus=at["modbus"],
        can=f"socketcand:{at['can']}" if has_mount else None,
        control=at["control"],
        time=at["time"],
    )
    text.section("clock", "`volcal calibrate --simulated` starts the simulator. To start it by hand: " + command)
    text.key("kind", "lockstep", "the agent advances machine time; a real machine has no section [clock]")
    text.key("host", SIMULATOR_HOST)
    text.key("port", SIMULATOR_PORTS["time"])


def _add_controller(text: TomlText, machine: MachineSetup, controller: ControllerSetup) -> None:
    where = "The controller" if controller.is_simulated else f"The controller: {CONTROLLER_PAGES[controller.kind]}"
    text.section("devices.cnc", f"{where}. `volcal doctor` tests the connection and moves nothing.")
    text.key("driver", controller.driver)
    text.section("devices.cnc.options")
    for name, value in controller.connection_options().items():
        text.key(name, value)
    if controller.kind == SERIAL:
        zeros = [0.0 - high for _, high in machine.limits_mm]
        text.key(
            "axis_zero_mm",
            zeros,
            "machine coordinates (MPos) at which the axes of the machine file are 0; GRBL homes at the upper ends, "
            "where MPos is 0",
        )
        text.key("declared_temperatures_c", {"artefact": 20.0, "machine": 20.0}, "read a thermometer before each run")
        text.section("devices.cnc.options.banks")
        text.key("directory", "banks", "GRBL stores no tables: they are files here; part programs are corrected")
    elif controller.kind == LINUXCNC:
        text.section("devices.cnc.options.compensation")
        text.key("method", "external-offsets", "how LinuxCNC applies a table")
        text.key("directory", "tables", "[VOLCAL]DIRECTORY of the INI file, relative to this file")
        text.section("devices.cnc.options.temperatures", "HAL pins of your thermometers, in °C: replace the names.")
        text.key("artefact", "thermometer.artefact")
        text.key("machine", "thermometer.machine")


def _add_mount_device(text: TomlText, controller: ControllerSetup) -> None:
    text.section("devices.mount", "Rotary mount with two CANopen drives: docs/reference/canopen-mount.md.")
    text.key("driver", "canopen-mount")
    text.section("devices.mount.options")
    if controller.is_simulated:
        text.key("interface", "socketcand", "CAN of the simulator over TCP; on a machine socketcan or slcan")
        text.key("channel", "can0")
        text.key("options", {"host": SIMULATOR_HOST, "port": SIMULATOR_PORTS["can"], "tcp_tune": True})
        text.key("sdo_timeout_s", 1.0, "wall time: on a busy computer the simulator may answer late")
    else:
        text.key("interface", "socketcan", "CAN adapter of the kernel; or slcan with options = { bitrate = 500000 }")
        text.key("channel", "can0")
    for name, node, limit in AXES_OF_MOUNT:
        text.section(f"devices.mount.options.{name}")
        text.key("node_id", node, "CANopen node of the drive")
        text.key("encoder_counts_per_revolution", 131072, "increments per turn of the motor")
        text.key("gear_motor_revolutions", 100, "turns of the motor per turn of the mount")
        text.key("lower_deg", -limit)
        text.key("upper_deg", limit)
        text.key("speed_deg_per_s", 20.0)
        text.key("acceleration_deg_per_s2", 40.0)


def _add_operator(text: TomlText, controller: ControllerSetup, stations: StationSetup) -> None:
    task = (
        "places the artefact in each position" if stations.by_hand else "carries the artefact from station to station"
    )
    text.section("devices.operator", f"Person who {task} on request.")
    if controller.is_simulated:
        text.key("driver", "simulated-operator", "on a machine: console-operator")
        text.section("devices.operator.options")
        text.key("host", SIMULATOR_HOST)
        text.key("port", SIMULATOR_PORTS["control"])
    else:
        text.key("driver", "console-operator", "asked in the terminal in which the command was typed")


def _add_roles(text: TomlText, *, has_mount: bool) -> None:
    text.section("roles", "Which device does what.")
    for role in ("machine", "probe", "store", "thermometer"):
        text.key(role, "cnc")
    if has_mount:
        text.key("mount", "mount")
    text.key("operator", "operator")


def _add_procedure(text: TomlText, setup: NewSetup, position_set: str) -> None:
    stations = setup.stations
    text.section("stations")
    if stations.by_hand:
        text.comment(
            "The operator is asked to place the artefact in each position: docs/how-to/calibrate-without-a-mount.md. "
            "Places of the origin of the artefact frame in the workpiece frame (axis position + tool offset), on the "
            f"table and above it on spacers. {stations.origins['places_mm'].capitalize()}."
        )
        text.key("placed_by_hand", True)
        text.key(
            "placement_tolerance_mm", TOLERANCE.distance_mm, "an artefact that stands farther from its place is refused"
        )
        text.key("placement_tolerance_deg", TOLERANCE.angle_deg, "turned further, it is refused too")
    else:
        _explain_places(text, setup)
    text.key("places_mm", [list(place) for place in stations.places_mm])
    text.section("procedure", "How is measured; `volcal plan` shows balls, minutes and the expected result.")
    meaning = (
        "azimuths at each place" if stations.by_hand else "S1 along the axes, S3 along the diagonals of the planes"
    )
    text.key("position_set", position_set, f"{meaning}; or a file")
    text.key("touches_per_ball", setup.touches, "5, 9, 13 or 25: more touches, less noise, more minutes")
    if stations.search_feed_mm_per_min is not None:
        text.key(
            "guarded_feed_mm_per_min",
            stations.search_feed_mm_per_min,
            "of the search for the artefact: the tip stops before it meets the holder of a ball",
        )
    text.section("verification", "Fresh positions that prove a new table are measured at these stations.")
    if stations.by_hand:
        count = setup.held_out_positions
        text.key("stations", list(proving_stations(setup.machine, stations, count)))
        azimuths = held_out_azimuths(count)
        text.key("positions_deg", [[azimuth, 0.0] for azimuth in azimuths], "azimuth, elevation; not in the set")
        return
    text.key("stations", list(outer_stations(setup.machine, stations)), "those at the ends of the travel")
    if setup.held_out_positions is not None:
        text.key("positions", setup.held_out_positions, "as many as are needed to show the predicted improvement")


def _explain_places(text: TomlText, setup: NewSetup) -> None:
    """Add a comment on the places of the mount."""
    stations = setup.stations
    text.comment(
        f"Places of the mount along {station_axis(setup.machine)}: the point of its azimuth axis at the height of the "
        "middle of the artefact (vertical spindle: at which the elevation axis meets it), in the workpiece frame (axis "
        "position + tool offset, so of a stylus centre that would stand there). "
        f"{stations.origins['places_mm'].capitalize()}."
    )


def _add_limits(text: TomlText, machine: MachineSetup, controller: ControllerSetup) -> None:
    text.section("temperature")
    text.key(
        "standard_uncertainty_k",
        0.1 if controller.is_simulated else 0.5,
        "of the artefact's temperature: 0.1 a calibrated sensor on the bar, 0.5 a sensor nearby, 1 a guess",
    )
    if controller.is_simulated:
        text.section("timing", "Latencies of the simulated links, for predicted minutes.")
        text.key("command_latency_s", 0.001)
        text.key("touch_latency_s", 0.079)
        text.key("turn_latency_s", 0.505)
        text.key("relocation_minutes", 0.0, "the simulated operator takes none")
    else:
        text.section("timing", "For predicted minutes. `volcal timing runs/RUN` suggests values after the first run.")
        text.key(
            "relocation_minutes",
            RELOCATION_BY_HAND_MINUTES,
            f"a person moves mount and bar to the next station; {RELOCATION_BY_CRANE_MINUTES:g} with a crane",
        )
    if machine.kind.tolerance_share > 1.0:
        text.section("gates", "A table that does not pass these limits is never written.")
        text.key("max_correction_um", 1000.0, f"a {machine.kind.name} may have large errors")
        text.key("max_slope_um_per_mm", 5.0, "the same")


def _add_mount(text: TomlText, machine: MachineSetup, stations: StationSetup) -> None:
    """Add the section `[mount]`."""
    if stations.by_hand:
        text.section("mount", "There is no mount; this is the only key.")
        origin = stations.origins["table_z_mm"]
        text.key("table_z_mm", stations.table_z_mm, f"height of the table surface, workpiece frame; {origin}")
        return
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


def _add_probe(text: TomlText, machine: MachineSetup) -> None:
    """Add the section `[probe]`."""
    text.section("probe", "Dimensions of the probe for the collision check. What is proposed: measure yours.")
    for name, value in machine.probe.items():
        text.key(name, value, f"{PROBE_COMMENTS[name]}; {STATED if name in machine.stated_probe else PROPOSED}")
