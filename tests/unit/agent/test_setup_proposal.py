"""Proposals for machines of many sizes and all spindle directions; the files that follow from them are checked."""

from __future__ import annotations

import math
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from agent.planning.job_preparation import reached_balls
from agent.planning.new_machine.answers import SetupAnswers
from agent.planning.new_machine.artefact_geometry import nominal_length_mm, reference_pair
from agent.planning.new_machine.artefact_setup import (
    SHAPES,
    ArtefactSetup,
    Calibration,
    check_balls,
    nominal_artefact,
    propose_shape,
    propose_size,
)
from agent.planning.new_machine.controller_setup import ControllerSetup
from agent.planning.new_machine.error_family import propose_family
from agent.planning.new_machine.field import ProposalsOnly
from agent.planning.new_machine.machine_class import MACHINE_CLASSES
from agent.planning.new_machine.machine_setup import MachineSetup, Triple
from agent.planning.new_machine.new_setup import ARTEFACT_FILE, SETTINGS_FILE, NewSetup
from agent.planning.new_machine.setup_files import checked_files
from agent.planning.new_machine.spindle import SPINDLES, holder_direction, parse_spindle, points_up, spindle_name
from agent.planning.new_machine.station_setup import positions_of, propose_mount, propose_stations
from agent.runs.kinds.calibrate import preflight_of
from agent.settings.load import load_settings
from agent.settings.simulator_command import SCENARIO_FILE
from drivers.errors import ConfigurationError, InputError
from simulators.scenario import read_scenario
from twin.artefact.position_set import MIN_BALLS
from twin.errors import DataError

SIZES: list[Triple] = [
    (300.0, 200.0, 100.0),
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


def propose_artefact(machine: MachineSetup, shape: str | None = None) -> ArtefactSetup:
    shape = shape or propose_shape(machine.travel_mm)
    return nominal_artefact(shape, propose_size(shape, machine.travel_mm))


def setup(
    name: str, travel: Triple, spindle: str, controller: str = "simulated", address: str | None = None
) -> NewSetup:
    mine = machine(name, travel, spindle)
    bar = propose_artefact(mine)
    return NewSetup(mine, ControllerSetup.of(controller, address), bar, propose_stations(mine, bar))


@pytest.mark.parametrize("name", MACHINE_CLASSES)
def test_a_family_grows_with_the_machine_and_is_never_that_of_the_case_study(name: str) -> None:
    kind = MACHINE_CLASSES[name]
    families = [propose_family(kind, travel) for travel in sorted(SIZES, key=max)]
    first = [family["positioning_um"][0] for family in families if isinstance(family["positioning_um"], list)]
    assert first == sorted(first)
    assert len(set(first)) == len({max(travel) for travel in SIZES})
    assert CASE_STUDY_UM not in [family["positioning_um"] for family in families]
    assert {family["cross_displacement_um"] == 0.0 for family in families} == {not kind.cross_effect}


@pytest.mark.parametrize("spindle", SPINDLES)
@pytest.mark.parametrize("name", MACHINE_CLASSES)
def test_stations_stand_within_the_reach_of_the_stylus_and_the_bar_fits(name: str, spindle: str) -> None:
    for travel in SIZES:
        mine = machine(name, travel, spindle)
        assert spindle_name(mine.spindle) == spindle
        bar = propose_artefact(mine)
        stations = propose_stations(mine, bar)
        assert 120.0 <= bar.size_mm <= min(max(travel), 1500.0)
        assert bar.size_mm / (bar.balls - 1) > 2.0 * bar.diameter_mm
        for place in stations.places_mm:
            for axis, value in enumerate(place):
                low, high = mine.stylus_range(axis)
                beyond = stations.shaft_mm + bar.depth_mm if axis == mine.spindle.axis else 0.0
                assert low - beyond <= value <= high + beyond
            up = -1.0 if points_up(mine.spindle) else 1.0
            assert up * (place[2] - stations.table_z_mm) >= propose_mount(bar).height_mm
        assert len(positions_of(stations, mine.spindle)) == 8 * len(stations.places_mm)


@pytest.mark.parametrize(
    ("name", "travel", "spindle", "controller", "address"),
    [
        ("router", SIZES[0], "-Z", "simulated", None),
        ("mill", SIZES[1], "-Z", "simulated", None),
        ("mill", SIZES[2], "-Z", "modbus-cnc", "192.0.2.1:1502"),
        ("mill", SIZES[2], "+Z", "simulated", None),
        ("mill", SIZES[3], "-X", "linuxcnc", None),
        ("router", SIZES[4], "-Z", "serial-cnc", "/dev/ttyUSB0"),
        ("portal", SIZES[5], "+X", "simulated", None),
        ("large-ram", SIZES[6], "+Y", "simulated", None),
        ("large-ram", SIZES[6], "-Y", "simulated", None),
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


def test_under_a_stylus_that_points_up_everything_hangs_upside_down(tmp_path: Path) -> None:
    _, job = checked_files(setup("mill", SIZES[2], "+Z"), tmp_path)
    (tmp_path / "down").mkdir()
    _, usual = checked_files(setup("mill", SIZES[2], "-Z"), tmp_path / "down")
    mount = job.settings.mount
    assert mount.hanging
    assert mount.shaft_vector_mm == (0.0, 0.0, -80.0)
    assert job.artefact.balls[:, 2].mean() == pytest.approx(-40.0)
    assert mount.table_z_mm > job.machine.limits[2][1] + job.tool_offset_mm[2]
    reached = sorted(reached_balls(job, position) for position in job.positions)
    assert reached == sorted(reached_balls(usual, position) for position in usual.positions)


def test_a_stated_table_lifts_the_mount_above_it() -> None:
    mine = machine("router", SIZES[0], "-Z")
    bar = propose_artefact(mine)
    low = propose_stations(mine, bar)
    stated = propose_stations(mine, bar, table_z_mm=low.table_z_mm + 30.0)
    assert stated.places_mm[0][2] == low.places_mm[0][2] + 30.0


@pytest.mark.parametrize("spindle", ["-Z", "+Z", "+Y", "-X"])
@pytest.mark.parametrize("shape", SHAPES)
def test_a_nominal_artefact_of_every_shape_is_measured_on_every_machine(
    tmp_path: Path, shape: str, spindle: str
) -> None:
    mine = machine("mill", SIZES[2], spindle)
    artefact = propose_artefact(mine, shape)
    found = NewSetup(mine, ControllerSetup.of("simulated", None), artefact, propose_stations(mine, artefact))
    texts, job = checked_files(found, tmp_path)
    assert max(map(len, texts[ARTEFACT_FILE].splitlines())) <= 120
    assert job.artefact.count == artefact.balls
    against = np.array(holder_direction(mine.spindle))
    middle = float((job.artefact.balls @ against).mean())
    assert middle == pytest.approx(artefact.depth_mm, abs=1e-3)
    feet = job.artefact.body.feet(job.artefact.balls)
    tilt = 1.0 - math.sin(math.radians(artefact.tilt_deg))
    assert ((job.artefact.balls - feet) @ against).min() >= tilt * artefact.holder_mm - 1e-3
    reached = [reached_balls(job, position) for position in job.positions]
    assert len(reached) >= 3 * len(found.stations.places_mm)
    assert np.mean(reached) > 0.5 * artefact.balls


@pytest.mark.parametrize("shape", SHAPES)
def test_one_certified_length_is_the_scale_of_every_shape(tmp_path: Path, shape: str) -> None:
    mine = machine("portal", SIZES[5], "-Z")
    artefact = propose_artefact(mine, shape)
    longer = nominal_length_mm(artefact) + 0.02
    stated = replace(artefact, calibration=Calibration("length", longer, 0.5))
    _, job = checked_files(
        NewSetup(mine, ControllerSetup.of("simulated", None), stated, propose_stations(mine, stated)), tmp_path
    )
    first, second = reference_pair(artefact)
    assert float(np.linalg.norm(job.artefact.balls[second] - job.artefact.balls[first])) == pytest.approx(longer)
    assert math.sqrt(job.artefact.covariance[0, 0]) > 0.02
    (tmp_path / "bare").mkdir()
    bare = replace(artefact, calibration=Calibration("none"))
    _, job = checked_files(
        NewSetup(mine, ControllerSetup.of("simulated", None), bare, propose_stations(mine, bare)), tmp_path / "bare"
    )
    assert np.diag(job.artefact.covariance) == pytest.approx(0.05**2)


@pytest.mark.parametrize(("shape", "balls"), [("ball-plate", 15), ("ball-plate", 4), ("tetrahedron", 6)])
def test_a_number_of_balls_that_the_shape_cannot_have_is_refused(shape: str, balls: int) -> None:
    with pytest.raises(DataError, match=f"has no {balls} balls"):
        check_balls(shape, balls)


def test_a_plate_that_a_person_can_carry_is_small_for_a_large_machine() -> None:
    plates = [propose_artefact(machine("portal", travel, "-Z"), "ball-plate").size_mm for travel in SIZES]
    assert plates[0] <= 100.0
    assert plates[-1] == 600.0


@pytest.mark.parametrize("text", ["", "Z", "-W", "+XY", "down"])
def test_what_is_no_spindle_direction_is_refused(text: str) -> None:
    with pytest.raises(DataError, match="not a spindle direction"):
        parse_spindle(text)


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


@pytest.mark.parametrize("shape", SHAPES)
def test_an_artefact_placed_by_hand_has_a_complete_set_up(tmp_path: Path, shape: str) -> None:
    options = {"machine_class": "mill", "travel": "800 500 400", "placement": "by-hand", "shape": shape}
    found = SetupAnswers(options, ProposalsOnly(), tmp_path / "mine").collect()
    texts, job = checked_files(found, tmp_path)
    settings = tomllib.loads(texts[SETTINGS_FILE])
    assert settings["stations"]["placed_by_hand"] is True
    assert "mount" not in settings["devices"]
    assert set(settings["mount"]) == {"table_z_mm"}
    assert "--can" not in texts[SETTINGS_FILE]
    scenario = read_scenario(tmp_path / SCENARIO_FILE)
    assert scenario.mount_count == 0
    heights = {place[2] for place in settings["stations"]["places_mm"]}
    assert len(heights) == 2
    assert min(heights) >= settings["mount"]["table_z_mm"]
    assert {position.station for position in job.positions} == {1, 2, 3, 4}
    assert len(job.held_out) == 6
    assert preflight_of(job).machine_seconds > 0.0


@pytest.mark.parametrize(
    ("stated", "option", "words"),
    [
        ({"spindle": "+Z"}, "--placement", "a stylus that points down"),
        ({"spindle": "+Y"}, "--placement", "a stylus that points down"),
        ({"shaft": "80"}, "--shaft", "placed by hand"),
    ],
)
def test_what_cannot_be_placed_by_hand_is_refused(
    tmp_path: Path, stated: dict[str, str], option: str, words: str
) -> None:
    options = {"machine_class": "mill", "travel": "800 500 400", "placement": "by-hand", **stated}
    with pytest.raises(InputError, match=words) as refused:
        SetupAnswers(options, ProposalsOnly(), tmp_path / "mine").collect()
    assert refused.value.where["option"] == option


@pytest.mark.parametrize(
    ("stated", "said", "option"),
    [
        ({"mount_at": "150 90 -10"}, r"from above at the place \(150, 90, -10\)", "--mount-at"),
        ({"table_z": "-60"}, "from above on a table at Z = -60 mm", "--table-z"),
    ],
)
def test_an_artefact_too_high_at_what_is_stated_is_refused_by_the_stated_option(
    tmp_path: Path, stated: dict[str, str], said: str, option: str
) -> None:
    options = {"machine_class": "router", "travel": "300 180 80", "placement": "by-hand", **stated}
    answers = SetupAnswers(options, ProposalsOnly(), tmp_path / "mine")
    with pytest.raises(ConfigurationError, match=said) as refused:
        checked_files(answers.collect(), tmp_path)
    assert f"({option})" in refused.value.hint
    assert answers.stated_place_flags() == [option]
