"""Contract tests of every role, with the simulator in this process and with the drivers on their links.

The contract itself is in `drivers.contract`; here it runs on all devices of this project, with additional tests for
this machine.
"""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from rigs import SimulatedRig, in_process, on_wires, over_rtu, over_serial

from drivers.contract.motion_contract import AxisHomingContract, MachineContract, ProbeContract, RotaryMountContract
from drivers.contract.rig import StoppedError
from drivers.contract.store_contract import CompensationStoreContract, ThermometerContract
from drivers.modbus_cnc.device import ModbusCnc
from drivers.roles import AxisHoming, Operator, OperatorRequest, OperatorTask


@pytest.fixture(
    params=[in_process, on_wires, over_rtu, over_serial], ids=["in-process", "on-wires", "over-rtu", "over-serial"]
)
def rig(request: pytest.FixtureRequest) -> Iterator[SimulatedRig]:
    with request.param() as machine:
        yield machine


class TestMachine(MachineContract):
    def test_limits_are_those_of_the_machine(self, rig: SimulatedRig) -> None:
        limits = rig.machine.limits()
        assert (limits.lower_mm, limits.upper_mm) == ((0.0, 0.0, 0.0), (4000.0, 1300.0, 1500.0))
        assert limits.rapid_mm_per_s == pytest.approx((20000.0 / 60.0,) * 3)


class TestAxisHoming(AxisHomingContract):
    def test_only_modbus_has_no_command_for_it(self, rig: SimulatedRig) -> None:
        assert isinstance(rig.machine, AxisHoming)
        assert bool(rig.machine.why_no_homing()) == isinstance(rig.machine, ModbusCnc)


class TestProbe(ProbeContract):
    def test_the_axes_go_on_after_the_trip(self, rig: SimulatedRig) -> None:
        target = rig.approach()
        rig.probe.touch_towards(target, feed_mm_per_s=5.0)
        assert rig.machine.position()[1] > rig.trip_mm(target)[1] + 1e-3


class TestRotaryMount(RotaryMountContract):
    def test_it_stays_where_it_was_stopped(self, rig: SimulatedRig) -> None:
        rig.go(rig.clear_of_mount_mm)
        rig.interrupt.after(1.5)
        with pytest.raises(StoppedError):
            rig.mount.orient_to(90.0, 0.0)
        rig.clock.sleep(3.0)
        assert 5.0 < rig.mount.orientation().azimuth_deg < 60.0


class TestCompensationStore(CompensationStoreContract):
    def test_a_count_is_a_tenth_of_a_micrometre(self, rig: SimulatedRig) -> None:
        assert rig.store.store_limits().resolution_mm == pytest.approx(1e-4)


class TestThermometer(ThermometerContract):
    def test_the_artefact_is_at_20_degrees(self, rig: SimulatedRig) -> None:
        assert rig.thermometer.temperatures_c()["artefact"] == pytest.approx(20.0, abs=0.01)


def test_operator_carries_the_artefact(rig: SimulatedRig) -> None:
    assert isinstance(rig.operator, Operator)
    assert rig.operator.ask(OperatorRequest(OperatorTask.MOVE_ARTEFACT, "to 3", 3))
    assert rig.world.workpiece.station == 3
    assert rig.operator.ask(OperatorRequest(OperatorTask.CONSENT, "write?"))
