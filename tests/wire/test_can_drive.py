"""Simulated drive frame by frame. Statuswords and controlwords are those of CiA 402, written in hexadecimal by hand."""

from __future__ import annotations

import struct

import pytest

from simulators.wire.can.drive import DriveConfig, ServoDrive, drive_node
from simulators.wire.can.node import CanopenNode
from simulators.wire.can.parameters import FactorGroup


class Axes:
    """Fake axes whose turns end on request of the test."""

    def __init__(self) -> None:
        self.position = 0.0
        self.target: float | None = None
        self.commands: list[tuple[str, float, float | None]] = []
        self.refuses = False

    def begin_turn(self, axis: str, angle_deg: float, speed_deg_per_s: float | None) -> None:
        if self.refuses:
            raise ValueError("mechanical stop")
        self.commands.append((axis, angle_deg, speed_deg_per_s))
        self.target = angle_deg

    def position_deg(self, axis: str) -> float:
        return self.position

    def moving(self, axis: str) -> bool:
        return self.target is not None

    def halt(self, axis: str | None = None) -> None:
        self.target = None

    def arrive(self) -> None:
        assert self.target is not None
        self.position, self.target = self.target, None


class Bench:
    def __init__(self) -> None:
        self.axes = Axes()
        node, drive = drive_node(DriveConfig(5, "azimuth", 1000.0), self.axes)
        self.node: CanopenNode = node
        self.drive: ServoDrive = drive

    def ask(self, request_hex: str) -> list[tuple[int, bytes]]:
        return self.node.receive(0x605, bytes.fromhex(request_hex))

    def status(self) -> int:
        ((identifier, data),) = self.ask("40 41 60 00 00 00 00 00")
        assert identifier == 0x585
        assert data[:4] == bytes.fromhex("4B 41 60 00")
        return int(struct.unpack_from("<H", data, 4)[0])

    def control(self, word: int) -> list[tuple[int, bytes]]:
        frames = self.ask(f"2B 40 60 00 {word & 0xFF:02X} {word >> 8:02X} 00 00")
        assert frames[-1] == (0x585, bytes.fromhex("60 40 60 00 00 00 00 00"))
        return frames[:-1]

    def enable(self) -> None:
        for word in (0x06, 0x07, 0x0F):
            self.control(word)
        assert self.status() & 0x6F == 0x27


@pytest.fixture
def bench() -> Bench:
    return Bench()


def test_boot_up_and_heartbeat(bench: Bench) -> None:
    assert bench.node.boot() == [(0x705, b"\x00")]
    assert bench.node.advance(10.0) == []
    assert bench.ask("2B 17 10 00 F4 01 00 00") == [(0x585, bytes.fromhex("60 17 10 00 00 00 00 00"))]
    assert bench.node.advance(10.4) == []
    assert bench.node.advance(10.5) == [(0x705, b"\x7f")]
    assert bench.node.receive(0x000, bytes.fromhex("01 05")) == []
    assert bench.node.advance(10.9) == []
    assert bench.node.advance(1000.0) == [(0x705, b"\x05")], "one heartbeat, not a backlog"


def test_nmt_addresses_stop_and_reset(bench: Bench) -> None:
    bench.node.receive(0x000, bytes.fromhex("02 06"))
    assert bench.status() == 0x0640, "a command to node 6 is not for node 5"
    bench.node.receive(0x000, bytes.fromhex("02 05"))
    assert bench.ask("40 41 60 00 00 00 00 00") == [], "no SDO in state stopped"
    assert bench.node.receive(0x000, bytes.fromhex("81 00")) == [(0x705, b"\x00")]
    assert bench.status() == 0x0640


def test_climb_to_operation_enabled_and_back(bench: Bench) -> None:
    assert bench.status() == 0x0640  # switch on disabled, remote, at rest
    bench.control(0x0006)
    assert bench.status() == 0x0621
    bench.control(0x0007)
    assert bench.status() == 0x0633  # voltage enabled
    bench.control(0x000F)
    assert bench.status() == 0x0637
    bench.control(0x0007)
    assert bench.status() == 0x0633
    bench.control(0x0006)
    assert bench.status() == 0x0621
    bench.control(0x0000)
    assert bench.status() == 0x0640


def test_no_short_cut_to_operation_enabled(bench: Bench) -> None:
    bench.control(0x000F)
    assert bench.status() == 0x0640


def test_profile_position_handshake(bench: Bench) -> None:
    bench.enable()
    bench.ask("2F 60 60 00 01 00 00 00")
    bench.ask("23 81 60 00 10 27 00 00")  # 10000 counts/s
    bench.ask("23 7A 60 00 90 5F 01 00")  # 90000 counts
    assert bench.axes.commands == []
    bench.control(0x003F)
    assert bench.axes.commands == [("azimuth", 90.0, 10.0)]
    assert bench.status() == 0x1237  # acknowledged, target not reached
    bench.control(0x003F)
    assert len(bench.axes.commands) == 1, "the bit acts on its rising edge"
    bench.control(0x000F)
    assert bench.status() == 0x0237
    bench.axes.arrive()
    assert bench.status() == 0x0637  # target reached
    assert bench.ask("40 64 60 00 00 00 00 00") == [(0x585, bytes.fromhex("43 64 60 00 90 5F 01 00"))]


def test_set_point_after_the_present_one_waits_for_it(bench: Bench) -> None:
    bench.enable()
    bench.ask("2F 60 60 00 01 00 00 00")
    bench.ask("23 7A 60 00 E8 03 00 00")
    bench.control(0x001F)
    bench.control(0x000F)
    bench.ask("23 7A 60 00 D0 07 00 00")
    bench.control(0x001F)
    assert [angle for _, angle, _ in bench.axes.commands] == [1.0]
    bench.axes.arrive()
    bench.node.advance(1.0)
    assert [angle for _, angle, _ in bench.axes.commands] == [1.0, 2.0]


def test_stopped_short_is_not_target_reached(bench: Bench) -> None:
    bench.enable()
    bench.ask("2F 60 60 00 01 00 00 00")
    bench.ask("23 7A 60 00 E8 03 00 00")
    bench.control(0x003F)
    bench.axes.halt()
    assert bench.status() & 0x0400 == 0


def test_quick_stop(bench: Bench) -> None:
    bench.enable()
    bench.ask("2F 60 60 00 01 00 00 00")
    bench.ask("23 7A 60 00 E8 03 00 00")
    bench.control(0x003F)
    bench.control(0x0002)
    assert bench.axes.target is None
    assert bench.status() & 0x6F == 0x40, "option code 2: switch on disabled after the ramp"


def test_quick_stop_option_that_stays(bench: Bench) -> None:
    bench.ask("2B 5A 60 00 06 00 00 00")
    bench.enable()
    bench.control(0x0002)
    assert bench.status() & 0x6F == 0x07
    bench.control(0x0000)
    assert bench.status() & 0x6F == 0x40


def test_fault_emergency_and_reset(bench: Bench) -> None:
    bench.enable()
    bench.drive.trip(0x8611)
    assert bench.node.advance(2.0) == [(0x085, bytes.fromhex("11 86 21 00 00 00 00 00"))]
    assert bench.status() & 0x4F == 0x08
    assert bench.ask("40 3F 60 00 00 00 00 00") == [(0x585, bytes.fromhex("4B 3F 60 00 11 86 00 00"))]
    assert bench.ask("40 01 10 00 00 00 00 00") == [(0x585, bytes.fromhex("4F 01 10 00 21 00 00 00"))]
    assert bench.ask("40 03 10 01 00 00 00 00") == [(0x585, bytes.fromhex("43 03 10 01 11 86 00 00"))]
    bench.control(0x000F)
    assert bench.status() & 0x4F == 0x08, "only a fault reset leads out"
    assert bench.control(0x0080) == [(0x085, bytes.fromhex("00 00 00 00 00 00 00 00"))]
    assert bench.status() == 0x0640


def test_persistent_fault_stays(bench: Bench) -> None:
    bench.drive.trip(0x7305, persistent=True)
    bench.control(0x0080)
    assert bench.status() & 0x4F == 0x08


def test_target_beyond_the_stops_is_a_fault(bench: Bench) -> None:
    bench.enable()
    bench.ask("2F 60 60 00 01 00 00 00")
    bench.axes.refuses = True
    assert bench.control(0x003F) == [(0x085, bytes.fromhex("12 86 21 00 00 00 00 00"))]
    assert bench.status() & 0x4F == 0x08


def test_homing_here(bench: Bench) -> None:
    bench.axes.position = 12.5
    bench.enable()
    bench.ask("2F 60 60 00 06 00 00 00")
    bench.ask("2F 98 60 00 25 00 00 00")  # method 37
    assert bench.status() == 0x0637
    bench.control(0x001F)
    assert bench.status() == 0x1637  # homing attained, at rest
    assert bench.ask("40 64 60 00 00 00 00 00") == [(0x585, bytes.fromhex("43 64 60 00 00 00 00 00"))]


def test_homing_to_the_switch_turns_there(bench: Bench) -> None:
    bench.axes.position = 12.5
    bench.enable()
    bench.ask("2F 60 60 00 06 00 00 00")
    bench.ask("2F 98 60 00 01 00 00 00")
    bench.ask("23 99 60 01 88 13 00 00")  # 5000 counts/s
    bench.control(0x001F)
    assert bench.axes.commands == [("azimuth", 0.0, 5.0)]
    assert bench.status() == 0x0237
    bench.axes.arrive()
    assert bench.status() == 0x1637


def test_modes_that_are_not_offered_are_refused(bench: Bench) -> None:
    assert bench.ask("2F 60 60 00 03 00 00 00") == [(0x585, bytes.fromhex("80 60 60 00 30 00 09 06"))]
    assert bench.ask("40 02 65 00 00 00 00 00") == [(0x585, bytes.fromhex("43 02 65 00 21 00 00 00"))]


def test_silent_node_says_nothing(bench: Bench) -> None:
    bench.ask("2B 17 10 00 F4 01 00 00")
    bench.node.silent = True
    assert bench.ask("40 41 60 00 00 00 00 00") == []
    assert bench.node.advance(100.0) == []
    assert bench.node.boot() == []


def with_factors(resolution: int, gear: int, feed: int, polarity: int = 0) -> Bench:
    """Return a drive with 1000 increments per degree of the mount, whatever the factors are."""
    bench = Bench()
    factors = FactorGroup((resolution, 1), (gear, 1), (feed, 1), polarity)
    bench.node, bench.drive = drive_node(DriveConfig(5, "azimuth", 1000.0, factors=factors), bench.axes)
    return bench


def test_factor_group_makes_the_unit_of_position() -> None:
    """With 10000 increments per turn, gear 36 and 3600 units per turn of the shaft, a unit is a tenth of a degree."""
    bench = with_factors(10_000, 36, 3600)
    assert bench.ask("40 8F 60 01 00 00 00 00") == [(0x585, bytes.fromhex("43 8F 60 01 10 27 00 00"))]
    assert bench.ask("40 91 60 00 00 00 00 00") == [(0x585, bytes.fromhex("4F 91 60 00 02 00 00 00"))]
    bench.axes.position = 12.3
    assert bench.ask("40 64 60 00 00 00 00 00") == [(0x585, bytes.fromhex("43 64 60 00 7B 00 00 00"))]
    bench.enable()
    bench.ask("2F 60 60 00 01 00 00 00")
    bench.ask("23 81 60 00 64 00 00 00")  # 100 units/s: 10 degrees/s
    bench.ask("23 7A 60 00 84 03 00 00")  # 900 units
    bench.control(0x003F)
    [(axis, *motion)] = bench.axes.commands
    assert axis == "azimuth"
    assert motion == pytest.approx([90.0, 10.0])


def test_polarity_bit_7_turns_the_position() -> None:
    bench = with_factors(10_000, 36, 360_000, polarity=0x80)
    bench.axes.position = 1.0
    assert bench.ask("40 64 60 00 00 00 00 00") == [(0x585, bytes.fromhex("43 64 60 00 18 FC FF FF"))]


def test_a_factor_of_zero_is_refused() -> None:
    bench = with_factors(10_000, 36, 3600)
    assert bench.ask("23 91 60 02 00 00 00 00") == [(0x585, bytes.fromhex("80 91 60 02 30 00 09 06"))]


def test_drive_without_a_factor_group_says_so(bench: Bench) -> None:
    assert bench.ask("40 8F 60 01 00 00 00 00") == [(0x585, bytes.fromhex("80 8F 60 01 00 00 02 06"))]


def test_software_limit_clips_the_way_and_shows_in_bit_11(bench: Bench) -> None:
    bench.enable()
    bench.ask("2F 60 60 00 01 00 00 00")
    bench.ask("23 7D 60 01 00 00 00 00")
    bench.ask("23 7D 60 02 D0 07 00 00")  # 0 ... 2000 counts
    bench.ask("23 7A 60 00 B8 0B 00 00")  # 3000 counts
    bench.control(0x003F)
    assert [angle for _, angle, _ in bench.axes.commands] == [2.0]
    assert bench.status() == 0x1A37  # acknowledged, internal limit active
    bench.axes.arrive()
    assert bench.status() == 0x1A37, "the target is not reached"


def test_limit_switch_stops_the_way_there_and_not_the_way_back(bench: Bench) -> None:
    bench.enable()
    bench.ask("2F 60 60 00 01 00 00 00")
    bench.ask("23 7A 60 00 B8 0B 00 00")
    bench.control(0x003F)
    bench.drive.press_limit_switch(1)
    assert bench.axes.target is None
    assert bench.ask("40 FD 60 00 00 00 00 00")[0][1][4] & 0x03 == 0x02
    assert bench.status() == 0x1A37
    bench.control(0x000F)
    bench.ask("23 7A 60 00 18 FC FF FF")
    bench.control(0x003F)
    assert bench.axes.target == -1.0


def test_homing_without_its_switch_is_a_homing_error(bench: Bench) -> None:
    bench.axes.position = 12.5
    bench.drive.lose_home_switch()
    bench.enable()
    bench.ask("2F 60 60 00 06 00 00 00")
    bench.ask("2F 98 60 00 01 00 00 00")
    bench.control(0x001F)
    bench.axes.arrive()
    assert bench.status() == 0x2637  # homing error, at rest, not attained


def test_strings_and_the_monitored_heartbeat(bench: Bench) -> None:
    assert bench.ask("40 0A 10 00 00 00 00 00") == [(0x585, bytes.fromhex("41 0A 10 00 06 00 00 00"))]
    assert bench.ask("60 00 00 00 00 00 00 00") == [(0x585, b"\x03volcal\x00")]
    assert bench.ask("23 16 10 01 F4 01 7F 00") == [(0x585, bytes.fromhex("60 16 10 01 00 00 00 00"))]
    assert bench.ask("40 16 10 01 00 00 00 00") == [(0x585, bytes.fromhex("43 16 10 01 F4 01 7F 00"))]
