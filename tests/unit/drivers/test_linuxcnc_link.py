"""Tests of the driver `linuxcnc` with a faulty bridge, and of its diagnosis of wrong settings."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from drivers.clock import VirtualClock
from drivers.errors import (
    CommandRejected,
    ConfigurationError,
    DeadlineExpired,
    DeviceError,
    GuardTripped,
    LinkLost,
    LinkTimeout,
    MotionFault,
    PermissionMissing,
    ProtocolError,
)
from drivers.linuxcnc.bridge_link import BridgeLink
from drivers.linuxcnc.device import LinuxCnc
from drivers.linuxcnc.plugin import PLUGIN
from drivers.linuxcnc.settings import LinuxCncSettings
from drivers.registry import DeviceContext
from drivers.roles import DiagnosticFinding, MotionState, Touch

PATIENCE_S = 600.0
FAKE = Path(__file__).with_name("linuxcnc_fake_bridge.py")
HELLO = {
    "protocol": 1,
    "version": "2.9.0",
    "ini": "/home/cnc/machine.ini",
    "pid": 1,
    "linear_units": 1.0,
    "axis_mask": 7,
    "joints": 3,
    "limits": [[0.0, 100.0], [0.0, 200.0], [0.0, 300.0]],
    "joint_limits": [[-1.0, 101.0], [0.0, 201.0], [-1.0, 301.0]],
    "watched": ["motion", "task", "tool and e-stop I/O"],
    "monotonic_s": 0.0,
}
STATUS = {
    "position": [1.0, 2.0, 3.0],
    "eoffset": [0.0, 0.0, 0.0],
    "probed": [0.0, 0.0, 0.0],
    "tripped": False,
    "probe": False,
    "task_state": "on",
    "mode": "mdi",
    "state": "done",
    "idle": True,
    "paused": False,
    "in_position": True,
    "velocity": 0.0,
    "homed": True,
    "homing": False,
    "joint_faults": [],
    "on_limit": [],
    "spindle": False,
    "tool": 1,
    "program_offset": [0.0, 0.0, 0.0],
    "rotation_deg": 0.0,
    "modal": [21.0, 90.0, 94.0],
    "feed_override": 1.0,
    "rapid_override": 1.0,
    "abandoned": False,
    "held_by_volcal": False,
    "errors": [],
    "pins": [],
    "monotonic_s": 0.0,
}
AXES = ["10", "100"] * 3
SEARCHES = [None, "0.0", "-20 # towards the table"]
INI = [*AXES, *["2"] * 3, *SEARCHES, "1000000", "case-study", "10"]
TARGET = np.array([10.0, 2.0, 3.0])
Script = dict[str, list[Any]]
Make = Callable[..., LinuxCnc]


def script(**changes: list[Any]) -> Script:
    usual: Script = {
        "hello": [{"ok": HELLO}],
        "ini": [{"ok": {"values": INI}}],
        "status": [{"ok": STATUS}],
    }
    return usual | changes


def look(**changes: Any) -> dict[str, Any]:
    return {"ok": STATUS | changes}


@pytest.fixture
def make(tmp_path: Path) -> Iterator[Make]:
    made: list[LinuxCnc] = []

    def opened(told: Script, **options: Any) -> LinuxCnc:
        file = tmp_path / f"{len(made)}.json"
        file.write_text(json.dumps(told), encoding="utf-8")
        command = (sys.executable, str(FAKE), str(file))
        settings = LinuxCncSettings(bridge_command=command, response_timeout_s=60.0, **options)
        device = LinuxCnc(settings, DeviceContext("cnc", VirtualClock(), tmp_path))
        made.append(device)
        device.open()
        return device

    yield opened
    for device in made:
        with suppress(DeviceError):  # modes cannot be restored while an axis still moves
            device.close()


class TestHoming:
    def test_directions_are_the_signs_of_the_search_speeds(self, make: Make) -> None:
        device = make(script())
        assert device.homing_directions() == (0, 0, -1)
        assert "absolute encoder" in device.why_no_homing()
        switches = [*AXES, None, None, "2", "15", "x", "-20", "1000000", "case-study", "10"]
        with_switches = make(script(ini=[{"ok": {"values": switches}}]))
        assert with_switches.homing_directions() == (1, 0, -1)
        assert with_switches.why_no_homing() == ""

    def test_axes_are_homed_when_they_were_seen_unhomed_and_homed_again(self, make: Make) -> None:
        looks = [look(), look(homed=False, homing=True), look(homed=False, homing=True), look()]
        device = make(script(status=looks, home=[{"ok": {}}]))
        device.home_axes()
        assert not device.status().missing

    def test_a_homing_that_fails_says_why(self, make: Make) -> None:
        looks = [look(), look(homed=False, homing=True), look(homed=False, errors=["joint 2 home switch not found"])]
        device = make(script(status=looks, home=[{"ok": {}}], abort=[{"ok": {}}]))
        with pytest.raises(CommandRejected, match="homing failed: joint 2 home switch not found"):
            device.home_axes()


@pytest.fixture
def link(tmp_path: Path) -> Iterator[Callable[..., BridgeLink]]:
    made: list[BridgeLink] = []

    def of(*answers: Any) -> BridgeLink:
        file = tmp_path / "script.json"
        file.write_text(json.dumps(script(ask=list(answers))), encoding="utf-8")
        command = (sys.executable, str(FAKE), str(file))
        made.append(
            BridgeLink(
                command, response_timeout_s=PATIENCE_S, watchdog_timeout_s=0.0, heartbeat_timeout_s=1.0, device="cnc"
            )
        )
        made[-1].open()
        return made[-1]

    yield of
    for one in made:
        one.close()


def never_answered(link: BridgeLink) -> None:
    """Check that a request to which no answer comes ends with a timeout, however little is waited."""
    link.response_timeout_s = 0.1
    with pytest.raises(LinkTimeout):
        link.ask("ask")
    link.response_timeout_s = PATIENCE_S


class TestLink:
    def test_dead_bridge_reports_why_and_is_not_restarted(self, link) -> None:
        dying = link("die")
        with pytest.raises(LinkLost, match="shot by the test"):
            dying.ask("ask")
        assert not dying.connected
        with pytest.raises(LinkLost):
            dying.ask("ask")

    def test_abort_starts_another_bridge_for_one_that_died(self, link) -> None:
        dying = link("die")
        with pytest.raises(LinkLost):
            dying.ask("ask")
        dying.abort()
        assert dying.connected

    def test_abort_replaces_a_bridge_that_hangs(self, link) -> None:
        hanging = link("hang")
        never_answered(hanging)
        before = hanging.pid
        hanging.abort()
        assert hanging.pid != before

    def test_silence_is_a_timeout_and_a_late_answer_is_discarded(self, link) -> None:
        silent = link("silent", {"ok": {"stale": False}})
        never_answered(silent)
        assert silent.ask("ask") == {"stale": False}

    def test_answer_of_another_number_is_dropped(self, link) -> None:
        assert link("late").ask("ask") == {"stale": False}

    def test_invalid_json_is_a_protocol_error(self, link) -> None:
        with pytest.raises(ProtocolError, match="Segmentation"):
            link("garbage").ask("ask")

    @pytest.mark.parametrize(
        ("error", "kind"), [("gone", LinkLost), ("unknown", CommandRejected), ("refused", CommandRejected)]
    )
    def test_refusals_have_their_types(self, link, error: str, kind: type[Exception]) -> None:
        with pytest.raises(kind, match="the reason"):
            link({"error": error, "text": "the reason"}).ask("ask")

    def test_stopped_process_of_linuxcnc_is_a_lost_link_that_says_what_to_do(self, link) -> None:
        with pytest.raises(LinkLost, match="task has ended") as caught:
            link({"error": "stopped", "text": "LinuxCNC's task has ended; its motion is held"}).ask("ask")
        assert "emergency stop" in caught.value.hint

    def test_missing_program(self) -> None:
        absent = BridgeLink(
            ["/no/such/python3"], response_timeout_s=1.0, watchdog_timeout_s=0.0, heartbeat_timeout_s=1.0, device="cnc"
        )
        with pytest.raises(LinkLost, match="cannot be started"):
            absent.open()

    def test_program_that_ends_without_output(self) -> None:
        mute = BridgeLink(
            ["true"], response_timeout_s=PATIENCE_S, watchdog_timeout_s=0.0, heartbeat_timeout_s=1.0, device="cnc"
        )
        with pytest.raises(LinkLost, match="ended with 0"):
            mute.open()


class TestDevice:
    def test_units_are_those_of_the_ini_file(self, make: Make) -> None:
        device = make(script(hello=[{"ok": HELLO | {"linear_units": 1.0 / 25.4}}]))
        assert device.limits().upper_mm == pytest.approx((2540.0, 5080.0, 7620.0))
        assert device.limits().rapid_mm_per_s == pytest.approx((254.0,) * 3)
        assert device.position() == pytest.approx([25.4, 50.8, 76.2])

    def test_external_offset_is_not_part_of_the_position(self, make: Make) -> None:
        device = make(script(status=[look(eoffset=[0.1, -0.2, 0.0])]))
        assert device.position() == pytest.approx([0.9, 2.2, 3.0])

    @pytest.mark.parametrize(
        ("change", "kind"),
        [
            ({"protocol": 2}, ProtocolError),
            ({"axis_mask": 3}, ConfigurationError),
            ({"linear_units": 0.0}, ProtocolError),
        ],
    )
    def test_bridge_or_machine_that_does_not_fit(
        self, make: Make, change: dict[str, Any], kind: type[Exception]
    ) -> None:
        with pytest.raises(kind):
            make(script(hello=[{"ok": HELLO | change}]))

    def test_status_with_a_missing_field(self, make: Make) -> None:
        told = {name: value for name, value in STATUS.items() if name != "tripped"}
        with pytest.raises(ProtocolError, match="status cannot be read"):
            make(script(status=[{"ok": told}])).status()

    @pytest.mark.parametrize("name", ["position", "probed", "eoffset", "program_offset"])
    @pytest.mark.parametrize("value", [math.nan, math.inf])
    def test_position_that_is_no_number_is_none(self, make: Make, name: str, value: float) -> None:
        device = make(script(status=[look(**{name: [1.0, value, 3.0]})]))
        for request in (device.position, lambda: device.move_to(TARGET, feed_mm_per_s=1.0, guarded=True)):
            with pytest.raises(ProtocolError, match="no number"):
                request()

    def test_motion_that_never_ends_expires_and_is_aborted(self, make: Make) -> None:
        told = script(
            status=[look(), look(state="exec", idle=False)], abort=[{"error": "refused", "text": "abort came"}]
        )
        with pytest.raises(DeadlineExpired) as caught:
            make(told).move_to(TARGET, feed_mm_per_s=1.0, guarded=True)
        assert "abort came" in "".join(caught.value.__notes__)

    def test_motion_that_ends_elsewhere_was_stopped(self, make: Make) -> None:
        with pytest.raises(MotionFault, match="stopped at the machine"):
            make(script()).move_to(TARGET, feed_mm_per_s=1.0, guarded=True)

    def test_guard_trip_is_raised_after_the_axes_have_stopped(self, make: Make) -> None:
        tripped = look(state="error", in_position=False, errors=["Probe tripped during non-probe move"])
        braking, resting = look(in_position=False, position=[4.0, 2.0, 3.0]), look(position=[4.1, 2.0, 3.0])
        device = make(script(status=[look(), tripped, braking, braking, resting]))
        with pytest.raises(GuardTripped, match=r"near X 4\.100"):
            device.move_to(TARGET, feed_mm_per_s=1.0, guarded=True)
        assert device.status().state is MotionState.IDLE

    def test_refusal_contains_a_late_message_of_linuxcnc(self, make: Make) -> None:
        told = script(status=[look(), look(state="error"), look(state="error", errors=["beyond X's limit"])])
        with pytest.raises(CommandRejected, match="beyond X's limit"):
            make(told).move_to(TARGET, feed_mm_per_s=1.0, guarded=True)

    @pytest.mark.parametrize(
        ("end", "error", "text"),
        [
            ({"state": "error", "errors": ["too close to the probe point"]}, CommandRejected, "too close to the probe"),
            ({}, MotionFault, "probably stopped at the machine"),
        ],
        ids=["refused", "stopped before it began"],
    )
    def test_trip_of_an_earlier_touch_is_not_taken_for_one_of_a_touch_that_did_not_begin(
        self, make: Make, end: dict[str, Any], error: type[DeviceError], text: str
    ) -> None:
        """LinuxCNC clears its flag of the trip only when it begins a touch; the old position lies on the path."""
        earlier = {"tripped": True, "probed": [5.0, 2.0, 3.0]}
        device = make(script(status=[look(**earlier), look(**earlier), look(**earlier, **end)]))
        with pytest.raises(error, match=text):
            device.touch_towards(TARGET, feed_mm_per_s=5.0)

    def test_touch_whose_axes_have_come_to_the_latched_position_is_one(self, make: Make) -> None:
        ended = look(tripped=True, probed=[5.0, 2.0, 3.0], position=[5.01, 2.0, 3.0])
        device = make(script(status=[look(), look(), ended]))
        touched = device.touch_towards(TARGET, feed_mm_per_s=5.0)
        assert isinstance(touched, Touch)
        assert touched.position_mm == pytest.approx((5.0, 2.0, 3.0), abs=0.01)

    @pytest.mark.parametrize("free", [True, False])
    def test_probe_deflected_in_unknown_direction_is_freed_first(self, make: Make, free: bool) -> None:
        start, led = look(probe=True), look(probe=not free, position=[3.0, 2.0, 3.0])
        told = script(status=[start, led, look(position=[10.0, 2.0, 3.0])])
        device = make(told)
        if free:
            device.move_to(TARGET, feed_mm_per_s=None, guarded=True)
        else:
            with pytest.raises(GuardTripped, match="still deflected after 2 mm"):
                device.move_to(TARGET, feed_mm_per_s=None, guarded=True)

    def test_wait_for_the_end_of_a_hold_is_bounded(self, make: Make) -> None:
        told = script(status=[look(), look(state="exec", idle=False, paused=True)])
        with pytest.raises(MotionFault, match="more than 30 s"):
            make(told, max_hold_s=30.0).move_to(TARGET, feed_mm_per_s=1.0, guarded=True)

    def test_machine_busy_with_a_program_is_not_disturbed(self, make: Make) -> None:
        told = script(
            status=[look(mode="auto", idle=False, state="exec")], abort=[{"error": "refused", "text": "never asked"}]
        )
        with pytest.raises(Exception, match="no part program running") as caught:
            make(told).move_to(TARGET, feed_mm_per_s=1.0, guarded=True)
        assert not hasattr(caught.value, "__notes__")

    def test_stopped_task_ends_the_motion_and_does_not_hinder_closing(self, make: Make) -> None:
        stopped = {"error": "stopped", "text": "LinuxCNC's task has stopped"}
        device = make(script(status=[look(), look(state="exec", idle=False), stopped], abort=[stopped]))
        with pytest.raises(LinkLost, match="task has stopped"):
            device.move_to(TARGET, feed_mm_per_s=1.0, guarded=True)
        device.close()

    def test_held_feed_is_a_fault_until_the_reset(self, make: Make) -> None:
        held = look(state="exec", idle=False, held_by_volcal=True)
        device = make(script(status=[held, held, held, held, look()]))
        assert device.status().state is MotionState.FAULT
        assert "volcal-hold" in device.status().fault
        with pytest.raises(PermissionMissing, match="volcal-hold"):
            device.move_to(TARGET, feed_mm_per_s=1.0, guarded=True)
        device.reset()
        assert device.status().state is MotionState.IDLE

    def test_closed_device_says_so_and_stops_nothing(self, make: Make) -> None:
        device = make(script())
        device.close()
        device.stop()
        with pytest.raises(LinkLost, match="not open"):
            device.move_to(TARGET, feed_mm_per_s=None, guarded=True)

    def test_store_that_is_not_configured(self, make: Make) -> None:
        with pytest.raises(ConfigurationError, match=r"compensation\.method"):
            make(script()).active_bank()


class TestDoctor:
    @staticmethod
    def findings(device: LinuxCnc) -> dict[str, DiagnosticFinding]:
        return {finding.subject: finding for finding in device.diagnose()}

    def test_wrong_settings_are_reported(self, make: Make) -> None:
        ini = [INI, ["1.5", None, None, None, None, "2", "2", None, "10", None]]
        status = look(homed=False, feed_override=0.5, rotation_deg=3.0, probe=True)
        found = self.findings(make(script(ini=[{"ok": {"values": values}} for values in ini], status=[status])))
        wrong = {subject for subject, finding in found.items() if not finding.ok}
        assert wrong >= {
            "state",
            "permissions",
            "probe",
            "feed override",
            "work coordinates",
            "[DISPLAY]MAX_FEED_OVERRIDE",
        }
        assert not found["homing"].ok
        assert "JOINT_0" in found["homing"].text
        assert "JOINT_1" not in found["homing"].text
        assert "external offsets have no effect" in found["[AXIS_*]OFFSET_AV_RATIO"].text

    @pytest.mark.parametrize(
        ("version", "ok", "text"),
        [
            ("2.8.4", False, "older than 2.9"),
            ("2.9.0~pre1", True, "the contact bounces"),
            ("2.9.4", True, "releases before 2.9.5"),
            ("2.9.5", True, "LinuxCNC 2.9.5: motion, probing and compensation"),
            ("2.10.0~pre0", None, "its HAL interface has changed"),
            ("master", None, "is no release"),
        ],
    )
    def test_what_a_version_is_good_for(self, make: Make, version: str, ok: bool | None, text: str) -> None:
        ini = [{"ok": {"values": INI}}, {"ok": {"values": [None] * 10}}]
        found = self.findings(make(script(hello=[{"ok": HELLO | {"version": version}}], ini=ini)))["version"]
        assert found.ok is ok
        assert text in found.text

    def test_heartbeats_that_cannot_be_watched_are_reported(self, make: Make) -> None:
        hello = HELLO | {"watched": ["motion"]}
        ini = [{"ok": {"values": INI}}, {"ok": {"values": [None] * 10}}]
        found = self.findings(make(script(hello=[{"ok": hello}], ini=ini)))
        assert not found["heartbeats"].ok
        assert "task cannot be watched" in found["heartbeats"].text

    @pytest.mark.parametrize("least_y", [0.0, -1.0])
    def test_joints_need_room_for_the_correction_beyond_their_axes(self, make: Make, least_y: float) -> None:
        limits = [[-1.0, 101.0], [least_y, 201.0], [-1.0, 301.0]]
        ini = [{"ok": {"values": INI}}, {"ok": {"values": [None] * 10}}]
        silent = [{"ok": {"values": [0]}}]
        told = script(hello=[{"ok": HELLO | {"joint_limits": limits}}], ini=ini, hal_get=silent)
        options = {"method": "external-offsets", "directory": "tables"}
        found = self.findings(make(told, compensation=options))["[JOINT_*] limits"]
        assert found.ok == (least_y == -1.0)
        assert f"Y {abs(least_y):g} mm" in found.text

    def test_long_servo_period_is_reported(self, make: Make) -> None:
        slow = [*INI[:12], "2000000", *INI[13:]]
        found = self.findings(make(script(ini=[{"ok": {"values": slow}}, {"ok": {"values": [None] * 10}}])))
        assert not found["[EMCMOT]SERVO_PERIOD"].ok
        assert "up to 10.0 µm" in found["[EMCMOT]SERVO_PERIOD"].text

    def test_clock_with_another_rate_is_reported(self, make: Make) -> None:
        looks = [look(monotonic_s=10.0 * number) for number in range(60)]
        found = self.findings(
            make(script(ini=[{"ok": {"values": INI}}, {"ok": {"values": [None] * 10}}], status=looks))
        )
        assert not found["latency"].ok

    def test_unreachable_bridge_is_a_finding(self, tmp_path: Path) -> None:
        settings = LinuxCncSettings(bridge_command=("/no/such/python3",))
        found = LinuxCnc(settings, DeviceContext("cnc", VirtualClock(), tmp_path)).diagnose()
        assert [(finding.subject, finding.ok) for finding in found] == [("bridge", False)]


@pytest.mark.parametrize(
    "options",
    [
        {"bridge_command": []},
        {"watchdog_timeout_s": -1.0},
        {"temperatures": {"artefact": "not a pin"}},
        {"permissions": {"doors": "x"}},
        {"homing": "yes"},
        {"compensation": {"method": "wishes", "directory": "x"}},
    ],
)
def test_settings_are_bounded(options: dict[str, Any]) -> None:
    with pytest.raises(ValidationError):
        PLUGIN.settings.model_validate(options)
