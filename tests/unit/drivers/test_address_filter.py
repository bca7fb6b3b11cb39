"""The service of systemd reaches only the addresses that its drop-in permits; an unreachable one names the drop-in."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from agent.execution.device_assembly import make_clock
from agent.settings.schema import ClockSettings
from drivers.address_filter import filter_hint
from drivers.errors import VolcalError
from drivers.links.can_adapters import CanAddress, open_bus
from drivers.links.modbus_tcp import TcpEndpoint, TcpTransport

HERE = "0.0.0.0"  # noqa: S104  no loopback address, and refused at once
PORT = 1


def open_modbus() -> None:
    TcpTransport(TcpEndpoint(HERE, PORT, 1), timeout_s=10.0, where={}).open()


def open_can() -> None:
    open_bus(CanAddress.of("socketcand", "can0", {"host": HERE, "port": PORT}))


def open_clock() -> None:
    make_clock(ClockSettings(kind="lockstep", host=HERE, port=PORT))


@pytest.mark.parametrize("opened", [open_modbus, open_can, open_clock])
def test_an_address_that_the_service_cannot_reach_names_the_filter(
    opened: Callable[[], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("NOTIFY_SOCKET", raising=False)
    with pytest.raises(VolcalError) as by_hand:
        opened()
    assert "IPAddressAllow" not in by_hand.value.hint
    monkeypatch.setenv("NOTIFY_SOCKET", "/run/systemd/notify")
    with pytest.raises(VolcalError) as as_service:
        opened()
    assert f"IPAddressAllow={HERE}" in as_service.value.hint
    assert "machine.conf" in as_service.value.hint
    assert as_service.value.hint.endswith(by_hand.value.hint)


@pytest.mark.parametrize("host", ["localhost", "127.0.0.1", "127.1.2.3", "::1"])
def test_this_computer_is_always_permitted(host: str) -> None:
    assert filter_hint("start it", host, {"NOTIFY_SOCKET": "x"}) == "start it"


@pytest.mark.parametrize("host", ["192.0.2.10", "cnc.example", "2001:db8::1"])
def test_every_other_host_is_named(host: str) -> None:
    assert f"IPAddressAllow={host} " in filter_hint("start it", host, {"NOTIFY_SOCKET": "x"})
