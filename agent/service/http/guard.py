"""Checks of every HTTP request before it is processed. The host name, the origin, the size and the number of requests
in progress are checked. Which token a request needs is said in `agent.service.http.permission`.

A foreign web page that is open in the browser of the operating panel can send requests to loopback. Such a page does
not have the access token of the service, so it cannot send commands. A foreign `Host` header indicates DNS rebinding,
and a foreign `Origin` header indicates a request by another page. Requests with such a header are refused even if they
only read.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Collection, Sequence
from http import HTTPStatus
from urllib.parse import urlsplit

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from agent.service.http.problems import Problem, answer

MAX_BODY_BYTES = 64 * 1024
MAX_REQUESTS = 64
"""Number of requests, streams of events included, that are processed at the same time. An abort is not counted: it is
processed whatever other clients do."""
ABORT_PATH = "/api/abort"
LOOPBACK_NAMES = frozenset({"localhost", "127.0.0.1", "[::1]", "::1"})

MAX_DIGITS = 18
"""Longest number in a header. Python refuses to convert a text of some thousand digits."""

SECURITY_HEADERS = (
    (b"x-content-type-options", b"nosniff"),
    (b"x-frame-options", b"DENY"),
    (b"referrer-policy", b"no-referrer"),
    (b"cross-origin-resource-policy", b"same-origin"),
)


def _problem(status: HTTPStatus, detail: str, hint: str) -> Problem:
    return Problem(title=status.phrase, status=status, detail=detail, hint=hint)


class Guard:
    """ASGI middleware that checks the host name, the origin and the size of every request. `names` are the host names,
    without port, by which a browser may reach the service."""

    def __init__(self, app: ASGIApp, names: Collection[str]) -> None:
        self._app = app
        self._names = {name.lower() for name in names} | LOOPBACK_NAMES
        self._in_progress = 0

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        problem, is_abort = self._objection(Headers(scope=scope)), scope["path"] == ABORT_PATH
        if problem is not None and not (is_abort and problem is _TOO_LONG):
            await answer(problem)(scope, receive, send)
        elif is_abort:
            body = await _whole_body(receive) if problem is None else None
            # an abort is carried out although its reason is too long
            await self._app(scope, _body_first(_NO_BODY if body is None else body, receive), _with_headers(send))
        elif self._in_progress >= MAX_REQUESTS:
            await answer(_TOO_MANY)(scope, receive, send)
        else:
            self._in_progress += 1
            try:
                await self._process(scope, receive, send)
            finally:
                self._in_progress -= 1

    async def _process(self, scope: Scope, receive: Receive, send: Send) -> None:
        send = _with_headers(send)
        body = await _whole_body(receive)
        if body is None:
            await answer(_TOO_LONG)(scope, receive, send)
        else:
            await self._app(scope, _body_first(body, receive), send)

    def _objection(self, headers: Headers) -> Problem | None:
        host = headers.get("host", "")
        if _host_name(f"//{host}") not in self._names:
            return _problem(
                HTTPStatus.MISDIRECTED_REQUEST,
                f"host name {host or '(empty)'} is not accepted",
                "add it to `service.host_names`",
            )
        origin = headers.get("origin")
        if origin is not None and _network_location(origin) != host.lower():
            return _problem(HTTPStatus.FORBIDDEN, f"requests from pages of {origin} are not accepted", "")
        length = headers.get("content-length", "0")
        if not (length.isascii() and length.isdigit()) or len(length) > MAX_DIGITS or int(length) > MAX_BODY_BYTES:
            return _TOO_LONG
        return None


_TOO_LONG = _problem(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, f"the request is longer than {MAX_BODY_BYTES} bytes", "")
_NO_BODY: Sequence[Message] = ({"type": "http.request"},)
_TOO_MANY = _problem(
    HTTPStatus.SERVICE_UNAVAILABLE,
    f"the service already processes {MAX_REQUESTS} requests",
    "close other pages and programs that use the service; an abort is accepted all the same",
)


async def _whole_body(receive: Receive) -> Sequence[Message] | None:
    """Return the messages of `receive` up to the end of the body, or None if the body is too long.

    The length of the body need not be stated in advance. The body is read before the request is processed, because a
    request cannot be refused any more once its response has begun, as with the stream of events.
    """
    messages, received = list[Message](), 0
    while True:
        message = await receive()
        received += len(message.get("body", b""))
        if received > MAX_BODY_BYTES:
            return None
        messages.append(message)
        if not message.get("more_body", False):  # the end of the body, or of the connection
            return messages


def _body_first(messages: Sequence[Message], receive: Receive) -> Receive:
    """Return a `receive` that hands out `messages` before those of `receive`."""
    left = deque(messages)

    async def received() -> Message:
        return left.popleft() if left else await receive()

    return received


def _with_headers(send: Send) -> Send:
    async def sending(message: Message) -> None:
        if message["type"] == "http.response.start":
            message["headers"] = [*message["headers"], *SECURITY_HEADERS]
        await send(message)

    return sending


def _network_location(address: str) -> str:
    """Return host name and port of `address`, or an empty text if it is no address."""
    try:
        return urlsplit(address).netloc.lower()
    except ValueError:
        return ""


def _host_name(address: str) -> str:
    """Return the host name of `address` without the port, or an empty text if it has none."""
    try:
        return (urlsplit(address).hostname or "").lower()
    except ValueError:
        return ""
