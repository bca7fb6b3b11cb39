"""Simulated GRBL and grblHAL against the documents and sources of both (gnea/grbl; grblHAL/core): transcripts byte by
byte.
"""

from __future__ import annotations

import os
import re
import select
from dataclasses import replace
from pathlib import Path

import pytest

from drivers.errors import ConfigurationError
from drivers.roles import Permission
from simulators.scenario import Scenario, read_scenario
from simulators.wire.grbl.blocks import BlockError, BlockParser, WorkOffsets
from simulators.wire.grbl.controller import GrblController
from simulators.wire.grbl.dialect import GRBL_11, GRBL_HAL, GrblDialect
from simulators.wire.grbl.settings import GrblSettings
from simulators.wire.pty_port import PseudoTerminal
from simulators.wire.shared_world import SharedWorld
from simulators.world.world import World

SCENARIO = Path(__file__).resolve().parents[2] / "config" / "simulators" / "case-study.toml"
BANNER = ["", "Grbl 1.1h ['$' for help]"]
LOCKED = "[MSG:'$H'|'$X' to unlock]"


class Terminal:
    """Terminal that types bytes, collects lines and advances time."""

    def __init__(
        self,
        *,
        homed: bool = True,
        dialect: GrblDialect = GRBL_11,
        scenario: Scenario | None = None,
        **settings: float,
    ) -> None:
        self.world = World(scenario or read_scenario(SCENARIO).without_errors())
        self._shared = SharedWorld(self.world)
        self._said = b""
        told = GrblSettings(self.world.controller.limits(), dialect=dialect)
        told.change({int(name[1:]): value for name, value in settings.items()})
        self.grbl = GrblController(
            self.world.controller, lambda: self._shared.now, self._hear, settings=told, homed=homed
        )
        self._shared.subscribe(self.grbl.on_advance, wakes_at=self.grbl.wakes_at)

    def _hear(self, data: bytes) -> None:
        self._said += data

    def type(self, data: bytes) -> list[str]:
        self.grbl.received(data)
        return self.heard()

    def heard(self) -> list[str]:
        said, self._said = self._said, b""
        assert not said or said.endswith(b"\r\n")
        return said.decode("ascii").split("\r\n")[:-1]

    def wait(self, seconds: float) -> list[str]:
        self._shared.advance_to(self._shared.now + seconds)
        return self.heard()


@pytest.fixture
def grbl() -> Terminal:
    return Terminal()


def test_one_answer_for_each_line_also_for_an_empty_one(grbl: Terminal) -> None:
    assert grbl.type(b"\n") == ["ok"]
    assert grbl.type(b"\r\n") == ["ok", "ok"]  # both characters end a line
    assert grbl.type(b"G9") == []
    assert grbl.type(b"0\n") == ["ok"]
    assert grbl.type(b"(comment) g 90 ; and more\n") == ["ok"]


@pytest.mark.parametrize(
    ("line", "code"),
    [
        (b"=", 1), (b"G", 2), (b"G1.2.3", 1), (b"$Q", 3), (b"$130=-1", 4), (b"$0=1", 6), (b"G99", 20), (b"G2X1", 20),
        (b"G0G1X-1", 21), (b"G1X-1", 22), (b"G1X-1X-2F100", 25), (b"G38.3F100", 26), (b"N0", 27), (b"G4", 28),
        (b"G53G80X-1", 30), (b"G80X-1", 31), (b"G38.3X-4000F100", 33), (b"P1", 36), (b"G43.1X1", 37),
        (b"G" + b"1" * 80, 11), (b"$999=1", 3), (b"$13=abc", 2), (b"T256", 38), (b"T-1", 4), (b"F-100", 4),
    ],
)  # fmt: skip
def test_each_error_has_its_number(grbl: Terminal, line: bytes, code: int) -> None:
    assert grbl.type(line + b"\n") == [f"error:{code}"]
    assert grbl.type(b"?")[0].startswith("<Idle|")


def test_a_tool_number_that_no_controller_has_is_refused_however_long() -> None:
    with pytest.raises(BlockError) as error:
        BlockParser(WorkOffsets()).read("T" + "9" * 400, (0.0, 0.0, 0.0))
    assert error.value.code == 38


def test_offset_comes_first_after_a_reset_overrides_next_then_seldom(grbl: Terminal) -> None:
    reports = [grbl.type(b"?")[0] for _ in range(25)]
    assert reports[0] == "<Idle|MPos:-4000.000,-1300.000,-1500.000|FS:0,0|WCO:0.000,0.000,0.000>"
    assert "Ov:100,100,100" in reports[1]
    assert [number for number, text in enumerate(reports) if "WCO" in text] == [0, 10, 20]
    assert all(not ("WCO" in text and "Ov:" in text) for text in reports)
    grbl.type(b"G92X0\n")
    assert "WCO:-4000.000,0.000,0.000" in grbl.type(b"?")[0]


def test_offsets_are_those_of_the_parameters(grbl: Terminal) -> None:
    grbl.type(b"G10L2P1X-10Y-20Z-30\nG43.1Z5\n")
    lines = grbl.type(b"$#\n")
    assert lines[0] == "[G54:-10.000,-20.000,-30.000]"
    assert [line for line in lines if line.startswith("[TLO")] == ["[TLO:5.000]"]
    assert lines[-2:] == ["[PRB:0.000,0.000,0.000:0]", "ok"]
    assert "WCO:-10.000,-20.000,-25.000" in grbl.type(b"?")[0]


def test_settings_are_listed_as_the_documents_do(grbl: Terminal) -> None:
    lines = grbl.type(b"$$\n")
    assert lines[-1] == "ok"
    assert {"$10=1", "$13=0", "$100=1000.000", "$110=20000.000", "$120=500.000", "$130=4000.000"} <= set(lines)
    assert all(re.fullmatch(r"\$\d+=\d+(\.\d{3})?", line) for line in lines[:-1])


def test_ok_to_a_motion_means_queued_and_a_dwell_is_the_barrier(grbl: Terminal) -> None:
    assert grbl.type(b"G53G1X-3900F6000\nG4P0\n") == ["ok"]
    assert grbl.type(b"?")[0].startswith("<Run|MPos:-4000.000")
    assert grbl.wait(0.9) == []
    assert grbl.wait(1.0) == ["ok"]
    assert grbl.type(b"?")[0].startswith("<Idle|MPos:-3900.000")


def test_planner_takes_fifteen_blocks_and_then_lines_wait_in_the_receive_buffer(grbl: Terminal) -> None:
    grbl.type(b"G90G94F600\n")
    for number in range(30):
        heard = grbl.type(b"G53G1X%d\n" % (-3999 + number))
        assert heard == (["ok"] if number < 16 else [])
    grbl.type(b"$10=3\n")
    assert grbl.type(b"?")[0].startswith("<Run|")
    assert grbl.wait(0.5) == ["ok"] or grbl.wait(5.0)


def test_receive_buffer_of_128_bytes_loses_what_does_not_fit(grbl: Terminal) -> None:
    grbl.type(b"G53G1X-3990F600\nG4P0\n")
    grbl.type(b"G90\n" * 31)  # 124 bytes, 127 fit
    grbl.type(b"G90\n")
    heard = grbl.wait(5.0)
    assert heard == ["ok"] * 32  # the barrier, and 31 of 32 lines; three bytes of the last are still there
    assert grbl.type(b"\n") == ["ok"]


def test_buffer_report_counts_what_is_free() -> None:
    grbl = Terminal(_10=3.0)
    assert "|Bf:15,128|" in grbl.type(b"?")[0]
    grbl.type(b"G53G1X-3990F600\nG4P0\nG90\n")
    assert "|Bf:14,124|" in grbl.type(b"?")[0]


def test_missed_g38_3_has_no_alarm_and_tells_its_end(grbl: Terminal) -> None:
    assert grbl.type(b"G38.3X-3990F600\n") == []
    assert grbl.wait(5.0) == ["[PRB:-3990.000,-1300.000,-1500.000:0]", "ok"]
    assert grbl.type(b"?")[0].startswith("<Idle|")


def test_missed_g38_2_is_alarm_5_then_the_old_result_then_ok_then_locked(grbl: Terminal) -> None:
    grbl.type(b"G38.3X-3990F600\n")
    grbl.wait(5.0)
    grbl.type(b"G38.2X-3980F600\n")
    assert grbl.wait(5.0) == ["ALARM:5", "[PRB:-3990.000,-1300.000,-1500.000:0]", "ok"]
    assert grbl.type(b"G0X-1\n") == ["error:9"]
    assert grbl.type(b"$X\n") == ["[MSG:Caution: Unlocked]", "ok"]
    assert grbl.type(b"?")[0].startswith("<Idle|")


def test_probe_in_the_wrong_state_is_alarm_4_without_a_result() -> None:
    grbl = Terminal(_6=1.0)
    assert "|Pn:P" in grbl.type(b"?")[0]
    assert grbl.type(b"G38.3X-3990F600\n") == ["ALARM:4", "ok"]
    assert grbl.type(b"?")[0].startswith("<Alarm|")


def test_feed_hold_brakes_then_waits_and_takes_no_line(grbl: Terminal) -> None:
    grbl.type(b"G53G1X-3000F6000\n")
    grbl.wait(2.0)
    assert grbl.type(b"!?")[0].startswith("<Hold:1|")
    grbl.wait(1.0)
    assert grbl.type(b"?")[0].startswith("<Hold:0|")
    assert grbl.type(b"$G\n") == []
    assert grbl.type(b"~")[0].startswith("[GC:G1 G54 G17 G21 G90 G94 M5 M9 T0 F6000 S0]")
    grbl.wait(20.0)
    assert grbl.type(b"?")[0].startswith("<Idle|MPos:-3000.000")


def test_reset_in_motion_is_alarm_3_banner_and_lock(grbl: Terminal) -> None:
    grbl.type(b"G53G1X-3000F6000\n")
    grbl.wait(2.0)
    assert grbl.type(b"\x18") == ["ALARM:3", *BANNER, LOCKED]
    assert grbl.type(b"G0X-1\n") == ["error:9"]


def test_reset_while_braking_is_alarm_3_too_and_at_rest_is_none(grbl: Terminal) -> None:
    grbl.type(b"G53G1X-3000F6000\n")
    grbl.wait(2.0)
    assert grbl.type(b"!\x18")[0] == "ALARM:3"
    grbl.wait(2.0)
    grbl.type(b"$X\n")
    grbl.type(b"G53G1X-3000F6000\n")
    grbl.wait(2.0)
    grbl.type(b"!")
    grbl.wait(1.0)
    assert grbl.type(b"\x18") == BANNER
    assert grbl.type(b"?")[0].startswith("<Idle|")


def test_line_that_a_reset_breaks_off_is_answered_before_the_banner(grbl: Terminal) -> None:
    grbl.type(b"G38.3X-3000F600\n")
    grbl.wait(1.0)
    assert grbl.type(b"\x18") == ["ALARM:3", "ok", *BANNER, LOCKED]


def test_soft_limit_silences_the_controller_until_a_reset(grbl: Terminal) -> None:
    assert grbl.type(b"G53G0X1\n") == ["ALARM:2", "[MSG:Reset to continue]"]
    assert grbl.type(b"?$X\n") == []
    assert grbl.type(b"\x18") == ["ok", *BANNER, LOCKED]
    assert grbl.type(b"$X\n") == ["[MSG:Caution: Unlocked]", "ok"]


def test_switched_on_it_is_locked_until_it_has_homed() -> None:
    grbl = Terminal(homed=False)
    assert grbl.type(b"G0X-1\n") == ["error:9"]
    assert grbl.type(b"$H\n") == []
    assert grbl.type(b"?") == []  # no reports while homing
    assert grbl.wait(1000.0) == ["ok"]
    assert grbl.type(b"?")[0].startswith("<Idle|MPos:-1.000,-1.000,-1.000")


def test_each_homing_sets_the_zero_anew() -> None:
    document = read_scenario(SCENARIO)
    axes = document.settings.axes.model_copy(update={"homing_um": 10.0})
    scattering = replace(document, settings=document.settings.model_copy(update={"axes": axes}))
    grbl = Terminal(scenario=scattering)
    offsets = []
    for _ in range(2):
        assert [*grbl.type(b"$H\n"), *grbl.wait(1000.0)] == ["ok"]
        assert grbl.type(b"?")[0].startswith("<Idle|MPos:-1.000,-1.000,-1.000")
        offsets.append(grbl.world.controller.homing_offset_mm)
    assert offsets[0] != offsets[1]
    assert 0.0 < max(map(abs, offsets[0])) < 0.1


def test_door_holds_and_waits_for_cycle_start(grbl: Terminal) -> None:
    grbl.type(b"G53G1X-3000F6000\n")
    grbl.wait(2.0)
    grbl.world.controller.granted[Permission.DOORS_CLOSED] = False
    assert grbl.wait(0.01) == ["[MSG:Check Door]"]
    assert grbl.type(b"?")[0].startswith("<Door:2|")
    grbl.wait(2.0)
    report = grbl.type(b"~?")[0]
    assert report.startswith("<Door:1|")
    assert "|Pn:D" in report
    grbl.world.controller.granted[Permission.DOORS_CLOSED] = True
    assert grbl.type(b"?")[0].startswith("<Door:0|")
    assert grbl.type(b"~?")[0].startswith("<Run|")


def test_settings_that_need_each_other(grbl: Terminal) -> None:
    assert grbl.type(b"$22=0\n$20=1\n") == ["ok", "error:10"]
    assert grbl.type(b"$H\n") == ["error:5"]


def test_some_commands_only_while_idle(grbl: Terminal) -> None:
    grbl.type(b"G53G1X-3990F600\n")
    assert grbl.type(b"$$\n$#\n$I\n$H\n") == ["error:8"] * 4
    assert grbl.type(b"$G\n")[-1] == "ok"


class TestTargetWhereTheAxesStand:
    """GRBL compares the target of a probe cycle with the position of its parser, bit by bit in single precision."""

    def test_the_target_of_a_missed_cycle_is_refused_although_the_axes_stand_on_a_step_beside_it(
        self, grbl: Terminal
    ) -> None:
        grbl.type(b"G38.3X-3990.0004Y-1299.9997F6000\n")
        assert grbl.wait(5.0) == ["[PRB:-3990.000,-1300.000,-1500.000:0]", "ok"]
        assert grbl.type(b"G38.3X-3990.0004Y-1299.9997F6000\n") == ["error:33"]

    def test_the_target_of_a_move_is_refused(self, grbl: Terminal) -> None:
        grbl.type(b"G53G0X-3990.0004\n")
        grbl.wait(5.0)
        assert grbl.type(b"G38.3X-3990.0004F600\n") == ["error:33"]

    def test_another_target_within_the_step_is_a_cycle_of_no_length(self, grbl: Terminal) -> None:
        grbl.type(b"G53G0X-3990.0004\n")
        grbl.wait(5.0)
        assert grbl.type(b"G38.3X-3990.0000F600\n") == ["[PRB:-3990.000,-1300.000,-1500.000:0]", "ok"]

    def test_numbers_that_are_equal_in_single_precision_are_equal(self, grbl: Terminal) -> None:
        grbl.type(b"G53G0X-3990.0004\n")
        grbl.wait(5.0)
        assert grbl.type(b"G38.3X-3990.00041F600\n") == ["error:33"]

    def test_after_a_trip_the_position_is_that_of_the_steps(self) -> None:
        grbl = Terminal(_100=400.0)  # 2.5 um a step
        grbl.type(b"G53G0X-3990.001\n")
        grbl.wait(5.0)
        assert "MPos:-3990.000" in grbl.type(b"?")[0]
        grbl.type(b"\x18")
        assert grbl.type(b"G38.3X-3990F600\n") == ["error:33"]


class TestJogging:
    def test_jog_ends_at_a_cancel_and_keeps_the_position(self, grbl: Terminal) -> None:
        assert grbl.type(b"$J=G53X-3000F6000\n") == ["ok"]
        grbl.wait(2.0)
        assert grbl.type(b"?")[0].startswith("<Jog|")
        assert grbl.type(b"G0X-1\n") == ["error:9"]
        grbl.type(b"\x85")
        grbl.wait(2.0)
        assert grbl.type(b"?")[0].startswith("<Idle|MPos:-38")
        assert grbl.type(b"G53G0X-3900\n") == ["ok"]

    def test_hold_cancels_a_jog(self, grbl: Terminal) -> None:
        grbl.type(b"$J=G53X-3000F6000\n")
        grbl.wait(2.0)
        grbl.type(b"!")
        grbl.wait(2.0)
        assert grbl.type(b"?")[0].startswith("<Idle|")

    @pytest.mark.parametrize(
        ("line", "code"),
        [(b"$J=G53X1F600", 15), (b"$J=X-1", 22), (b"$J=G1X-1F100", 16), (b"$J=F100", 26), (b"$JX-1F100", 3)],
    )
    def test_refused_jog(self, grbl: Terminal, line: bytes, code: int) -> None:
        assert grbl.type(line + b"\n") == [f"error:{code}"]
        assert grbl.type(b"?")[0].startswith("<Idle|")


class TestGrblHal:
    @pytest.fixture
    def hal(self) -> Terminal:
        return Terminal(dialect=GRBL_HAL)

    @pytest.mark.parametrize("acknowledged", [b"\n", b"$G\n", b"\x85"])
    def test_an_error_is_repeated_until_it_is_acknowledged(self, hal: Terminal, acknowledged: bytes) -> None:
        assert hal.type(b"G99\n") == ["error:20"]
        assert hal.type(b"G90\n") == ["error:20"]
        hal.type(acknowledged)
        assert hal.type(b"G90\n") == ["ok"]

    def test_a_reset_acknowledges_too(self, hal: Terminal) -> None:
        hal.type(b"=\n")
        assert hal.type(b"\x18") == ["", "GrblHAL 1.1f ['$' or '$HELP' for help]"]
        assert hal.type(b"G90\n") == ["ok"]

    def test_identity_and_settings(self, hal: Terminal) -> None:
        lines = hal.type(b"$I\n")
        assert {"[FIRMWARE:grblHAL]", "[AXS:3:XYZ]"} <= set(lines)
        assert {"$10=511", "$44=4", "$45=3"} <= set(hal.type(b"$$\n"))

    def test_reports_also_after_a_critical_alarm(self, hal: Terminal) -> None:
        assert hal.type(b"G53G0X1\n") == ["ALARM:2", "[MSG:Reset to continue]"]
        assert hal.type(b"?")[0].startswith("<Alarm|")
        assert hal.type(b"$X\n") == []

    def test_hard_limits_shrink_the_travel_by_the_pull_off(self) -> None:
        hal = Terminal(dialect=GRBL_HAL, _21=1.0, _27=2.5)
        assert hal.type(b"G53G0X-2.5Y-2.5Z-2.5\n") == ["ok"]
        hal.wait(200.0)
        assert hal.type(b"G53G0X-2.4\n")[0] == "ALARM:2"
        assert Terminal(dialect=GRBL_HAL, _27=2.5).type(b"G53G0X-2.4\n") == ["ok"]
        assert Terminal(_21=1.0, _27=2.5).type(b"G53G0X-2.4\n") == ["ok"]

    def test_jog_cancel_discards_waiting_lines_without_an_answer(self, hal: Terminal) -> None:
        hal.type(b"G4P1\nG90\n")
        hal.type(b"\x85")
        assert hal.wait(2.0) == ["ok"]

    def test_not_homed_is_alarm_11_at_power_on(self, hal: Terminal) -> None:
        hal.grbl.reboot()
        assert hal.heard()[-1] == "ALARM:11"
        assert "|H:0" in hal.type(b"?")[0]
        hal.type(b"$H\n")
        assert hal.wait(1000.0) == ["ok"]
        assert "|H:1" in hal.type(b"?")[0]


@pytest.mark.parametrize("dialect", [GRBL_11, GRBL_HAL])
def test_failed_homing_is_an_alarm_and_a_restart(dialect: GrblDialect) -> None:
    grbl = Terminal(dialect=dialect)
    grbl.grbl.homing_fails = 9
    assert grbl.type(b"$H\n") == ["ALARM:9", "ok", "", dialect.welcome, LOCKED]
    assert grbl.type(b"G0X-1\n") == ["error:9"]


class TestPseudoTerminal:
    def test_link_is_made_and_taken_away(self, tmp_path: Path) -> None:
        heard: list[bytes] = []
        link = tmp_path / "tty"
        line = PseudoTerminal("test", heard.append, str(link))
        line.start()
        there = os.open(link, os.O_RDWR | os.O_NOCTTY)
        line.send(b"raw \x00\x03\x11\x13\xff\r\n")
        assert select.select([there], [], [], 5.0)[0]
        assert os.read(there, 100) == b"raw \x00\x03\x11\x13\xff\r\n"
        os.close(there)
        line.close()
        assert not link.is_symlink()

    def test_link_that_cannot_be_made(self, tmp_path: Path) -> None:
        with pytest.raises(ConfigurationError, match="cannot be created"):
            PseudoTerminal("test", lambda _: None, str(tmp_path / "none" / "tty"))

    def test_file_in_its_place_is_left_alone(self, tmp_path: Path) -> None:
        (tmp_path / "tty").write_text("mine")
        with pytest.raises(ConfigurationError):
            PseudoTerminal("test", lambda _: None, str(tmp_path / "tty"))
        assert (tmp_path / "tty").read_text() == "mine"

    def test_bytes_nobody_reads_are_lost_and_block_nobody(self) -> None:
        line = PseudoTerminal("test", lambda _: None)
        for _ in range(100):
            line.send(b"x" * 4000)
        line.close()
