"""Proposals for machines of many sizes and all spindle directions; the files that follow from them are checked."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest

from agent.planning.job_preparation import reached_balls
from agent.planning.setup_files.new_setup import ARTEFACT_FILE, SCENARIO_FILE, SETTINGS_FILE, NewSetup, checked_files
from agent.planning.setup_proposal.artefact_setup import propose_bar
from agent.planning.setup_proposal.controller_setup import ControllerSetup
from agent.planning.setup_proposal.error_family import propose_family
from agent.planning.setup_proposal.machine_class import MACHINE_CLASSES
from agent.planning.setup_proposal.machine_setup import MachineSetup, Triple
from agent.planning.setup_proposal.spindle import SPINDLES, parse_spindle, spindle_name
from agent.planning.setup_proposal.station_setup import positions_of, propose_stations
from agent.settings.load import load_settings
from simulators.scenario import read_scenario
from twin.design.procedure import MIN_BALLS
from twin.errors import DataError

SIZES: list[Triple] = [
    (300.0, 250.0, 200.0),
    (800.0, 500.0, 400.0),
    (400.0, 900.0, 500.0),
    (1300.0, 900.0, 200.0),
    (3000.0, 2000.0, 1000.0),
    (6000.0, 3000.0, 1500.0),
]
CASE_STUDY_UM = [8.0, 5.0, 3.0, 1.8, 1.1]


def machine(name: str, travel: Triple, spindle: str) -> MachineSetup:
    kind, frame = MACHINE_CLASSES[name], parse_spindle(spindle)
    x, y, z = ((-0.5 * length, 0.5 * length) for length in travel)
    same = (kind.rapid_mm_per_min, kind.rapid_mm_per_min, kind.rapid_mm_per_min)
    chain = kind.chain(frame, travel)
    return MachineSetup("mine", kind, (x, y, z), frame, chain, kind.stylus_mm, same, same, same)


def setup(
    name: str, travel: Triple, spindle: str, controller: str = "simulated", address: str | None = None
) -> NewSetup:
    mine = machine(name, travel, spindle)
    bar = propose_bar(mine)
    return NewSetup(mine, ControllerSetup.of(controller, address), bar, propose_stations(mine, bar))


@pytest.mark.parametrize("name", MACHINE_CLASSES)
def test_a_family_grows_with_the_machine_and_is_never_that_of_the_case_study(name: str) -> None:
    kind = MACHINE_CLASSES[name]
    families = [propose_family(kind, travel) for travel in sorted(SIZES, key=max)]
    first = [family["positioning_um"][0] for family in families if isinstance(family["positioning_um"], list)]
    assert first == sorted(first)
    assert len(set(first)) == len(families)
    assert CASE_STUDY_UM not in [family["positioning_um"] for family in families]
    assert {family["cross_displacement_um"] == 0.0 for family in families} == {not kind.cross_effect}


@pytest.mark.parametrize("spindle", SPINDLES)
@pytest.mark.parametrize("name", MACHINE_CLASSES)
def test_stations_stand_within_the_reach_of_the_stylus_and_the_bar_fits(name: str, spindle: str) -> None:
    for travel in SIZES:
        mine = machine(name, travel, spindle)
        assert spindle_name(mine.spindle) == spindle
        bar = propose_bar(mine)
        stations = propose_stations(mine, bar)
        assert 150.0 <= bar.length_mm <= min(max(travel), 1500.0)
        assert bar.length_mm / (bar.balls - 1) > 2.0 * bar.diameter_mm
        for place in stations.places_mm:
            for axis, value in enumerate(place):
                low, high = mine.stylus_range(axis)
                beyond = stations.shaft_mm + bar.holder_mm if axis == mine.spindle.axis else 0.0
                assert low - beyond <= value <= high + beyond
            assert place[2] > stations.table_z_mm or mine.spindle.is_vertical
        assert len(positions_of(stations, mine.spindle)) == 8 * len(stations.places_mm)


@pytest.mark.parametrize(
    ("name", "travel", "spindle", "controller", "address"),
    [
        ("mill", SIZES[0], "-Z", "simulated", None),
        ("mill", SIZES[1], "-Z", "modbus-cnc", "192.0.2.1:1502"),
        ("mill", SIZES[2], "-X", "linuxcnc", None),
        ("router", SIZES[3], "-Z", "serial-cnc", "/dev/ttyUSB0"),
        ("portal", SIZES[4], "+X", "simulated", None),
        ("large-ram", SIZES[5], "+Y", "simulated", None),
        ("large-ram", SIZES[5], "-Y", "simulated", None),
    ],
)
def test_what_is_written_loads_fits_together_and_has_positions_to_measure(
    tmp_path: Path, name: str, travel: Triple, spindle: str, controller: str, address: str | None
) -> None:
    written, job = checked_files(setup(name, travel, spindle, controller, address), tmp_path)
    for file in ("machine.toml", ARTEFACT_FILE, SETTINGS_FILE, SCENARIO_FILE):
        assert tomllib.loads(written[file])
        assert max(map(len, written[file].splitlines())) <= 120
    measured = [position for position in job.positions if reached_balls(job, position) >= MIN_BALLS]
    assert len(measured) >= 3
    assert {position.station for position in measured} == set(job.stations)
    scenario = read_scenario(tmp_path / SCENARIO_FILE)
    settings = load_settings(tmp_path / SETTINGS_FILE)
    assert scenario.settings.mount == settings.mount
    assert scenario.settings.probe == settings.probe
    assert [list(place) for place in scenario.settings.stations_mm] == [list(p) for p in settings.stations.places_mm]


@pytest.mark.parametrize("text", ["", "Z", "-W", "+XY", "down"])
def test_what_is_no_spindle_direction_is_refused(text: str) -> None:
    with pytest.raises(DataError, match="not a spindle direction"):
        parse_spindle(text)
    with pytest.raises(DataError, match="no mount can be proposed"):
        parse_spindle("+Z")


@pytest.mark.parametrize(
    ("kind", "address", "words"),
    [
        ("modbus-cnc", None, "needs an address"),
        ("modbus-cnc", "host:door", "not HOST:PORT"),
        ("serial-cnc", None, "needs an address"),
        ("linuxcnc", "host", "has no address"),
    ],
)
def test_an_address_that_does_not_belong_to_the_controller_is_refused(
    kind: str, address: str | None, words: str
) -> None:
    with pytest.raises(DataError, match=words):
        ControllerSetup.of(kind, address)
