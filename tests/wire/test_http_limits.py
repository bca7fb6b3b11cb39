"""The HTTP server while other clients hold its connections, its requests and its threads. An abort gets through."""

from __future__ import annotations

import contextlib
import socket
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import httpx
import pytest
from fake_control import FakeControl
from structlog.testing import capture_logs
from waiting import PATIENCE_S

from agent.printable import MAX_REASON
from agent.service.access.access import Access
from agent.service.access.paired_clients import PairedClients
from agent.service.access.pairing_codes import PairingCodes
from agent.service.control import Status
from agent.service.http import connections
from agent.service.http.app import create_app
from agent.service.http.app_state import AppState
from agent.service.http.endpoint import HttpServer
from agent.service.http.guard import MAX_BODY_BYTES, MAX_REQUESTS
from agent.service.http.models import AbortBody
from agent.service.page.static_files import mount_page
from agent.service.state.event_log import EventLog
from agent.settings.service import ServiceSettings
from drivers.clock import RealClock

STATUS_REQUEST = b"GET /api/status HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n"
UNFINISHED_REQUEST = b"POST /api/start HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 9\r\n\r\n{"
EVENTS_REQUEST = b"GET /api/events HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n"


class SlowControl(FakeControl):
    """Control whose status is not available until `released` is set."""

    def __init__(self) -> None:
        super().__init__()
        self.released = threading.Event()
        self.released.set()

    def status(self) -> Status:
        assert self.released.wait(PATIENCE_S)
        return super().status()


class Served:
    def __init__(self) -> None:
        self.control = SlowControl()
        self.event_log = EventLog()
        unused: Any = None
        access = Access("secret", PairedClients(Path("nowhere")), PairingCodes(RealClock().now))
        state = AppState(self.control, self.event_log, unused, unused, unused, Path("volcal.toml"), access)
        self._server = HttpServer(ServiceSettings(port=0))
        self._server.serve(create_app(state, extensions=[mount_page]))
        self.url = self._server.url

    def close(self) -> None:
        self.control.released.set()
        self.event_log.close()
        self._server.shut_down()

    def abort(self, **body: Any) -> httpx.Response:
        with self.client() as client:
            return client.post("/api/abort", json=body or None)

    def client(self) -> httpx.Client:
        return httpx.Client(base_url=self.url, timeout=PATIENCE_S, trust_env=False)

    def connected(self, sent: bytes = b"") -> socket.socket:
        address = urlsplit(self.url)
        connection = socket.create_connection((address.hostname, address.port), timeout=PATIENCE_S)
        connection.sendall(sent)
        return connection


@pytest.fixture
def served() -> Iterator[Served]:
    served = Served()
    yield served
    served.close()


@pytest.fixture
def held() -> Iterator[contextlib.ExitStack]:
    with contextlib.ExitStack() as stack:
        yield stack


@pytest.mark.parametrize("sent", [b"", b"POST /api/abort HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 9\r\n\r\n{"])
def test_connections_without_a_request_keep_nobody_out(served: Served, held: contextlib.ExitStack, sent: bytes) -> None:
    for _ in range(2 * connections.MAX_CONNECTIONS):
        held.enter_context(served.connected(sent))
    assert served.abort(reason="now").status_code == 200
    assert served.control.asked == [("abort", "now")]
    with served.client() as client:
        assert client.get("/api/status").status_code == 200


def test_an_abort_gets_through_while_all_threads_are_occupied(served: Served, held: contextlib.ExitStack) -> None:
    served.control.released.clear()
    for _ in range(MAX_REQUESTS):
        held.enter_context(served.connected(STATUS_REQUEST))
    assert served.abort().status_code == 200
    assert served.control.count("abort") == 1


def test_an_abort_gets_through_while_streams_take_every_place(served: Served, held: contextlib.ExitStack) -> None:
    for _ in range(MAX_REQUESTS):
        stream = held.enter_context(served.connected(EVENTS_REQUEST))
        assert stream.recv(15) == b"HTTP/1.1 200 OK"
    with served.client() as client:
        refused = client.get("/api/status")
    assert refused.status_code == 503
    assert refused.headers["content-type"] == "application/problem+json"
    assert "abort is accepted" in refused.json()["hint"]
    assert served.abort().status_code == 200


USUAL = AbortBody().reason
JSON = "application/json"


@pytest.mark.parametrize(
    ("body", "kind", "reason"),
    [
        (b'{"reason": "a chip"}', JSON, "a chip"),
        (b'{"reason": "a chip"}', None, "a chip"),
        (b'{"reason": "a chip"}', "text/plain", "a chip"),
        (b'{"reason": "a chip", "since": 3}', JSON, "a chip"),
        (b'{"reason": "' + b"x" * 300 + b'"}', JSON, "x" * (MAX_REASON - 1) + "…"),
        (b'{"reason": ""}', JSON, USUAL),
        (b'{"reason": "' + b" " * 900 + b'x"}', JSON, USUAL),
        (b'{"reason": null}', JSON, USUAL),
        (b'{"reason": 3}', JSON, USUAL),
        (b'{"why": "a chip"}', JSON, USUAL),
        (b"null", JSON, USUAL),
        (b"{", JSON, USUAL),
        (b"[" * 20_000, JSON, USUAL),
        (b'{"reason": "\xff"}', JSON, USUAL),
        (b'{"reason": "\\ud800"}', JSON, USUAL),
        (b"reason=chip", "application/x-www-form-urlencoded", USUAL),
        (b"", None, USUAL),
    ],
)
def test_an_abort_is_carried_out_whatever_its_reason(
    served: Served, body: bytes, kind: str | None, reason: str
) -> None:
    with served.client() as client:
        answer = client.post("/api/abort", content=body, headers={} if kind is None else {"Content-Type": kind})
    assert (answer.status_code, answer.json()) == (200, {"taken": True})
    assert served.control.asked == [("abort", reason)]


def test_an_abort_is_carried_out_although_its_body_is_too_long(served: Served) -> None:
    with served.client() as client:
        for content in ((b"x" * 1024 for _ in range(1000)), b"x" * (MAX_BODY_BYTES + 1)):
            assert client.post("/api/abort", content=content).status_code == 200
    with served.connected(
        f"POST /api/abort HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: {'9' * 19}\r\n\r\n".encode()
    ) as it:
        assert it.recv(4096).startswith(b"HTTP/1.1 200")  # although nothing of its body ever comes
    assert served.control.asked == [("abort", USUAL)] * 3


def test_an_abort_that_breaks_off_is_no_defect(served: Served) -> None:
    with capture_logs() as logged:
        served.connected(b"POST /api/abort HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 9\r\n\r\n{").close()
        assert served.abort(reason="now").status_code == 200
    assert served.control.asked == [("abort", "now")]
    assert logged == []


@pytest.mark.parametrize(
    "sent",
    [
        b"",
        b"GET /api/st",
        STATUS_REQUEST[:-2],
        UNFINISHED_REQUEST,
        STATUS_REQUEST + b"GET",
        STATUS_REQUEST + UNFINISHED_REQUEST,
    ],
)
def test_a_request_must_be_complete_in_time(served: Served, sent: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connections, "REQUEST_TIMEOUT_S", 0.2)
    with served.connected(sent) as connection, contextlib.suppress(ConnectionResetError):
        while connection.recv(4096):
            pass


def test_a_stream_outlives_the_time_limit_of_its_request(served: Served, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connections, "REQUEST_TIMEOUT_S", 0.2)
    with served.connected(EVENTS_REQUEST) as stream, served.connected() as later:
        assert stream.recv(4096)
        with contextlib.suppress(ConnectionResetError):
            assert later.recv(1) == b""  # its limit, which began later, has passed
        served.event_log.publish("note", "still there")
        received = b""
        while b"still there" not in received:
            chunk = stream.recv(4096)
            assert chunk
            received += chunk


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ("Origin: http://[", 403),
        ("Origin: null", 403),
        ("Content-Length: \xb2", 400),
        (f"Content-Length: {'9' * 5000}", 400),
        (f"Content-Length: {'9' * 19}", 413),
    ],
)
def test_malformed_headers_are_refused(served: Served, headers: str, status: int) -> None:
    request = f"POST /api/hold HTTP/1.1\r\nHost: 127.0.0.1\r\nConnection: close\r\n{headers}\r\n\r\n"
    with served.connected(request.encode("latin-1")) as connection:
        assert connection.recv(4096).split()[1] == str(status).encode()


@pytest.mark.parametrize("request_line", ["GET /api/events", "GET /api/status", "POST /api/hold"])
def test_a_body_that_is_too_long_is_refused_before_the_request_is_processed(
    served: Served, request_line: str, caplog: pytest.LogCaptureFixture
) -> None:
    head = f"{request_line} HTTP/1.1\r\nHost: 127.0.0.1\r\nTransfer-Encoding: chunked\r\nConnection: close\r\n\r\n"
    body = b"%x\r\n%b\r\n0\r\n\r\n" % (MAX_BODY_BYTES + 1, b"x" * (MAX_BODY_BYTES + 1))
    with served.connected(head.encode() + body) as connection:
        answer = connection.makefile("rb").read()
    assert answer.startswith(b"HTTP/1.1 413 ")
    assert b"the request is longer than 65536 bytes" in answer
    assert served.control.asked == []
    assert caplog.records == []


def test_a_body_without_a_stated_length_is_read_whole(served: Served) -> None:
    with served.client() as client:
        body = iter([b'{"reason"', b': "no', b'w"}'])
        response = client.post("/api/abort", content=body, headers={"Content-Type": "application/json"})
    assert response.status_code == 200
    assert served.control.asked == [("abort", "now")]


@pytest.mark.parametrize("number", ["\xb2", "9" * 5000, "-1", "x"])
def test_an_event_number_that_is_none_is_ignored(served: Served, number: str) -> None:
    request = f"GET /api/events HTTP/1.1\r\nHost: 127.0.0.1\r\nLast-Event-ID: {number}\r\n\r\n"
    with served.connected(request.encode("latin-1")) as connection:
        assert connection.recv(4096).startswith(b"HTTP/1.1 200")


def test_the_page_runs_no_script_but_its_own(served: Served) -> None:
    with served.client() as client:
        page = client.get("/")
    assert page.status_code == 200
    policy = dict(part.strip().split(" ", 1) for part in page.headers["content-security-policy"].split(";"))
    assert policy["default-src"] == "'none'"
    assert policy["script-src"] == "'self'"
    assert policy["frame-ancestors"] == "'none'"
    assert "<script>" not in page.text
