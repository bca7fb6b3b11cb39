"""Every server of the project at the limit of file handles: it says so once and accepts connections afterwards."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import resource
import socket
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
from fake_control import FakeControl
from fastapi import FastAPI
from structlog.testing import capture_logs
from waiting import PATIENCE_S

from agent.service.accept_errors import AcceptErrors
from agent.service.gateway.endpoint import GatewayEndpoint
from agent.service.http.endpoint import HttpServer
from agent.service.opcua.endpoint import OpcUaEndpoint
from agent.settings.opcua import OpcUaSettings
from agent.settings.panel_gateway import GatewaySettings
from agent.settings.service import ServiceSettings
from drivers import accept_loop
from drivers.clock import RealClock
from simulators.wire.can.socketcand_server import SocketcandServerBus
from simulators.wire.tcp_server import TcpServer, serve_lines

Address = tuple[str, int]
Opened = contextlib.AbstractContextManager[Address]
SAID = "no connection can be accepted"


@contextlib.contextmanager
def gateway(directory: Path) -> Iterator[Address]:
    endpoint = GatewayEndpoint(GatewaySettings(enabled=True, port=0), directory)
    endpoint.start(FakeControl())
    try:
        yield endpoint.address
        assert endpoint.alive
    finally:
        endpoint.stop()
    assert not endpoint.alive


@contextlib.contextmanager
def http(_: Path) -> Iterator[Address]:
    server = HttpServer(ServiceSettings(port=0))
    server.serve(FastAPI())
    host, port = server.url.removeprefix("http://").split(":")
    try:
        httpx.get(server.url, timeout=PATIENCE_S, trust_env=False)  # its thread has imported what it needs
        yield host, int(port)
        assert server.alive
    finally:
        server.shut_down()
    assert not server.alive


@contextlib.contextmanager
def opc_ua(directory: Path) -> Iterator[Address]:
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    endpoint = OpcUaEndpoint(OpcUaSettings(port=port), directory, "token")
    endpoint.start(FakeControl())
    try:
        yield endpoint.address
        assert endpoint.alive
    finally:
        endpoint.stop()
    assert not endpoint.alive


@contextlib.contextmanager
def simulated_tcp(_: Path) -> Iterator[Address]:
    server = TcpServer("time", ("127.0.0.1", 0), lambda connection: serve_lines(connection, lambda line: line))
    server.start()
    try:
        yield server.address
    finally:
        server.close()


@contextlib.contextmanager
def socketcand(_: Path) -> Iterator[Address]:
    bus = SocketcandServerBus("can0")
    stopped = threading.Event()

    def pump() -> None:
        while not stopped.is_set():
            bus.recv(0.05)

    thread = threading.Thread(target=pump)
    thread.start()
    try:
        yield bus.host, bus.port
    finally:
        stopped.set()
        thread.join()
        bus.shutdown()


SERVERS: list[tuple[Callable[[Path], Opened], bytes]] = [
    (gateway, bytes.fromhex("0001 0000 0006 01 03 0003 0001")),
    (http, b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n"),
    (opc_ua, b"HELF\x3f\x00\x00\x00" + bytes(4) + (65536).to_bytes(4, "little") * 2 + bytes(8) + b"\x1f\x00\x00\x00"
     + b"opc.tcp://127.0.0.1:4840/volcal"),
    (simulated_tcp, b"hello\n"),
    (socketcand, b"< echo >"),
]  # fmt: skip


@contextlib.contextmanager
def no_file_handles() -> Iterator[None]:
    """Let this process open no further file."""
    limits = resource.getrlimit(resource.RLIMIT_NOFILE)
    # Handles below 3 are always in use, unlike higher ones, which the garbage collector may close at any time.
    resource.setrlimit(resource.RLIMIT_NOFILE, (3, limits[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, limits)


@pytest.mark.parametrize(("opened", "request_"), SERVERS)
def test_a_shortage_of_file_handles_is_said_once_and_survived(
    opened: Callable[[Path], Opened], request_: bytes, tmp_path: Path
) -> None:
    with opened(tmp_path) as address, capture_logs() as logs, socket.socket() as client:
        said = lambda: [entry for entry in logs if entry["event"] == SAID]  # noqa: E731
        client.settimeout(PATIENCE_S)
        with no_file_handles():
            client.connect(address)
            while not said():
                RealClock().sleep(0.01)
        client.sendall(request_)
        assert client.recv(1)
    assert len(said()) == 1
    assert "many open files" in said()[0]["reason"]


class ShortListener(socket.socket):
    """Listener at which every accept but each fourth one fails."""

    attempts = 0

    def accept(self) -> tuple[socket.socket, Address]:
        self.attempts += 1
        if self.attempts % 4:
            raise OSError(errno.EMFILE, "Too many open files")
        return socket.socket(), ("127.0.0.1", self.attempts)


def test_each_shortage_is_said_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(accept_loop, "RETRY_S", 0.0)
    stopped = threading.Event()
    with capture_logs() as logs, ShortListener() as listener:
        for connection, _ in accept_loop.accepted(listener, stopped, "panel gateway"):
            connection.close()
            if listener.attempts == 8:
                stopped.set()
    assert [entry["event"] for entry in logs] == 2 * [SAID, "connections are accepted again"]


def test_the_event_loops_say_each_shortage_once() -> None:
    unlike: list[dict[str, Any]] = []

    class Loop(asyncio.SelectorEventLoop):
        now_s = 0.0

        def time(self) -> float:
            return self.now_s

        def default_exception_handler(self, context: dict[str, Any]) -> None:
            unlike.append(context)

    with contextlib.closing(Loop()) as loop, capture_logs() as logs:
        errors = AcceptErrors("http")
        for loop.now_s in (0.0, 0.0, 1.0, 5.0, 14.0, 30.0):
            errors(loop, {"message": "socket.accept() out of system resource", "exception": OSError(24, "too many")})
        errors(loop, {"message": "Exception in callback", "exception": ZeroDivisionError()})
    assert [entry["event"] for entry in logs] == [SAID, SAID]
    assert len(unlike) == 1


def test_a_system_without_threads_costs_one_connection(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(_: threading.Thread) -> None:
        raise RuntimeError("can't start new thread")

    monkeypatch.setattr(threading.Thread, "start", refuse)
    ours, theirs = socket.socketpair()
    with capture_logs() as logs, ours:
        assert not accept_loop.attended(theirs, lambda: None, "panel gateway")
        assert ours.recv(1) == b""
    assert logs[0]["reason"] == "can't start new thread"


def test_the_loop_ends_with_its_listener_and_says_so() -> None:
    listener = socket.create_server(("127.0.0.1", 0))
    with capture_logs() as logs:
        listener.close()
        assert list(accept_loop.accepted(listener, threading.Event(), "panel gateway")) == []
    assert [entry["event"] for entry in logs] == ["the server no longer listens"]
