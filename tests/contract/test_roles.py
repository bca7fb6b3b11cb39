"""What every player of a role must do, whoever it is: the plugin in this process, and the drivers on their links."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import pytest
from rigs import REACH, Played, StoppedError, in_process, on_wires, over_rtu, over_serial

from drivers.errors import CommandRejected, DeviceError, GuardTripped, StoreError
from drivers.roles import (
    CompensationStore,
    Machine,
    Miss,
    MotionState,
    Operator,
    OperatorRequest,
    OperatorTask,
    Probe,
    RotaryMount,
    TableImage,
    Thermometer,
    Touch,
)


@pytest.fixture(
    params=[in_process, on_wires, over_rtu, over_serial], ids=["in-process", "on-wires", "over-rtu", "over-serial"]
)
def played(request: pytest.FixtureRequest) -> Iterator[Played]:
    with request.param() as rig:
        yield rig


def table(value: int = 1) -> TableImage:
    counts = np.arange(3 * 2 * 4 * 3, dtype=np.int32).reshape(3, 2, 4, 3) * value - 30
    return TableImage((0.0, 0.0, 0.0), (2000.0, 1300.0, 500.0), 1e-4, counts)


def test_every_role_is_played(played: Played) -> None:
    assert isinstance(played.machine, Machine)
    assert isinstance(played.probe, Probe)
    assert isinstance(played.mount, RotaryMount)
    assert isinstance(played.store, CompensationStore)
    assert isinstance(played.thermometer, Thermometer)
    assert isinstance(played.operator, Operator)


class TestMachine:
    def test_move_reaches_its_target(self, played: Played) -> None:
        target = np.array([123.456, 0.0, 78.9])
        played.machine.move_to(target, feed_mm_per_s=50.0, guarded=False)
        assert played.machine.position() == pytest.approx(target, abs=1e-9)
        assert played.machine.status().state is MotionState.IDLE

    def test_limits_are_those_of_the_machine(self, played: Played) -> None:
        limits = played.machine.limits()
        assert (limits.lower_mm, limits.upper_mm) == ((0.0, 0.0, 0.0), (4000.0, 1300.0, 1500.0))
        assert limits.rapid_mm_per_s == pytest.approx((20000.0 / 60.0,) * 3)

    @pytest.mark.parametrize("target", [(4000.1, 0.0, 0.0), (0.0, -0.1, 0.0), (0.0, 0.0, 1e9), (math.nan, 0.0, 0.0)])
    def test_target_that_cannot_be_is_rejected_and_nothing_moves(self, played: Played, target) -> None:
        before = played.machine.position()
        with pytest.raises(CommandRejected):
            played.machine.move_to(np.array(target), feed_mm_per_s=None, guarded=False)
        assert np.array_equal(played.machine.position(), before)
        played.machine.move_to(np.array([10.0, 0.0, 0.0]), feed_mm_per_s=None, guarded=False)

    @pytest.mark.parametrize("feed", [0.0, -5.0, math.inf, math.nan])
    def test_feed_that_is_none_is_rejected(self, played: Played, feed: float) -> None:
        with pytest.raises(CommandRejected):
            played.machine.move_to(np.array([10.0, 0.0, 0.0]), feed_mm_per_s=feed, guarded=False)

    def test_guarded_move_into_a_ball_is_a_tripped_guard(self, played: Played) -> None:
        centre = played.before(5)
        with pytest.raises(GuardTripped):
            played.machine.move_to(centre, feed_mm_per_s=10.0, guarded=True)
        assert played.machine.status().state is not MotionState.MOVING
        assert centre[1] - REACH < played.machine.position()[1] < centre[1] - REACH + 6.0

    def test_wait_that_is_broken_off_stops_the_motion(self, played: Played) -> None:
        played.interrupt.after(2.0)
        with pytest.raises(StoppedError):
            played.machine.move_to(np.array([4000.0, 0.0, 0.0]), feed_mm_per_s=50.0, guarded=False)
        played.come_to_rest()
        stopped = played.machine.position()
        assert 50.0 < stopped[0] < 200.0
        played.clock.sleep(5.0)
        assert np.array_equal(played.machine.position(), stopped)
        played.machine.move_to(np.array([0.0, 0.0, 0.0]), feed_mm_per_s=None, guarded=False)

    def test_stop_at_rest_does_no_harm(self, played: Played) -> None:
        played.machine.stop()
        played.machine.stop()
        played.machine.move_to(np.array([5.0, 0.0, 0.0]), feed_mm_per_s=None, guarded=False)
        assert played.machine.position()[0] == pytest.approx(5.0)


class TestProbe:
    def test_touch_is_where_the_probe_tripped_not_where_it_stopped(self, played: Played) -> None:
        centre = played.before(5)
        touch = played.probe.touch_towards(centre, feed_mm_per_s=5.0)
        assert isinstance(touch, Touch)
        assert touch.position_mm == pytest.approx(tuple(centre - [0.0, REACH, 0.0]), abs=played.resolution_mm)
        assert played.machine.position()[1] > touch.position_mm[1] + 1e-3
        assert played.probe.probe_status().deflected

    def test_miss_is_a_result(self, played: Played) -> None:
        centre = played.before(5)
        target = centre - [0.0, 20.0, 0.0]
        miss = played.probe.touch_towards(target, feed_mm_per_s=5.0)
        assert isinstance(miss, Miss)
        assert miss.position_mm == pytest.approx(tuple(target), abs=played.resolution_mm)
        assert not played.probe.probe_status().deflected

    def test_second_touch_has_its_own_latch(self, played: Played) -> None:
        centre = played.before(5)
        first = played.probe.touch_towards(centre, feed_mm_per_s=5.0)
        played.machine.move_to(centre - [0.0, 25.0, 0.0], feed_mm_per_s=None, guarded=True)
        miss = played.probe.touch_towards(centre - [0.0, 20.0, 0.0], feed_mm_per_s=5.0)
        assert isinstance(first, Touch)
        assert isinstance(miss, Miss)

    def test_deflected_probe_does_not_touch(self, played: Played) -> None:
        centre = played.before(5)
        played.probe.touch_towards(centre, feed_mm_per_s=5.0)
        with pytest.raises(DeviceError, match="deflected"):
            played.probe.touch_towards(centre, feed_mm_per_s=5.0)

    def test_loaded_healthy_and_free(self, played: Played) -> None:
        status = played.probe.probe_status()
        assert (status.loaded, status.healthy, status.deflected) == (True, True, False)


class TestRotaryMount:
    def test_turn_reaches_its_target(self, played: Played) -> None:
        played.machine.move_to(np.array([2900.0, 0.0, 750.0]), feed_mm_per_s=None, guarded=False)
        reached = played.mount.orient_to(45.0, -30.0)
        assert (reached.azimuth_deg, reached.elevation_deg) == pytest.approx((45.0, -30.0), abs=1e-3)
        assert played.mount.orientation() == reached

    def test_wait_that_is_broken_off_stops_the_turn(self, played: Played) -> None:
        played.machine.move_to(np.array([2900.0, 0.0, 750.0]), feed_mm_per_s=None, guarded=False)
        played.interrupt.after(1.5)
        with pytest.raises(StoppedError):
            played.mount.orient_to(90.0, 0.0)
        played.clock.sleep(3.0)
        stopped = played.mount.orientation()
        assert 5.0 < stopped.azimuth_deg < 60.0
        played.clock.sleep(5.0)
        assert played.mount.orientation() == stopped


class TestCompensationStore:
    def test_staged_table_reads_back_and_does_not_act(self, played: Played) -> None:
        assert played.store.active_bank() == 0
        assert played.store.read_table(1) is None
        played.store.stage(1, table())
        read = played.store.read_table(1)
        assert read is not None
        assert read.same_as(table())
        assert played.store.active_bank() == 0

    def test_activation_reads_back_and_goes_back(self, played: Played) -> None:
        played.store.stage(2, table())
        played.store.activate(2)
        assert played.store.active_bank() == 2
        played.store.activate(0)
        assert played.store.active_bank() == 0

    def test_active_bank_is_not_written(self, played: Played) -> None:
        played.store.stage(1, table())
        played.store.activate(1)
        with pytest.raises(StoreError):
            played.store.stage(1, table(2))
        read = played.store.read_table(1)
        assert read is not None
        assert read.same_as(table())

    def test_empty_or_missing_bank_does_not_act(self, played: Played) -> None:
        for bank in (2, 9):
            with pytest.raises(StoreError):
                played.store.activate(bank)
        assert played.store.active_bank() == 0

    @pytest.mark.parametrize("bank", [0, 9])
    def test_bank_that_is_none_is_not_written(self, played: Played, bank: int) -> None:
        with pytest.raises(StoreError):
            played.store.stage(bank, table())

    def test_table_beyond_the_limits_is_refused_and_the_bank_keeps_its_own(self, played: Played) -> None:
        played.store.stage(1, table())
        limits = played.store.store_limits()
        counts = np.full((2, 2, 2, 3), round(1.5 * limits.max_correction_mm / limits.resolution_mm), dtype=np.int32)
        with pytest.raises(StoreError):
            played.store.stage(1, TableImage((0.0, 0.0, 0.0), (4000.0, 1300.0, 1500.0), limits.resolution_mm, counts))
        read = played.store.read_table(1)
        assert read is None or read.same_as(table())

    def test_limits_name_two_banks(self, played: Played) -> None:
        limits = played.store.store_limits()
        assert set(limits.banks) >= {1, 2}
        assert limits.resolution_mm == pytest.approx(1e-4)


def test_temperatures_have_their_names(played: Played) -> None:
    temperatures = played.thermometer.temperatures_c()
    assert temperatures["artefact"] == pytest.approx(20.0, abs=0.01)


def test_operator_carries_the_artefact(played: Played) -> None:
    assert played.operator.ask(OperatorRequest(OperatorTask.MOVE_ARTEFACT, "to 3", 3))
    assert played.world.workpiece.station == 3
    assert played.operator.ask(OperatorRequest(OperatorTask.CONSENT, "write?"))
