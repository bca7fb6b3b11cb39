"""Lines as in the documents of GRBL and grblHAL, and lines garbled by a bad cable."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.serial_cnc.controller_settings import ControllerSettings
from drivers.serial_cnc.lines import (
    AlarmLine,
    AnswerLine,
    GarbledLineError,
    MessageLine,
    ProbeResult,
    SettingLine,
    StartupLine,
    StatusReport,
    WelcomeLine,
    parse_line,
)

MODES = "G0 G54 G17 G21 G90 G94 M0 M5 M9 T0 F0. S0."


@pytest.mark.parametrize(
    ("line", "parsed"),
    [
        (b"ok", AnswerLine(None)),
        (b"error:20", AnswerLine(20)),
        (b"ALARM:5", AlarmLine(5)),
        (b"[PRB:-1.500,2.000,0.005:1]", ProbeResult((-1.5, 2.0, 0.005), True)),
        (b"[PRB:0.000,0.000,0.000:0]", ProbeResult((0.0, 0.0, 0.0), False)),
        (b"[PRB:1.000,2.000,3.000,4.000:1]", ProbeResult((1.0, 2.0, 3.0), True)),
        (b"[MSG:'$H'|'$X' to unlock]", MessageLine("MSG", "'$H'|'$X' to unlock")),
        (b"[GC:G0 G54 G17 G21 G90 G94 M0 M5 M9 T0 F0. S0.]", MessageLine("GC", MODES)),
        (b"[G54:4.000,0.000,0.000]", MessageLine("G54", "4.000,0.000,0.000")),
        (b"[TLO:0.000]", MessageLine("TLO", "0.000")),
        (b"[VER:v1.1d.20161014:Some string]", MessageLine("VER", "v1.1d.20161014:Some string")),
        (b"[FIRMWARE:grblHAL]", MessageLine("FIRMWARE", "grblHAL")),
        (b"$110=500.000", SettingLine(110, "500.000")),
        (b"$110=500.000 (x max rate, mm/min)", SettingLine(110, "500.000")),
        (b"$74=workshop", SettingLine(74, "workshop")),
        (b"$N0=G54", StartupLine("$N0=G54")),
        (b">G54G20:ok", StartupLine(">G54G20:ok")),
        (b"Grbl 1.1d ['$' for help]", WelcomeLine("Grbl 1.1d ['$' for help]")),
        (b"GrblHAL 1.1f ['$' or '$HELP' for help]", WelcomeLine("GrblHAL 1.1f ['$' or '$HELP' for help]")),
    ],
)  # fmt: skip
def test_each_line_has_its_class(line: bytes, parsed: object) -> None:
    assert parse_line(line) == parsed


def test_status_report_with_every_field() -> None:
    report = parse_line(
        b"<Hold:1|MPos:0.000,-10.000,5.000|Bf:15,128|Ln:99999|FS:500,8000|Pn:XYZPDHRS|WCO:0.000,1.551,5.664|A:SFM>"
    )
    assert isinstance(report, StatusReport)
    assert (report.state, report.substate) == ("Hold", 1)
    assert report.triple("MPos") == (0.0, -10.0, 5.0)
    assert report.triple("WCO") == (0.0, 1.551, 5.664)
    assert report.triple("WPos") is None
    assert report.fields["Pn"] == "XYZPDHRS"


@pytest.mark.parametrize(
    "line",
    [b"", b"k", b"o", b"okok", b"error:", b"error:x", b"ALARM:", b"<Idle", b"<Idle|MPos:1.0,2.0>", b"<Idle>",
     b"<Idle|MPos:1,2,nan>", b"<Sleeping|MPos:0,0,0>", b"<Idle|MPos:0,0,0|WCO:1,2>", b"<Idle|MPos:0,0,0|FS>",
     b"<Idle|MPos:0,0,0|MPos:0,0,0>", b"<Idle|MPos:0,0,0|FS:0>", b"<Idle|MPos:0,0,0|Ov:1x0,100,100>",
     b"[PRB:1.000,2.000:1]", b"[PRB:1.000,2.000,3.000]", b"[PRB:1,2,3:2]", b"[]",
     b"Grbl", b"\xff\xfe", b"$=1", b"MPos:0.000,0.000,0.000>"],
)  # fmt: skip
def test_cut_and_garbled_lines_are_no_lines(line: bytes) -> None:
    with pytest.raises(GarbledLineError):
        parse_line(line)


@given(st.binary(max_size=120))
def test_no_bytes_break_it_otherwise(line: bytes) -> None:
    try:
        parse_line(line)
    except GarbledLineError:
        return


@given(st.integers(1, 97))
def test_a_report_cut_anywhere_is_none(length: int) -> None:
    whole = b"<Run|MPos:-3999.123,-1299.456,-1499.789|FS:20000,0|Pn:P|WCO:-100.000,-200.000,-300.000|Ov:100,100,100>"
    with pytest.raises(GarbledLineError):
        parse_line(whole[:length])


class TestControllerSettings:
    def told(self, *lines: str) -> ControllerSettings:
        base = {10: 1, 13: 0, 20: 1, 22: 1, 23: 0}
        base |= {100 + a: 1000 for a in range(3)} | {110 + a: 600 for a in range(3)} | {120 + a: 10 for a in range(3)}
        base |= {130: 200, 131: 300, 132: 80}
        given_lines = [f"${number}={value}" for number, value in base.items()] + list(lines)
        parsed = [parse_line(line.encode()) for line in given_lines]
        return ControllerSettings.of([line for line in parsed if isinstance(line, SettingLine | MessageLine)])

    def test_machine_space_is_negative(self) -> None:
        limits = self.told().limits((-200.0, -300.0, -80.0))
        assert limits.lower_mm == (0.0, 0.0, 0.0)
        assert limits.upper_mm == (200.0, 300.0, 80.0)
        assert limits.rapid_mm_per_s == (10.0, 10.0, 10.0)

    def test_origin_at_home_turns_it_where_an_axis_homes_downwards(self) -> None:
        limits = self.told("[OPT:VZL,15,128]", "$23=2").limits((0.0, 0.0, 0.0))
        assert limits.lower_mm == (-200.0, 0.0, -80.0)
        assert limits.upper_mm == (0.0, 300.0, 0.0)

    def test_grbl_hal_says_the_same_by_a_bit_of_22(self) -> None:
        limits = self.told("[FIRMWARE:grblHAL]", "$22=9", "$23=7").limits((0.0, 0.0, 0.0))
        assert limits.lower_mm == (0.0, 0.0, 0.0)

    def test_grbl_hal_must_report_pins_offset_and_probe(self) -> None:
        findings = {f.subject: f for f in self.told("[FIRMWARE:grblHAL]", "$10=1").findings(manual_referencing=False)}
        assert not findings["reports"].ok
        assert "set $10=177" in findings["reports"].text
        fine = self.told("[FIRMWARE:grblHAL]", "$10=511").findings(manual_referencing=False)
        assert all(finding.ok for finding in fine)

    def test_setting_that_is_not_told_is_named(self) -> None:
        told = ControllerSettings.of([SettingLine(10, "1")])
        assert "$13" in told.fatal()
