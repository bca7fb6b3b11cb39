"""Creation of the configured link to a Modbus controller: Modbus TCP or a serial line."""

from __future__ import annotations

from drivers.clock import Clock
from drivers.links.modbus import ModbusLink
from drivers.links.modbus_rtu import RtuEndpoint, RtuTransport
from drivers.links.modbus_serial_line import SerialLine
from drivers.links.modbus_tcp import TcpEndpoint, TcpTransport
from drivers.links.modbus_transport import Transport
from drivers.modbus_cnc.settings import ModbusCncSettings


def create_link(settings: ModbusCncSettings, clock: Clock, device: str) -> ModbusLink:
    if settings.serial is not None:
        return _serial_link(settings, settings.serial, clock, device)
    endpoint = TcpEndpoint(settings.host or "", settings.port, settings.unit)
    where = {"device": device, "link": str(endpoint)}
    return _link(TcpTransport(endpoint, timeout_s=settings.timeout_s, where=where), settings, where)


def _serial_link(settings: ModbusCncSettings, line: SerialLine, clock: Clock, device: str) -> ModbusLink:
    endpoint = RtuEndpoint(line, settings.unit)
    where = {"device": device, "link": str(endpoint)}
    return _link(RtuTransport(endpoint, clock, timeout_s=settings.timeout_s, where=where), settings, where)


def _link(transport: Transport, settings: ModbusCncSettings, where: dict[str, str]) -> ModbusLink:
    return ModbusLink(
        transport,
        writable=settings.blocks.writable(),
        where=where,
        retries=settings.retries,
        combined=settings.combined_function,
    )
