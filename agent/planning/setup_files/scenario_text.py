"""Text of the simulator scenario that matches the settings of a new machine."""

from __future__ import annotations

from agent.planning.setup_files.geometry_text import add_mount, add_probe
from agent.planning.setup_files.toml_text import TomlText
from agent.planning.setup_proposal.machine_setup import MachineSetup
from agent.planning.setup_proposal.station_setup import StationSetup


def scenario_text(machine: MachineSetup, stations: StationSetup, *, machine_file: str, artefact_file: str) -> str:
    """Return the scenario of a simulated machine of this family, with the same mount, probe and stations.

    Its errors are drawn from the family of the machine file with Legendre order 7, richer than the identified model.
    """
    text = TomlText()
    text.comment(
        "Scenario for `volcal simulate` and `volcal calibrate --simulated`: a machine of this family with errors of "
        "its own, which the agent does not know. All keys: docs/reference/scenario.md."
    )
    text.key("machine", machine_file, "its travel, chain, tools and family")
    text.key("artefact", artefact_file, "its nominal or certified centres; the true ones differ, see below")
    text.key("tool", "probe")
    text.key("seed", 1, "of all noise, and of the errors of the mount")
    text.key("standing_at", 1, "station of mount and artefact at the start")
    text.comment("The same places, mount and probe as in the settings.")
    text.key("stations_mm", [list(place) for place in stations.places_mm])
    add_mount(text, machine, stations)
    add_probe(text, machine)
    text.section("truth")
    text.key("seed", 21, "another number is another machine of the family")
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
