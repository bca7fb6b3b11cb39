"""Endpoint of the service for panels. It is open from the start of the service until its end."""

from __future__ import annotations

import ipaddress
import threading
from pathlib import Path
from typing import Final

import structlog

from agent.service.control import Control
from agent.service.gateway.access import AccessCode, access_code_path, read_access_code
from agent.service.gateway.command_handler import CommandHandler
from agent.service.gateway.gateway import Gateway
from agent.service.gateway.heartbeat import Heartbeats
from agent.service.gateway.sequence_ledger import SequenceLedger
from agent.service.gateway.server import JOIN_S, ModbusServer
from agent.service.gateway.session import PanelSession
from agent.settings.panel_gateway import GatewaySettings

TICK_S: Final = 1.0
log = structlog.get_logger()


class GatewayEndpoint:
    """Endpoint for panels and PLCs over Modbus TCP."""

    def __init__(self, settings: GatewaySettings, state_directory: Path) -> None:
        self._settings = settings
        self._state_directory = state_directory
        self._stopped = threading.Event()
        self._server: ModbusServer | None = None
        self._ticker: threading.Thread | None = None

    @property
    def name(self) -> str:
        return "panel gateway"

    @property
    def alive(self) -> bool:
        """True as long as panels can connect and their heartbeats are watched."""
        server, ticker = self._server, self._ticker
        return server is not None and server.alive and ticker is not None and ticker.is_alive()

    @property
    def address(self) -> tuple[str, int]:
        """Host and port on which the server listens; available only while the endpoint is open."""
        if self._server is None:
            raise RuntimeError("the gateway is not open")
        return self._server.address

    def start(self, control: Control) -> None:
        """Open the endpoint. Raise ConfigurationError if the address, the access code file or the recorded sequence
        number is invalid."""
        gateway = self._gateway(control)
        settings = self._settings
        self._server = ModbusServer(
            (settings.host, settings.port),
            [ipaddress.ip_network(client) for client in settings.clients],
            lambda: PanelSession(gateway),
            max_clients=settings.max_clients,
            idle_timeout_s=settings.idle_timeout_s,
        )
        self._stopped.clear()
        self._ticker = threading.Thread(target=self._tick_forever, args=(gateway,), name="gateway tick", daemon=True)
        self._ticker.start()
        self._server.start()
        log.info("panel gateway open", address="{}:{}".format(*self.address), commands=gateway.access.is_set)

    def stop(self) -> None:
        """Close the endpoint. Do nothing if it is already closed."""
        self._stopped.set()
        if self._server is not None:
            self._server.stop()
            self._server = None
        if self._ticker is not None:
            self._ticker.join(JOIN_S)
            self._ticker = None

    def _gateway(self, control: Control) -> Gateway:
        code_file = access_code_path(self._settings)
        access = AccessCode(None if code_file is None else read_access_code(code_file))
        handler = CommandHandler(control, SequenceLedger(self._state_directory), access)
        return Gateway(
            control, handler, access, Heartbeats(self._settings.panel_timeout_s), self._settings.on_panel_timeout
        )

    def _tick_forever(self, gateway: Gateway) -> None:
        while not self._stopped.wait(TICK_S):
            gateway.tick()
