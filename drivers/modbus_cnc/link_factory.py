"""Creation of the configured link to a Modbus controller: Modbus TCP or a serial line."""

from __future__ import annotations

from drivers.clock import Clock
from drivers.links.modbus import ModbusLink
from drivers.links.modbus_rtu import RtuEndpoint, RtuTransport
from drivers.links.modbus_serial_line import SerialLine
from drivers.links.modbus_tcp import TcpEndpoint, TcpTransport
from drivers.links.modbus_transport import Transport
from drivers.links.reconnection import Reconnection
from drivers.modbus_cnc.settings import ModbusCncSettings


def create_link(settings: ModbusCncSettings, clock: Clock, device: str) -> ModbusLink:
    transport, where = _transport(settings, settings.serial, clock, device)
    return ModbusLink(
        transport,
        writable=settings.blocks.writable(),
        where=where,
        retries=settings.retries,
        combined=settings.combined_function,
        reconnection=Reconnection(
            clock, max_attempts=settings.reconnect_attempts, max_s=settings.reconnect_timeout_s, where=where
        ),
    )


def _transport(
    settings: ModbusCncSettings, line: SerialLine | None, clock: Clock, device: str
) -> tuple[Transport, dict[str, str]]:
    if line is None:
        tcp = TcpEndpoint(settings.host or "", settings.port, settings.unit)
        where = {"device": device, "link": str(tcp)}
        return TcpTransport(tcp, timeout_s=settings.timeout_s, where=where), where
    serial = RtuEndpoint(line, settings.unit)
    where = {"device": device, "link": str(serial)}
    return RtuTransport(serial, clock, timeout_s=settings.timeout_s, where=where), where
