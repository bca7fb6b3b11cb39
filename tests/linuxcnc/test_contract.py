"""Contract tests of every role with a running stock LinuxCNC."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from contract_rig import LinuxCncRig
from live import Live
from requirements import requires_linuxcnc

from drivers.contract.motion_contract import MachineContract, ProbeContract
from drivers.contract.store_contract import CompensationStoreContract, ThermometerContract

pytestmark = [
    requires_linuxcnc,
]


@pytest.fixture
def rig(live: Live) -> Iterator[LinuxCncRig]:
    made = LinuxCncRig(live)
    made.device.open()
    try:
        yield made
        made.leave()
    finally:
        made.device.close()


class TestMachine(MachineContract):
    pass


class TestProbe(ProbeContract):
    pass


class TestCompensationStore(CompensationStoreContract):
    pass


class TestThermometer(ThermometerContract):
    pass
