"""OPC UA server. It is started, updated from the status and the events of the service, and stopped."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from queue import Empty, Queue
from typing import Final

import structlog
from asyncua import ua
from asyncua.server.server import Server

from agent.service.control import Alarm, Control, Event
from agent.service.opcua.address_space import AddressSpace
from agent.service.opcua.certificates import own_certificate
from agent.service.opcua.guard import ClientAuthentication, GuardedServer, make_room
from agent.service.opcua.machine_space import MachineSpace
from agent.settings.opcua import OpcUaSettings
from drivers.errors import ConfigurationError
from drivers.foreign_errors import cause_of

REFRESH_S: Final = 0.5
"""Longest delay in s until the nodes show a change of the status that no event has reported."""
log = structlog.get_logger()


@dataclass(frozen=True)
class ServerFiles:
    """Directories and access token of the server.

    `directory` contains the server's certificate. `trusted_clients` contains the trusted clients' certificates. `token`
    is the access token. `state_directory` contains the journal.
    """

    state_directory: Path
    directory: Path
    trusted_clients: Path
    token: str


class OpcUaServer:
    """OPC UA server for a `Control`, the interface to the owner of the machine. The server shows the status that the
    control reports and offers the methods of the control to clients."""

    def __init__(self, settings: OpcUaSettings, files: ServerFiles, control: Control) -> None:
        self._settings = settings
        self._files = files
        self._control = control

    async def serve(self, stop: asyncio.Event, opened: Callable[[], None]) -> None:
        """Serve clients until `stop` is set, and call `opened` once the server listens. Raise ConfigurationError if the
        server cannot be opened."""
        server, space = await self._open(stop)
        try:
            opened()
            with self._control.subscribe() as events:
                await self._feed(server, space, events, stop)
        finally:
            await server.stop()

    async def _open(self, stop: asyncio.Event) -> tuple[Server, AddressSpace]:
        users = ClientAuthentication(
            self._files.token, self._files.trusted_clients, anonymous_reading=self._settings.anonymous_reading
        )
        guarded = GuardedServer(users)
        server = Server(iserver=guarded)
        await server.init()
        await self._secure(server)
        machine = MachineSpace(server, self._settings, self._files.state_directory, stop)
        space = AddressSpace(server, guarded, self._control, machine)
        await space.build()
        await space.read_result()
        await space.show(self._control.status())
        try:
            await server.start()
        except OSError as error:
            raise ConfigurationError(
                f"cannot listen for OPC UA on {self._settings.host}:{self._settings.port}: {cause_of(error)}",
                hint="choose a free port and an address of this computer",
                key="opcua.host, opcua.port",
            ) from error
        return server, space

    async def _secure(self, server: Server) -> None:
        """Configure the only endpoint of the server, which is signed and encrypted. Over an unsecured channel a client
        can only list this endpoint.
        """
        host = socket.gethostname()
        uri = f"urn:{host}:volcal"
        own = own_certificate(self._files.directory, uri, host, self._settings.host)
        server.set_server_name("volcal")
        server.product_uri, server.manufacturer_name = "urn:volcal", "volcal"
        server.application_type = ua.ApplicationType.Server
        await server.set_application_uri(uri)
        await server.load_certificate(own.certificate)
        await server.load_private_key(own.key)
        shown_host = f"[{self._settings.host}]" if ":" in self._settings.host else self._settings.host
        server.set_endpoint(f"opc.tcp://{shown_host}:{self._settings.port}/volcal")
        server.set_security_policy([ua.SecurityPolicyType.Basic256Sha256_SignAndEncrypt])
        tokens: list[type] = [ua.UserNameIdentityToken]
        server.set_identity_tokens([*tokens, ua.AnonymousIdentityToken] if self._settings.anonymous_reading else tokens)

    async def _feed(self, server: Server, space: AddressSpace, events: Queue[Event], stop: asyncio.Event) -> None:
        known: tuple[str, tuple[Alarm, ...]] = ("", ())
        while not stop.is_set():
            for event in await asyncio.to_thread(_waiting_events, events):
                if event.kind == "outcome":
                    await space.show_outcome(event)
                    await space.read_result()
            known = await self._refresh(space, known)
            if server.bserver is not None:
                make_room(server.bserver.clients)

    async def _refresh(
        self, space: AddressSpace, known: tuple[str, tuple[Alarm, ...]]
    ) -> tuple[str, tuple[Alarm, ...]]:
        """Update the nodes, then send events about changes. A client that receives an event can therefore read the new
        values.

        `known` contains the state and the alarms at the last update. Return the current ones.
        """
        try:
            status = self._control.status()
        except Exception:
            log.exception("status not available")
            return known
        await space.show(status)
        now = status.state.value, status.alarms
        if now[0] != known[0]:
            await space.send_state_event(status)
        before, after = ({alarm.code: alarm for alarm in alarms} for alarms in (known[1], now[1]))
        for alarm in (alarm for code, alarm in before.items() if code not in after):
            await space.send_alarm_removed(alarm)
        for alarm in (alarm for alarm in now[1] if alarm.code not in before):
            await space.send_alarm_event(alarm)
        return now


def _waiting_events(events: Queue[Event]) -> list[Event]:
    """Return all waiting events. If there are none, wait at most REFRESH_S for the first one."""
    found: list[Event] = []
    try:
        found.append(events.get(timeout=REFRESH_S))
        while True:
            found.append(events.get_nowait())
    except Empty:
        return found
