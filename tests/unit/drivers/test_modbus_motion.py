"""Tests of motion, probing and session of the Modbus driver, with a small PLC in virtual time."""

from __future__ import annotations

import re
from contextlib import closing
from typing import Any

import numpy as np
import pytest
from modbus_plc import FakePlc
from modbus_rig import opened

from agent.errors import Aborted
from drivers.clock import InterruptibleClock, VirtualClock
from drivers.errors import (
    CommandRejected,
    DeadlineExpired,
    GuardTripped,
    LinkLost,
    LinkTimeout,
    MotionFault,
    PermissionMissing,
    ProtocolError,
    StoreError,
)
from drivers.modbus_cnc.device import ModbusCnc
from drivers.modbus_cnc.settings import ModbusCncSettings
from drivers.roles import (
    CompensationStore,
    LookOnlyDevice,
    Machine,
    Miss,
    MotionState,
    Permission,
    Probe,
    TableImage,
    Thermometer,
    Touch,
)

START = (100.0, 200.0, 300.0)


def test_it_implements_four_roles(cnc: ModbusCnc) -> None:
    for role in (Machine, Probe, CompensationStore, Thermometer):
        assert isinstance(cnc, role)


def test_it_reads_limits_status_position_and_temperatures(cnc: ModbusCnc, plc: FakePlc) -> None:
    plc.registers[1006] = 0x7F & ~0b10
    assert cnc.limits().upper_mm == (4000.0, 1300.0, 1500.0)
    assert cnc.status().state is MotionState.IDLE
    assert cnc.status().missing == (Permission.DOORS_CLOSED,)
    assert cnc.position().tolist() == list(START)
    assert cnc.temperatures_c() == {"artefact": 20.5, "ambient": 21.0, "machine": -0.125}
    assert cnc.probe_status().loaded


def test_bodies_of_the_machine_have_sensors_by_the_order_of_their_registers(plc: FakePlc, clock: VirtualClock) -> None:
    """Registers 1059 to 1068 hold the fourth to the eighth temperature; one of them has failed."""
    plc.registers[1052] = 7
    for place, value in enumerate((19250, -(2**31), 22750, 23125), start=3):
        plc.registers[1053 + 2 * place], plc.registers[1054 + 2 * place] = divmod(value % 2**32, 2**16)
    names = ("artefact", "ambient", "machine", "column", "ram", "bed", "")
    with opened(plc, clock, temperatures=names) as cnc:
        found = cnc.temperatures_c()
    assert {name: found[name] for name in ("column", "bed")} == {"column": 19.25, "bed": 22.75}
    assert set(found) == {"artefact", "ambient", "machine", "column", "bed"}


def test_a_move_ends_in_position_with_few_round_trips(cnc: ModbusCnc, plc: FakePlc, clock: VirtualClock) -> None:
    before = len(plc.requests)
    cnc.move_to(np.array([250.0, 200.0, 300.0]), feed_mm_per_s=None, guarded=False)
    assert cnc.position().tolist() == [250.0, 200.0, 300.0]
    assert clock.now() == pytest.approx(1.5, abs=0.02)  # 150 mm at 100 mm/s
    # 1 command, ceil(1.5 / 0.4) polls, 1 position
    assert len(plc.requests) - before <= 1 + 4 + 1


@pytest.mark.parametrize(
    ("feed", "guarded", "code"), [(None, False, 11), (50.0, False, 12), (None, True, 13), (50.0, True, 14)]
)
def test_each_kind_of_move_has_its_command(
    cnc: ModbusCnc, plc: FakePlc, feed: float | None, guarded: bool, code: int
) -> None:
    cnc.move_to(np.array([110.0, 200.0, 300.0]), feed_mm_per_s=feed, guarded=guarded)
    assert plc.commands == [code]


def test_the_heartbeat_outlives_a_long_move(cnc: ModbusCnc, plc: FakePlc) -> None:
    cnc.move_to(np.array([3100.0, 200.0, 300.0]), feed_mm_per_s=None, guarded=False)
    assert plc.registers[1011] == 2


def test_a_touch_returns_what_was_latched(cnc: ModbusCnc, plc: FakePlc) -> None:
    plc.trip_at_mm = 4.0
    result = cnc.touch_towards(np.array([100.0, 210.0, 300.0]), feed_mm_per_s=5.0)
    assert isinstance(result, Touch)
    assert result.position_mm == pytest.approx((100.0, 204.0, 300.0), abs=1e-12)


def test_a_touch_that_meets_nothing_is_a_miss(cnc: ModbusCnc) -> None:
    result = cnc.touch_towards(np.array([100.0, 210.0, 300.0]), feed_mm_per_s=5.0)
    assert isinstance(result, Miss)
    assert result.position_mm == (100.0, 210.0, 300.0)


def touch_of_40_mm(cnc: ModbusCnc, plc: FakePlc, trip_at_mm: float | None) -> tuple[float, int]:
    """Touch from the start; return the Y position of the result and the number of requests of the touch."""
    cnc.move_to(np.array(START), feed_mm_per_s=None, guarded=False)
    plc.trip_at_mm = trip_at_mm
    before = len(plc.requests)
    result = cnc.touch_towards(np.array([100.0, 240.0, 300.0]), feed_mm_per_s=5.0)
    plc.trip_at_mm = None
    return result.position_mm[1], len(plc.requests) - before


def test_a_touch_that_trips_where_the_last_one_did_needs_the_fewest_polls(cnc: ModbusCnc, plc: FakePlc) -> None:
    places, requests = zip(*(touch_of_40_mm(cnc, plc, trip) for trip in (10.0, 10.001, 10.002)), strict=True)
    assert places == pytest.approx((210.0, 210.001, 210.002), abs=1e-12)
    assert requests[1] == requests[2] <= requests[0]


@pytest.mark.parametrize(("trip_at_mm", "place_mm"), [(1.0, 201.0), (39.0, 239.0), (None, 240.0)])
def test_a_touch_that_ends_elsewhere_than_the_last_one_is_as_exact(
    cnc: ModbusCnc, plc: FakePlc, clock: VirtualClock, trip_at_mm: float | None, place_mm: float
) -> None:
    touch_of_40_mm(cnc, plc, 10.0)
    began_s = clock.now()
    place, requests = touch_of_40_mm(cnc, plc, trip_at_mm)
    took_s = (place_mm - 200.0) / 5.0
    assert place == pytest.approx(place_mm, abs=1e-12)
    # the move back takes up to 0.4 s, and the end is seen one poll late at most
    assert clock.now() - began_s == pytest.approx(took_s, abs=0.4 + 0.2)
    assert requests < 20 + took_s / 0.1


def test_a_touch_of_no_length_is_a_miss_even_after_a_very_short_one(cnc: ModbusCnc, plc: FakePlc) -> None:
    plc.trip_at_mm = 0.01
    assert isinstance(cnc.touch_towards(np.array([100.0, 200.04, 300.0]), feed_mm_per_s=5.0), Touch)
    plc.trip_at_mm = None
    assert isinstance(cnc.touch_towards(cnc.position(), feed_mm_per_s=5.0), Miss)


def test_a_latch_of_another_touch_is_refused(cnc: ModbusCnc, plc: FakePlc) -> None:
    def restore_old_latch(request: bytes, answer: bytes) -> bytes:
        stale = bytearray(answer)
        if request[7] == 23 and int.from_bytes(answer[9 + 22 : 9 + 24], "big") == 3:  # outcome: tripped
            stale[9 + 48 : 9 + 50] = (999).to_bytes(2, "big")  # latch sequence
        return bytes(stale)

    plc.trip_at_mm = 4.0
    plc.disturb = restore_old_latch
    with pytest.raises(ProtocolError, match="stale latch: it belongs to touch 999, not to touch 1"):
        cnc.touch_towards(np.array([100.0, 210.0, 300.0]), feed_mm_per_s=5.0)


def test_a_latch_off_the_path_is_refused(cnc: ModbusCnc, plc: FakePlc) -> None:
    plc.trip_at_mm = 4.0
    plc.wrong_latch = (100.0, 204.0, 303.0)
    with pytest.raises(ProtocolError, match=r"3\.000 mm off the commanded path"):
        cnc.touch_towards(np.array([100.0, 210.0, 300.0]), feed_mm_per_s=5.0)


def test_a_latch_that_never_changes_is_refused(cnc: ModbusCnc, plc: FakePlc) -> None:
    """The old value lies on the path, and the controller gives it the number of the present touch."""
    plc.wrong_latch = (100.0, 204.00012, 300.0)
    with pytest.raises(ProtocolError, match="repeated touches agree too well"):
        for _ in range(11):
            cnc.move_to(np.array([100.0, 200.0, 300.0]), feed_mm_per_s=None, guarded=False)
            plc.trip_at_mm = 4.0
            cnc.touch_towards(np.array([100.0, 210.0, 300.0]), feed_mm_per_s=5.0)
            plc.trip_at_mm = None


def test_a_guard_trip_is_reported_and_its_fault_cleared(cnc: ModbusCnc, plc: FakePlc) -> None:
    plc.trip_at_mm = 20.0
    with pytest.raises(GuardTripped, match=r"near X 120\.000"):
        cnc.move_to(np.array([200.0, 200.0, 300.0]), feed_mm_per_s=None, guarded=True)
    cnc.move_to(np.array([100.0, 200.0, 300.0]), feed_mm_per_s=None, guarded=False)
    assert plc.commands == [13, 24, 11]


@pytest.mark.parametrize(
    ("code", "error", "text"),
    [
        (1, MotionFault, "emergency stop"),
        (3, MotionFault, "following error"),
        (7, PermissionMissing, "door opened while moving"),
        (42, MotionFault, "unknown fault"),
    ],
)
def test_a_fault_names_its_cause(cnc: ModbusCnc, plc: FakePlc, code: int, error: type[Exception], text: str) -> None:
    plc.fault_at_s = (0.5, code)
    with pytest.raises(error, match=text):
        cnc.move_to(np.array([250.0, 200.0, 300.0]), feed_mm_per_s=None, guarded=False)
    assert text in cnc.status().fault


def test_a_missing_permission_is_named(cnc: ModbusCnc, plc: FakePlc) -> None:
    plc.registers[1006] = 0x7F & ~0b100_0000
    with pytest.raises(PermissionMissing, match="operator consent"):
        cnc.move_to(np.array([250.0, 200.0, 300.0]), feed_mm_per_s=None, guarded=False)


def test_a_target_outside_the_travel_is_refused_with_reason(cnc: ModbusCnc) -> None:
    with pytest.raises(CommandRejected, match=r"MOVE RAPID refused: target outside the travel \(code 5\)"):
        cnc.move_to(np.array([-1.0, 200.0, 300.0]), feed_mm_per_s=None, guarded=False)


@pytest.mark.parametrize("target", [(np.nan, 0.0, 0.0), (np.inf, 0.0, 0.0)])
def test_a_target_that_is_no_number_never_reaches_the_wire(
    cnc: ModbusCnc, plc: FakePlc, target: tuple[float, float, float]
) -> None:
    before = len(plc.requests)
    with pytest.raises(CommandRejected, match="not a motion"):
        cnc.move_to(np.array(target), feed_mm_per_s=None, guarded=False)
    assert len(plc.requests) == before


def test_an_abort_while_waiting_stops_the_motion(plc: FakePlc, clock: VirtualClock) -> None:
    def check() -> None:
        if clock.now() > 0.7:
            raise Aborted("asked for")

    with opened(plc, InterruptibleClock(clock, check)) as cnc:
        with pytest.raises(Aborted):
            cnc.move_to(np.array([250.0, 200.0, 300.0]), feed_mm_per_s=None, guarded=False)
        assert plc.commands == [11, 23]
        assert plc.registers[1011] == 6


@pytest.mark.parametrize(
    ("shown", "outcome", "error", "text"),
    [(7, 2, ProtocolError, "started motion 1, but motion 7 ended"), (1, 2, MotionFault, "ended off its target")],
    ids=["outcome of another motion", "in position too early"],
)
def test_axes_that_move_although_an_end_is_reported_are_stopped(
    cnc: ModbusCnc, plc: FakePlc, shown: int, outcome: int, error: type[Exception], text: str
) -> None:
    begin = plc._begin

    def shown_wrong(motion: dict[str, Any]) -> None:
        begin(motion)
        plc.registers[1010:1012] = [shown, outcome]

    plc._begin = shown_wrong  # type: ignore[method-assign]
    with pytest.raises(error, match=text):
        cnc.move_to(np.array([150.0, 200.0, 300.0]), feed_mm_per_s=10.0, guarded=False)
    assert plc.commands == [12, 23]
    assert cnc.status().state is MotionState.IDLE


def test_a_motion_after_a_stop_waits_until_the_axes_rest(cnc: ModbusCnc, plc: FakePlc, clock: VirtualClock) -> None:
    plc.brakes_for_s = 0.12

    def stop_at_once(_now_s: float) -> None:
        raise Aborted("asked for")

    clock.subscribe(stop_at_once)
    with pytest.raises(Aborted):
        cnc.move_to(np.array([2000.0, 200.0, 300.0]), feed_mm_per_s=None, guarded=False)
    clock._listeners.remove(stop_at_once)
    assert plc.registers[1004] == 1
    cnc.move_to(np.array([110.0, 200.0, 300.0]), feed_mm_per_s=None, guarded=False)
    assert plc.commands == [11, 23, 11]
    assert clock.now() >= 0.12


def test_a_hold_from_within_the_wait_and_its_resume_do_not_disturb_it(plc: FakePlc, clock: VirtualClock) -> None:
    asked: list[str] = []
    driver: ModbusCnc

    def check() -> None:
        if clock.now() > 0.6 and not asked:
            asked.append("hold")
            driver.hold()
            clock.sleep(30.0)
            driver.resume()

    with opened(plc, InterruptibleClock(clock, check)) as driver:
        driver.move_to(np.array([250.0, 200.0, 300.0]), feed_mm_per_s=None, guarded=False)
        assert plc.commands == [11, 21, 22]
        assert driver.position().tolist() == [250.0, 200.0, 300.0]
    assert clock.now() == pytest.approx(31.5, abs=0.2)


def test_a_hold_at_the_panel_is_waited_for_and_then_named(plc: FakePlc, clock: VirtualClock) -> None:
    def hold_at(now_s: float) -> None:
        if now_s > 0.5 and plc.registers[1004] == 1:
            plc._halt(2, 1)

    clock.subscribe(hold_at)
    held_too_long = pytest.raises(MotionFault, match="held at the machine for more than 20 s")
    with opened(plc, clock, max_hold_s=20.0) as cnc, held_too_long:
        cnc.move_to(np.array([250.0, 200.0, 300.0]), feed_mm_per_s=None, guarded=False)
    assert plc.commands[-1] == 23


def test_a_motion_that_never_ends_meets_its_deadline(cnc: ModbusCnc, plc: FakePlc) -> None:
    plc._move = lambda: None  # type: ignore[method-assign]
    with pytest.raises(DeadlineExpired, match="the end of MOVE RAPID"):
        cnc.move_to(np.array([250.0, 200.0, 300.0]), feed_mm_per_s=None, guarded=False)
    assert plc.commands[-1] == 23


@pytest.mark.parametrize("off_mm", [0.5, -3.0, 0.06])
def test_in_position_is_not_believed_if_the_reported_position_is_off(
    cnc: ModbusCnc, plc: FakePlc, off_mm: float
) -> None:
    plc.ends_off_mm = (0.01, off_mm, 0.0)
    text = (
        f"MOVE RAPID ended off its target: Y target 200.0000 mm, reported {200.0 + off_mm:.4f} mm, "
        f"off by {off_mm:+.4f} mm, limit 0.05 mm (position_tolerance_mm)"
    )
    with pytest.raises(MotionFault, match=re.escape(text)) as caught:
        cnc.move_to(np.array([110.0, 200.0, 300.0]), feed_mm_per_s=None, guarded=False)
    assert caught.value.where["axis"] == "Y"
    assert "in-position window" in caught.value.hint


def test_a_touch_that_misses_short_of_its_target_is_not_believed(cnc: ModbusCnc, plc: FakePlc) -> None:
    end = plc._halt

    def short_of_the_target(state: int, outcome: int, fault: int = 0) -> None:
        plc.put_numbers(1012, 119.0, 200.0, 300.0)
        end(state, outcome, fault)

    plc._halt = short_of_the_target  # type: ignore[method-assign]
    with pytest.raises(MotionFault, match=r"TOUCH ended off its target: X target 120\.0000 mm, reported 119\.0000 mm"):
        cnc.touch_towards(np.array([120.0, 200.0, 300.0]), feed_mm_per_s=5.0)


def test_a_deviation_within_the_limit_is_accepted_and_the_limit_can_be_set(plc: FakePlc, clock: VirtualClock) -> None:
    plc.ends_off_mm = (0.0, 0.04, 0.0)
    with opened(plc, clock) as cnc:
        cnc.move_to(np.array([110.0, 200.0, 300.0]), feed_mm_per_s=None, guarded=False)
    with opened(plc, clock, position_tolerance_mm=0.03) as cnc, pytest.raises(MotionFault, match=r"limit 0\.03 mm"):
        cnc.move_to(np.array([120.0, 200.0, 300.0]), feed_mm_per_s=None, guarded=False)


def test_a_move_at_five_percent_override_takes_its_time(cnc: ModbusCnc, plc: FakePlc, clock: VirtualClock) -> None:
    plc.override = 0.05
    cnc.move_to(np.array([250.0, 200.0, 300.0]), feed_mm_per_s=20.0, guarded=True)
    assert clock.now() == pytest.approx(150.0, abs=0.2)
    plc.trip_at_mm = 5.0
    assert isinstance(cnc.touch_towards(np.array([260.0, 200.0, 300.0]), feed_mm_per_s=0.5), Touch)
    assert clock.now() == pytest.approx(350.0, abs=0.5)


def test_axes_that_stand_still_point_to_the_override(cnc: ModbusCnc, plc: FakePlc, clock: VirtualClock) -> None:
    plc.override = 0.0
    text = r"axes have stood still for .* near X 100\.000 Y 200\.000 Z 300\.000, 150\.000 mm before .*feed override"
    with pytest.raises(DeadlineExpired, match=text):
        cnc.move_to(np.array([250.0, 200.0, 300.0]), feed_mm_per_s=None, guarded=False)
    assert clock.now() == pytest.approx(1.5 * 1.5 + 5.0, abs=0.5)
    assert plc.commands[-1] == 23


def test_a_late_acknowledgement_is_waited_for(cnc: ModbusCnc, plc: FakePlc) -> None:
    plc.acknowledge_after_s = 0.3
    cnc.move_to(np.array([110.0, 200.0, 300.0]), feed_mm_per_s=None, guarded=False)
    assert plc.commands == [11]


def test_a_command_that_is_never_acknowledged_times_out_and_is_stopped(cnc: ModbusCnc, plc: FakePlc) -> None:
    plc.handles_commands = False
    with pytest.raises(LinkTimeout, match=r"MOVE RAPID \(command 1\) not acknowledged within 1 s"):
        cnc.move_to(np.array([110.0, 200.0, 300.0]), feed_mm_per_s=None, guarded=False)
    assert plc.registers[2001] == 23


def test_a_foreign_sequence_number_is_an_error(cnc: ModbusCnc, plc: FakePlc) -> None:
    plc.registers[1008] = 4711
    with pytest.raises(ProtocolError, match="sequence number 4711"):
        cnc.status()


def test_sequence_numbers_continue_and_skip_zero(plc: FakePlc, clock: VirtualClock) -> None:
    plc.registers[1008] = 65534
    with opened(plc, clock) as cnc:
        seen = []
        for _ in range(3):
            cnc.stop()
            seen.append(plc.registers[1008])
    assert seen == [65535, 1, 2]


def test_a_lost_answer_to_a_motion_is_resolved_by_reading(cnc: ModbusCnc, plc: FakePlc) -> None:
    lost: list[bytes] = []

    def lose_the_first_command(request: bytes, answer: bytes) -> bytes | None:
        if request[7] == 23 and request[16] == 46 and not lost:
            lost.append(request)
            return None
        return answer

    plc.disturb = lose_the_first_command
    cnc.move_to(np.array([110.0, 200.0, 300.0]), feed_mm_per_s=None, guarded=False)
    written = [request for request in plc.requests if request[7] == 23 and request[16] == 46]
    assert len(lost) == 1
    assert len(written) == 1
    assert plc.commands == [11]


def test_a_late_answer_to_an_earlier_request_is_discarded(cnc: ModbusCnc, plc: FakePlc) -> None:
    kept: list[bytes] = []

    def one_behind(_request: bytes, answer: bytes) -> bytes | None:
        if not kept:
            kept.append(answer)
            return None
        return kept.pop() + answer if len(kept) == 1 else answer

    plc.disturb = one_behind
    assert cnc.position().tolist() == list(START)


def test_without_function_23_it_uses_16_and_3(plc: FakePlc, clock: VirtualClock) -> None:
    plc.offers_23 = False
    with opened(plc, clock) as cnc:
        cnc.move_to(np.array([110.0, 200.0, 300.0]), feed_mm_per_s=None, guarded=False)
    assert [request[7] for request in plc.requests].count(23) == 1
    assert plc.commands == [11]


def test_a_frozen_controller_is_a_lost_link(cnc: ModbusCnc, plc: FakePlc) -> None:
    plc.heartbeat_runs = False
    with pytest.raises(LinkLost, match="heartbeat has been stuck"):
        cnc.move_to(np.array([3100.0, 200.0, 300.0]), feed_mm_per_s=None, guarded=False)


def test_a_half_written_image_is_read_again(cnc: ModbusCnc, plc: FakePlc) -> None:
    torn = 2

    def tear(_request: bytes, answer: bytes) -> bytes:
        nonlocal torn
        torn -= 1
        return answer[:-2] + b"\xee\xee" if torn >= 0 else answer

    plc.disturb = tear
    assert cnc.position().tolist() == list(START)


def test_an_image_that_stays_half_written_is_an_error(cnc: ModbusCnc, plc: FakePlc) -> None:
    plc.disturb = lambda _request, answer: answer[:-2] + b"\xee\xee"
    with pytest.raises(ProtocolError, match="half-written"):
        cnc.position()


@pytest.mark.parametrize(
    ("address", "words", "text"),
    [
        (1004, (9,), r"illegal state code: 9 .*register 1004"),
        (1011, (77,), r"illegal motion outcome: 77 .*register 1011"),
        (1012, (0x7FF8, 0, 0, 0), r"illegal position.*nan.*register 1012"),
        (1026, (0x7FF0, 0, 0, 0), r"illegal latched.*inf.*register 1026"),
        (1000, (1,), "no volcal register map"),
        (1001, (0x0200,), r"version 0x0200"),
    ],
)
def test_illegal_values_name_their_register(
    cnc: ModbusCnc, plc: FakePlc, address: int, words: tuple[int, ...], text: str
) -> None:
    for index, word in enumerate(words):
        plc.registers[address + index] = word
    with pytest.raises(ProtocolError, match=text):
        cnc.position()


def test_an_exception_response_names_link_and_register(plc: FakePlc, clock: VirtualClock) -> None:
    named = r"exception 2, illegal register address .*register 3000, device cnc"
    with opened(plc, clock, blocks={"command": 3000}) as cnc, pytest.raises(ProtocolError, match=named):
        cnc.move_to(np.array([110.0, 200.0, 300.0]), feed_mm_per_s=None, guarded=False)


def test_a_killed_controller_is_a_lost_link_at_once(cnc: ModbusCnc, plc: FakePlc, clock: VirtualClock) -> None:
    clock.subscribe(lambda now_s: plc.hang_up() if now_s > 0.7 else None)
    with pytest.raises(LinkLost, match=r"connection lost.*link modbus-tcp 127\.0\.0\.1"):
        cnc.move_to(np.array([250.0, 200.0, 300.0]), feed_mm_per_s=None, guarded=False)
    with pytest.raises(LinkLost, match="cannot connect"):
        cnc.stop()


def test_a_silent_controller_is_a_timeout(cnc: ModbusCnc, plc: FakePlc) -> None:
    plc.disturb = lambda _request, _answer: None
    with pytest.raises(LinkTimeout, match=r"no answer within 0\.5 s"):
        cnc.position()


def test_a_fault_of_the_lost_heartbeat_is_cleared_when_the_agent_is_back(plc: FakePlc, clock: VirtualClock) -> None:
    plc.registers[1004], plc.registers[1005] = 3, 6
    with opened(plc, clock) as cnc:
        assert cnc.status().state is MotionState.IDLE
    assert plc.commands == [24]


def test_a_look_at_a_faulted_controller_writes_nothing_and_refuses_every_write(
    plc: FakePlc, clock: VirtualClock
) -> None:
    plc.registers[1004], plc.registers[1005] = 3, 6
    cnc = ModbusCnc(ModbusCncSettings(host="127.0.0.1", port=plc.port), clock, "cnc")
    assert isinstance(cnc, LookOnlyDevice)
    cnc.open_to_look()
    with closing(cnc):
        assert cnc.status().state is MotionState.FAULT
        assert (cnc.active_bank(), cnc.pending_bank()) == (0, None)
        image = TableImage((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), 1e-4, np.zeros((2, 2, 2, 3), dtype=np.int32))
        target_mm = np.array([110.0, 200.0, 300.0])
        for write in (
            cnc.reset,
            cnc.hold,
            cnc.resume,
            lambda: cnc.move_to(target_mm, feed_mm_per_s=None, guarded=False),
            lambda: cnc.touch_towards(target_mm, feed_mm_per_s=1.0),
            lambda: cnc.stage(1, image),
            lambda: cnc.activate(0),
        ):
            with pytest.raises((CommandRejected, StoreError), match="opened only to read"):
                write()
        cnc.stop()
    assert {request[7] for request in plc.requests} == {3}
    cnc.open()
    with closing(cnc):
        assert cnc.status().state is MotionState.IDLE
    assert plc.commands == [24]


@pytest.mark.parametrize(
    ("address", "fmt", "value"),
    [(1100, "d", np.nan), (1112, "d", -1.0), (1124, "d", 0.0), (1154, "d", 0.0), (1162, "H", 9)],
)
def test_implausible_limits_are_refused(
    plc: FakePlc, clock: VirtualClock, address: int, fmt: str, value: float
) -> None:
    plc.put(address, fmt, value)
    with pytest.raises(ProtocolError, match="the controller reports implausible limits"), opened(plc, clock):
        pass


def test_a_closed_device_raises_and_stop_is_still_safe(cnc: ModbusCnc) -> None:
    cnc.close()
    cnc.stop()
    with pytest.raises(LinkLost, match="not open"):
        cnc.position()
    with pytest.raises(LinkLost, match="not open"):
        cnc.limits()


def test_doctor_reads_and_writes_nothing(plc: FakePlc, clock: VirtualClock) -> None:
    settings = ModbusCncSettings(host="127.0.0.1", port=plc.port)
    findings = ModbusCnc(settings, clock, "cnc").diagnose()
    assert all(finding.ok for finding in findings)
    assert {"link", "heartbeat", "latency", "permissions", "probe", "travel", "tables"} <= {
        finding.subject for finding in findings
    }
    assert {request[7] for request in plc.requests} == {3}


def test_doctor_reports_what_is_wrong(plc: FakePlc, clock: VirtualClock) -> None:
    plc.registers[1006], plc.registers[1007] = 0x7E, 1
    plc.heartbeat_runs = False
    settings = ModbusCncSettings(host="127.0.0.1", port=plc.port)
    wrong = {
        finding.subject: finding.text for finding in ModbusCnc(settings, clock, "cnc").diagnose() if not finding.ok
    }
    assert wrong == {
        "heartbeat": "stuck at 0",
        "permissions": "missing: controller in automatic mode",
        "probe": "loaded, not healthy",
    }
    plc.close()
    (lost,) = ModbusCnc(settings, clock, "cnc").diagnose()
    assert not lost.ok
    assert "cannot connect" in lost.text
