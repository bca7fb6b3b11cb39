"""OPC UA endpoint of the service. The optional dependency asyncua is imported when the endpoint is opened."""

from __future__ import annotations

import asyncio
import threading
from concurrent.futures import Future
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Final

import structlog

from agent.errors import EndpointUnavailable
from agent.service.accept_errors import AcceptErrors
from agent.service.control import Control
from agent.settings.opcua import OpcUaSettings
from drivers.errors import ConfigurationError, VolcalError
from drivers.foreign_errors import IN_THE_LOG

if TYPE_CHECKING:
    from agent.service.opcua.server import OpcUaServer

OPEN_TIMEOUT_S: Final = 60.0
CLOSE_TIMEOUT_S: Final = 15.0
log = structlog.get_logger()


class OpcUaEndpoint:
    """OPC UA endpoint, which runs the server's event loop in a thread of its own. `token` is the access token of the
    service; clients send it as their password."""

    def __init__(self, settings: OpcUaSettings, state_directory: Path, token: str) -> None:
        self._settings = settings
        self._state_directory = state_directory
        self._directory = state_directory / "opcua"
        self._token = token
        self._thread: threading.Thread | None = None
        self._loop: asyncio.AbstractEventLoop | None = None
        self._stop: asyncio.Event | None = None
        self._stopped = threading.Event()

    @property
    def name(self) -> str:
        return "OPC UA"

    @property
    def alive(self) -> bool:
        """True as long as the thread of the server lives."""
        return self._thread is not None and self._thread.is_alive()

    @property
    def address(self) -> tuple[str, int]:
        return self._settings.host, self._settings.port

    @property
    def trusted_clients(self) -> Path:
        return self._settings.trusted_clients or self._directory / "trusted"

    def start(self, control: Control) -> None:
        """Open the endpoint. Raise EndpointUnavailable if that fails, whatever the reason: the machine can be used
        without OPC UA."""
        opened: Future[None] = Future()
        self._stopped.clear()
        self._thread = threading.Thread(target=self._run, args=(control, opened), name="opc ua", daemon=True)
        self._thread.start()
        try:
            opened.result(OPEN_TIMEOUT_S)
        except BaseException as error:
            self.stop()
            if isinstance(error, Exception):
                raise _unavailable(error) from error
            raise
        log.info("OPC UA open", address="{}:{}".format(*self.address), trusted_clients=str(self.trusted_clients))

    def stop(self) -> None:
        """Close the endpoint. Do nothing if it is already closed."""
        self._stopped.set()
        if self._loop is not None and self._stop is not None and not self._loop.is_closed():
            self._loop.call_soon_threadsafe(self._stop.set)
        if self._thread is not None:
            self._thread.join(CLOSE_TIMEOUT_S)
        self._thread = self._loop = self._stop = None

    def _run(self, control: Control, opened: Future[None]) -> None:
        try:
            asyncio.run(self._serve(control, opened))
        except BaseException as error:
            if opened.done():
                log.exception("OPC UA server ended")
            else:
                opened.set_exception(error)

    async def _serve(self, control: Control, opened: Future[None]) -> None:
        try:
            module = import_module("agent.service.opcua.server")
        except ModuleNotFoundError as error:
            raise ConfigurationError(
                f"opcua.enabled is set, but {error.name} is not installed",
                key="opcua.enabled",
                hint="pip install 'volcal[opcua]', or opcua.enabled = false",
            ) from error
        self.trusted_clients.mkdir(parents=True, exist_ok=True)
        stop = asyncio.Event()
        self._loop, self._stop = asyncio.get_running_loop(), stop
        if self._stopped.is_set():  # it was stopped before there was a loop to tell
            stop.set()
        AcceptErrors("OPC UA").install()
        files = module.ServerFiles(self._state_directory, self._directory, self.trusted_clients, self._token)
        server: OpcUaServer = module.OpcUaServer(self._settings, files, control)
        await server.serve(stop, lambda: opened.set_result(None))


def _unavailable(error: Exception) -> EndpointUnavailable:
    if isinstance(error, VolcalError):
        return EndpointUnavailable(error.message, hint=error.hint, **error.where)
    hint = (
        "set opcua.enabled = false, or remove opcua.node_sets and opcua.further_node_sets: then only the node sets "
        "that are shipped are loaded"
    )
    if isinstance(error, TimeoutError):
        return EndpointUnavailable(f"the server did not open within {OPEN_TIMEOUT_S:g} s", hint=hint, key="opcua")
    log.error("OPC UA cannot be opened", exc_info=error)
    return EndpointUnavailable(f"the server cannot be built: {IN_THE_LOG}", hint=hint, key="opcua")
