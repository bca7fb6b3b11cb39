"""What every request must pass before it is looked at: who it is addressed to, where it comes from, how large it is.

A page of a stranger that is open in the panel's browser can send requests to loopback. It cannot send a token that it
does not know, and beyond that: a `Host` that is none of ours is DNS rebinding, an `Origin` that is none of ours another
page's request; both are refused, for reading as well.
"""

from __future__ import annotations

import secrets
from collections.abc import Collection
from http import HTTPStatus
from typing import Annotated
from urllib.parse import urlsplit

from fastapi import Depends
from fastapi.security import HTTPAuthorizationCredentials, HTTPBearer
from starlette.datastructures import Headers
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from agent.service.http.app_state import SiteHere
from agent.service.http.problems import Problem, Refused, answer

LARGEST_BODY = 64 * 1024
LOOPBACK_NAMES = frozenset({"localhost", "127.0.0.1", "[::1]", "::1"})

SECURITY_HEADERS = (
    (b"x-content-type-options", b"nosniff"),
    (b"x-frame-options", b"DENY"),
    (b"referrer-policy", b"no-referrer"),
    (b"cross-origin-resource-policy", b"same-origin"),
)


class Guard:
    """ASGI middleware. `names`: those that a browser may reach us by, without the port."""

    def __init__(self, app: ASGIApp, names: Collection[str]) -> None:
        self._app = app
        self._names = {name.lower() for name in names} | LOOPBACK_NAMES

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        problem = self._objection(Headers(scope=scope))
        if problem is not None:
            await answer(problem)(scope, receive, send)
            return
        await self._app(scope, _limited(receive), _with_headers(send))

    def _objection(self, headers: Headers) -> Problem | None:
        host = headers.get("host", "")
        if _name(f"//{host}") not in self._names:
            return _problem(
                HTTPStatus.MISDIRECTED_REQUEST, f"this is not {host or 'nobody'}", "name it in `service.host_names`"
            )
        origin = headers.get("origin")
        if origin is not None and urlsplit(origin).netloc.lower() != host.lower():
            return _problem(HTTPStatus.FORBIDDEN, f"requests of a page of {origin} are not taken", "")
        length = headers.get("content-length", "0")
        if not length.isdigit() or int(length) > LARGEST_BODY:
            return _problem(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, f"no more than {LARGEST_BODY} bytes are taken", "")
        return None


_BEARER = HTTPBearer(auto_error=False, description="The text of the file of `service.token_file`.")


def require_token(site: SiteHere, given: Annotated[HTTPAuthorizationCredentials | None, Depends(_BEARER)]) -> None:
    """Dependency of what moves or writes."""
    if given is None:
        raise Refused(
            HTTPStatus.UNAUTHORIZED,
            "this needs the token",
            "send it as `Authorization: Bearer …`; it lies in the file of `service.token_file`",
            {"WWW-Authenticate": "Bearer"},
        )
    if not secrets.compare_digest(given.credentials.encode(), site.token.encode()):
        raise Refused(HTTPStatus.FORBIDDEN, "the token is wrong", "it lies in the file of `service.token_file`")


def _limited(receive: Receive) -> Receive:
    """A body without a stated length is counted as it comes."""
    seen = 0

    async def counted() -> Message:
        nonlocal seen
        message = await receive()
        seen += len(message.get("body", b""))
        if seen > LARGEST_BODY:
            raise Refused(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, f"no more than {LARGEST_BODY} bytes are taken")
        return message

    return counted


def _with_headers(send: Send) -> Send:
    async def sending(message: Message) -> None:
        if message["type"] == "http.response.start":
            message["headers"] = [*message["headers"], *SECURITY_HEADERS]
        await send(message)

    return sending


def _problem(status: HTTPStatus, detail: str, hint: str) -> Problem:
    return Problem(title=status.phrase, status=status, detail=detail, hint=hint)


def _name(address: str) -> str:
    """The host's name without the port; empty where it is none."""
    try:
        return (urlsplit(address).hostname or "").lower()
    except ValueError:
        return ""
