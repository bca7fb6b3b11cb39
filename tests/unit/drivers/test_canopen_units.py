"""Tests of the comparison of the drive's factors with the settings, of EDS files, and of their diagnosis."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import can
import pytest
from canopen_rig import LinearAxes, axis_settings, rig
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError
from test_canopen_mount import OBJECTS, write_eds

from drivers.canopen_mount.mount import CanopenMount
from drivers.canopen_mount.settings import AxisSettings, CanopenMountSettings
from drivers.clock import VirtualClock
from drivers.errors import ConfigurationError
from drivers.links.can_bus import CanNetworks
from drivers.registry import DeviceContext
from drivers.roles import Orientation
from simulators.wire.can.drive import DriveConfig, drive_node
from simulators.wire.can.parameters import FEED, GEAR, POLARITY, RESOLUTION, FactorGroup, Parameters
from simulators.wire.can.server import CanServer

IN_THOUSANDTHS = {"position": "feed", "feed_per_revolution": 360_000}
"""The drive includes the gear, and its position unit is 0.001 degree of the mount."""


def axis(**changes: Any) -> AxisSettings:
    return AxisSettings.model_validate(axis_settings(5, **changes))


def test_scale_of_a_drive_that_counts_in_its_own_units() -> None:
    scale = axis(units=IN_THOUSANDTHS).scale
    assert scale.counts(12.3456) == 12346
    assert scale.angle_deg(12346) == 12.346
    assert axis(units={**IN_THOUSANDTHS, "feed_per_revolution": 1_296_000}).scale.counts(1.0) == 3600


@pytest.mark.parametrize(
    ("units", "words"),
    [
        ({"position": "feed"}, "set feed_per_revolution"),
        ({"feed_per_revolution": 360}, "set feed_per_revolution"),
        ({"compare": ["feed"]}, "can be compared only"),
        ({"polarity": 256}, "less than or equal to 255"),
    ],
)
def test_units_that_contradict_themselves(units: dict[str, Any], words: str) -> None:
    with pytest.raises(ValidationError, match=words):
        axis(units=units)


@given(increments=st.integers(1, 2**20), gear=st.integers(1, 400), feed=st.integers(1, 10**7), polarity=st.booleans())
def test_factors_as_the_profile_defines_them(increments: int, gear: int, feed: int, polarity: bool) -> None:
    """Formula of CiA 402-2: position = increments * feed constant / (encoder resolution * gear ratio)."""
    group = FactorGroup((increments, 1), (gear, 1), (feed, 1), 0x80 if polarity else 0)
    one_turn_of_the_shaft = increments * gear * Parameters(group).units_per_increment
    assert one_turn_of_the_shaft == pytest.approx(-feed if polarity else feed)


@pytest.mark.parametrize(
    ("key", "value", "words", "setting"),
    [
        (
            RESOLUTION,
            4000,
            "0x608F position encoder resolution is 4000 : 1 in the drive and 10000 : 1",
            "encoder_counts",
        ),
        (POLARITY, 0x80, "0x607E polarity is 0x80 in the drive and 0x0", "units.polarity"),
    ],
)
def test_differing_factors_refuse_the_opening(key: tuple[int, int], value: int, words: str, setting: str) -> None:
    with rig(opened=False) as bench:
        bench.azimuth.parameters[key] = value
        with pytest.raises(ConfigurationError, match=words) as caught:
            bench.mount.open()
        assert caught.value.where["key"].startswith(setting)
        assert caught.value.where["object"] == f"0x{key[0]:04X}"
        assert caught.value.where["node"] == "5"
        assert bench.writes(5, 0x6040) == []
        bad = [finding.text for finding in bench.mount.diagnose() if not finding.ok]
        assert any(f"0x{key[0]:04X}" in text and setting in text for text in bad)


def test_without_the_comparison_the_angle_is_wrong() -> None:
    """Without the comparison, a drive with another encoder resolution turns to a wrong angle and reports success."""
    with rig(opened=False, azimuth={"units": {"compare": []}}) as bench:
        bench.azimuth.parameters[RESOLUTION] = 20_000
        bench.mount.open()
        assert bench.mount.orient_to(30.0, 0.0).azimuth_deg == pytest.approx(30.0)
        assert bench.axes.position_deg("azimuth") == pytest.approx(60.0)


def test_ratios_are_compared_as_numbers() -> None:
    units = {**IN_THOUSANDTHS, "compare": ["gear", "feed"]}
    with rig(opened=False, azimuth={"units": units}) as bench:
        bench.azimuth.parameters[GEAR] = 72
        bench.azimuth.parameters[0x6091, 2] = 2
        bench.azimuth.parameters[FEED] = 720_000
        bench.azimuth.parameters[0x6092, 2] = 2
        bench.mount.open()
        assert bench.mount.orient_to(30.0, 0.0) == Orientation(30.0, 0.0)
        assert bench.axes.position_deg("azimuth") == pytest.approx(30.0)
        assert bench.writes(5, 0x607A) == [bytes.fromhex("30 75 00 00")], "30000 thousandths"


def test_factors_are_written_if_configured_and_read_back() -> None:
    with rig(opened=False, azimuth={"units": {**IN_THOUSANDTHS, "write": True}}) as bench:
        bench.azimuth.parameters[FEED] = 1000
        bench.frames()
        bench.mount.open()
        assert bench.writes(5, 0x6092) == [bytes.fromhex("40 7E 05 00"), bytes.fromhex("01 00 00 00")]
        assert bench.mount.orient_to(12.0, 0.0) == Orientation(12.0, 0.0)
        assert bench.axes.position_deg("azimuth") == pytest.approx(12.0)


def test_reversed_polarity_turns_the_count_and_the_direction_turns_it_back() -> None:
    with rig(opened=False, azimuth={"direction": -1, "units": {"polarity": 0x80}}) as bench:
        bench.azimuth.parameters[POLARITY] = 0x80
        bench.mount.open()
        assert bench.mount.orient_to(20.0, 0.0) == Orientation(20.0, 0.0)
        assert bench.axes.position_deg("azimuth") == pytest.approx(20.0)


def test_unit_codes_are_compared_if_stated() -> None:
    """A drive with speeds in turns per minute (0x00B44700) turns at a wrong speed."""
    units = {**IN_THOUSANDTHS, "unit_code": 0xFD41_0000, "velocity_unit_code": 0xFD41_0300}
    with rig(opened=False, azimuth={"units": units}) as bench:
        bench.azimuth.parameters[0x60A8, 0] = 0xFD41_0000
        bench.azimuth.parameters[0x60A9, 0] = 0x00B4_4700
        words = "0x60A9 SI unit velocity is 0xB44700 in the drive and 0xFD410300 in the settings"
        with pytest.raises(ConfigurationError, match=words):
            bench.mount.open()
        bench.azimuth.parameters[0x60A9, 0] = 0xFD41_0300
        bench.mount.open()
        assert bench.mount.orient_to(1.0, 1.0) == Orientation(1.0, 1.0)


NANOTEC = (0x26C, 7, 1, 1)
EXAMPLE = Path(__file__).parents[3] / "config" / "examples" / "nanotec-n5-mount.toml"


def test_example_turns_drives_set_as_on_its_page() -> None:
    """Drives with the factors of the reference page: units of 0.001 degree of the mount, gear 100:1 in the drive."""
    options = tomllib.loads(EXAMPLE.read_text())["devices"]["mount"]["options"]
    stated = CanopenMountSettings.model_validate(options)
    assert (stated.azimuth.scale.counts(1.0), stated.elevation.scale.counts(1.0)) == (1000, 1000)
    axes, clock, channel = LinearAxes(), VirtualClock(), "example"
    factors = FactorGroup((2000, 1), (100, 1), (360_000, 1), unit_codes=(0xFD41_0000, 0xFD41_0300))
    stages = ((stated.azimuth.node_id, "azimuth"), (stated.elevation.node_id, "elevation"))
    drives = [DriveConfig(node, name, 2000 * 100 / 360, identity=NANOTEC, factors=factors) for node, name in stages]
    nodes = [drive_node(drive, axes)[0] for drive in drives]
    clock.subscribe(axes.advance)
    virtual = stated.model_copy(update={"interface": "virtual", "channel": channel, "options": {}})
    mount = CanopenMount(virtual, DeviceContext("mount", clock, EXAMPLE.parent), CanNetworks())
    with CanServer(can.Bus(interface="virtual", channel=channel), nodes) as server:
        clock.subscribe(server.advance)
        mount.open()
        mount.home()
        reached = mount.orient_to(30.0, -12.0)
        mount.close()
    assert (reached.azimuth_deg, reached.elevation_deg) == pytest.approx((30.0, -12.0), abs=1e-3)
    assert axes.position_deg("azimuth") == pytest.approx(30.0)
    assert axes.position_deg("elevation") == pytest.approx(-12.0)
    assert [command[2] for command in axes.commands[-2:]] == pytest.approx([stated.azimuth.speed_deg_per_s] * 2)


def test_drive_without_factors_is_not_asked_to_have_them() -> None:
    with rig() as bench:
        told = [finding.text for finding in bench.mount.diagnose() if "node 6" in finding.subject]
        assert "0x608F position encoder resolution: the drive has no such object, not compared" in told
        assert bench.mount.orient_to(0.0, 3.0) == Orientation(0.0, 3.0)


def test_doctor_reads_everything_and_writes_nothing() -> None:
    with rig(opened=False) as bench:
        bench.elevation.parameters[0x607D, 1], bench.elevation.parameters[0x607D, 2] = -90_000, 90_000
        bench.elevation.press_limit_switch(-1)
        bench.elevation_node.receive(0x606, bytes.fromhex("23 16 10 01 F4 01 7F 00"))
        bench.frames()
        findings = bench.mount.diagnose()
        sent = [(identifier, data) for identifier, data in bench.frames() if identifier < 0x580 or identifier > 0x5FF]
        assert {identifier for identifier, _ in sent} == {0x605, 0x606}
        assert {data[0] for _, data in sent} <= {0x40, 0x60, 0x70}, "uploads and their segments"
    healthy = " | ".join(finding.text for finding in findings if "node 5" in finding.subject)
    for words in (
        "SDO round trip median",
        "vendor 0x000003E7, product 0x00000402, revision 0x1, serial number 0x1",
        "set vendor_id and product_code",
        "volcal simulated servo drive, hardware simulated, software volcal",
        "statusword 0x0640, switch on disabled",
        "DC link 48.0 V",
        "position encoder resolution 10000 : 1, as configured",
        "no software limits in the drive",
        "heartbeat off",
    ):
        assert words in healthy
    assert all(finding.ok for finding in findings if "node 5" in finding.subject)
    bad = [finding.text for finding in findings if not finding.ok]
    assert bad == [
        "the negative limit switch is active (0x60FD)",
        "software limits of the drive -90 ... 90 degrees (0x607D): narrower than lower_deg ... upper_deg, positions"
        " beyond them are refused",
        "the drive expects a heartbeat of node 127 every 500 ms (0x1016:01), which volcal does not send: it would"
        " fault",
    ]


def edited(path: Path, former: str, now: str) -> str:
    text = path.read_text()
    assert text.count(former) == 1, former
    path.write_text(text.replace(former, now))
    return str(path)


def refused(eds: str, **changes: Any) -> ConfigurationError:
    with (
        rig(opened=False, azimuth={"eds": eds, **changes}) as bench,
        pytest.raises(ConfigurationError) as caught,
    ):
        bench.mount.open()
    assert caught.value.where["file"] == eds
    return caught.value


def test_eds_with_a_read_only_target(tmp_path: Path) -> None:
    path = tmp_path / "locked.eds"
    write_eds(path, "0x402", OBJECTS)
    section = "[607A]\nParameterName=o607A\nObjectType=0x7\nDataType=0x0004\nAccessType="
    error = refused(edited(path, section + "rw", section + "ro"))
    assert "lists as ro what must be written: 0x607A:00 target position" in str(error)
    assert error.where["object"] == "0x607A:00"


def test_eds_with_another_data_type(tmp_path: Path) -> None:
    write_eds(tmp_path / "narrow.eds", "0x402", {**OBJECTS, 0x6064: 3})
    assert "gives 16 bits to 0x6064:00 position actual value" in str(refused(str(tmp_path / "narrow.eds")))


def test_eds_needs_the_homing_objects_only_for_homing(tmp_path: Path) -> None:
    path = tmp_path / "absolute.eds"
    write_eds(path, "0x402", OBJECTS)
    with rig(azimuth={"eds": str(path)}) as bench:
        assert bench.mount.orient_to(1.0, 1.0) == Orientation(1.0, 1.0)
    error = refused(str(path), homing={"method": 37})
    assert "does not list 0x6098:00 homing method" in str(error)


def test_file_that_is_not_an_eds(tmp_path: Path) -> None:
    path = tmp_path / "broken.eds"
    path.write_text("[FileInfo\nthis is no EDS")
    assert "cannot be read" in str(refused(str(path)))
    assert "cannot be read" in str(refused(str(tmp_path / "nowhere.eds")))
