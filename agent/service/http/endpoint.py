"""HTTP endpoint. The server is Uvicorn in its own thread; its socket is bound before the service reports readiness."""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable
from pathlib import Path

import uvicorn
from fastapi import FastAPI

from agent.service import address_file
from agent.service.control import Control
from agent.service.http.connections import BACKLOG, KEEP_ALIVE_S, LimitedConnection, LimitedServer
from agent.settings.service import ServiceSettings
from drivers.errors import ConfigurationError
from drivers.foreign_errors import cause_of

OPEN_TIMEOUT_S = 10.0
GRACE_PERIOD_S = 2


class HttpServer:
    """HTTP server of one application in its own thread. Port 0 of the settings means any free port."""

    def __init__(self, settings: ServiceSettings) -> None:
        self._settings = settings
        self._server: uvicorn.Server | None = None
        self._thread: threading.Thread | None = None
        self.url = ""

    def serve(self, app: FastAPI) -> None:
        """Bind the socket and start the server. Raise ConfigurationError if the address cannot be bound."""
        settings = self._settings
        bound = self._bound()
        port = bound.getsockname()[1]
        self.url = f"{settings.scheme}://{settings.reached_at}:{port}"
        config = uvicorn.Config(
            app,
            log_config=None,
            access_log=False,
            lifespan="off",
            server_header=False,
            proxy_headers=False,
            http=LimitedConnection,
            backlog=BACKLOG,
            timeout_keep_alive=KEEP_ALIVE_S,
            timeout_graceful_shutdown=GRACE_PERIOD_S,
            ssl_certfile=settings.certificate_file,
            ssl_keyfile=settings.key_file,
        )
        server = self._server = LimitedServer(config)
        self._thread = threading.Thread(target=server.run, kwargs={"sockets": [bound]}, name="http", daemon=True)
        self._thread.start()

    def shut_down(self) -> None:
        if self._server is not None and self._thread is not None:
            self._server.should_exit = True
            self._thread.join(GRACE_PERIOD_S + OPEN_TIMEOUT_S)

    @property
    def alive(self) -> bool:
        return self._thread is not None and self._thread.is_alive()

    def _bound(self) -> socket.socket:
        settings = self._settings
        family = socket.AF_INET6 if ":" in settings.host else socket.AF_INET
        listening = socket.socket(
            family, socket.SOCK_STREAM, socket.IPPROTO_TCP
        )  # asyncio sets TCP_NODELAY only if the protocol is given
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listening.bind((settings.host, settings.port))
            listening.listen()
        except OSError as error:
            listening.close()
            raise ConfigurationError(
                f"cannot listen at {settings.host} port {settings.port}: {cause_of(error)}",
                key="service.port",
                hint="choose another port, or stop the program that uses this one",
            ) from error
        return listening


class HttpEndpoint(HttpServer):
    """HTTP server of the service. `make_app` is a function that creates the HTTP application for a given control. The
    address is written into `directory`, where the commands find it."""

    name = "http"

    def __init__(self, settings: ServiceSettings, directory: Path, make_app: Callable[[Control], FastAPI]) -> None:
        super().__init__(settings)
        self._directory = directory
        self._make_app = make_app
        self._remove_address: Callable[[], None] | None = None

    def start(self, control: Control) -> None:
        """Bind the socket and start the server. Raise ConfigurationError if the address cannot be bound."""
        self.serve(self._make_app(control))
        self._remove_address = address_file.write_address(self._directory, self.url)

    def stop(self) -> None:
        if self._remove_address is not None:
            self._remove_address()
        self.shut_down()
