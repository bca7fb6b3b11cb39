"""Tokens and roles of HTTP requests. Each route names the request that it carries out, and `agent.service.access.roles`
says which role this request needs."""

from __future__ import annotations

import secrets
from http import HTTPStatus
from typing import Annotated, Any
from urllib.parse import unquote

from fastapi import Depends, Request
from fastapi.security import HTTPAuthorizationCredentials, HTTPBearer

from agent.printable import printable
from agent.service.access.roles import LEAST_ROLE, Requester
from agent.service.address_file import MACHINE_HEADER, machine_header
from agent.service.http.app_state import AppStateDependency
from agent.service.http.problems import RequestRefused
from drivers.errors import ConfigurationError

ROLE_REFUSED = "RoleRefused"
"""Title of the problem document if the token is valid and its role does not permit the request."""

_BEARER = HTTPBearer(
    auto_error=False,
    description="Token of a paired client, or content of the file `service.token_file`.",
)
Credentials = Annotated[HTTPAuthorizationCredentials | None, Depends(_BEARER)]


async def requester(app_state: AppStateDependency, given: Credentials) -> Requester:
    """Return the client that has the token of the request. Refuse a request without a valid token."""
    # A coroutine, as all functions here: an ordinary one would need a thread, and slow requests may occupy all of them.
    if given is None:
        raise _no_token("pair this client (`volcal pair`), or use the token in the file `service.token_file`")
    found = app_state.access.requester(given.credentials)
    if found is None:
        raise _wrong_token(
            "pair this client again (`volcal pair`), or use the token in the file `service.token_file`",
        )
    return found


AnyRequester = Annotated[Requester, Depends(requester)]


def permitted(request: str) -> Any:
    """Return a dependency that gives the client that sent a request, and refuses the request if the role of this client
    does not permit `request` (see `agent.service.access.roles.LEAST_ROLE`)."""

    async def checked(client: AnyRequester) -> Requester:
        if not client.permits(request):
            raise _refused(client, f"this request needs the role {LEAST_ROLE[request]}")
        return client

    return Depends(checked)


async def machine_token(client: AnyRequester) -> Requester:
    """Refuse a request without the token of the machine. Otherwise a client that is revoked could have paired others
    before."""
    if not client.has_machine_token:
        raise _refused(client, "this request needs the token of the machine")
    return client


async def of_this_machine(app_state: AppStateDependency, request: Request) -> None:
    """Refuse a request whose header says that the client means another machine. Settings of two machines that share a
    state directory find the same service."""
    meant = request.headers.get(MACHINE_HEADER)
    if meant is None:
        return
    own = app_state.settings().machine
    if meant != machine_header(own):
        raise RequestRefused(
            HTTPStatus.CONFLICT,
            f"the service works for the machine in {own}, not for that in {printable(unquote(meant))}",
            "use one state directory for each machine; if the settings of the service were changed, reload it",
            title=ConfigurationError.__name__,
        )


async def known_name(app_state: AppStateDependency, request: Request) -> str:
    """Return the name of the client that sent a request which needs no token; empty if it is not known."""
    scheme, _, token = request.headers.get("authorization", "").partition(" ")
    found = app_state.access.requester(token) if scheme.lower() == "bearer" else None
    return "" if found is None else found.name


def _token_of(request: Request) -> str:
    return str(request.app.state.token)


def require_token(token: Annotated[str, Depends(_token_of)], given: Credentials) -> None:
    """Refuse a request without the one token of an application that pairs nobody, as the set-up."""
    if given is None:
        raise _no_token("it is at the end of the address that the terminal shows")
    if not secrets.compare_digest(given.credentials.encode(), token.encode()):
        raise _wrong_token("it is at the end of the address that the terminal shows")


def _no_token(hint: str) -> RequestRefused:
    return RequestRefused(
        HTTPStatus.UNAUTHORIZED,
        "the token is required",
        f"{hint}; it is sent as `Authorization: Bearer …`",
        {"WWW-Authenticate": "Bearer"},
    )


def _wrong_token(hint: str) -> RequestRefused:
    return RequestRefused(HTTPStatus.FORBIDDEN, "the token is wrong", hint)


def _refused(client: Requester, reason: str) -> RequestRefused:
    who = f"{client.name} was paired as {client.role}"
    hint = "pair the client with this role, or send the request as somebody who has it"
    return RequestRefused(HTTPStatus.FORBIDDEN, f"{reason}; {who}", hint, title=ROLE_REFUSED)
