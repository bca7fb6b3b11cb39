"""Pairing endpoints. A code is made with the token of the machine, and whoever knows the code exchanges it for a token
of its own."""

from __future__ import annotations

import math
from datetime import UTC, datetime, timedelta
from http import HTTPStatus

from fastapi import APIRouter, Depends, Request

from agent.service.access.page_address import is_reachable, page_address, qr_picture
from agent.service.access.pairing_codes import TooManyTries, WrongCode
from agent.service.access.roles import Requester
from agent.service.http.app_state import AppStateDependency
from agent.service.http.models import (
    AccessView,
    PairBody,
    PairedClientList,
    PairedClientView,
    PairedView,
    PairingCode,
    PairingCodeBody,
    RequestAccepted,
    RevokeBody,
)
from agent.service.http.permission import AnyRequester, machine_token
from agent.service.http.problems import DOCUMENTED, RequestRefused

without_token = APIRouter(prefix="/api", tags=["pairing"], responses=DOCUMENTED)
with_token = APIRouter(prefix="/api", tags=["pairing"], responses=DOCUMENTED)
of_machine = APIRouter(
    prefix="/api/pairing", tags=["pairing"], responses=DOCUMENTED, dependencies=[Depends(machine_token)]
)


@without_token.post("/pair")
def pair(app_state: AppStateDependency, body: PairBody) -> PairedView:
    """Exchange a pairing code for a token. Wrong tries make the code void, and the tries of all clients are limited per
    minute."""
    try:
        found = app_state.access.pair(body.code)
    except WrongCode as error:
        raise RequestRefused(HTTPStatus.FORBIDDEN, error.message, error.hint, title=type(error).__name__) from error
    except TooManyTries as error:
        headers = {"Retry-After": str(math.ceil(error.wait_s))}
        raise RequestRefused(HTTPStatus.TOO_MANY_REQUESTS, error.message, error.hint, headers) from error
    return PairedView(token=found.token, **_access(found.requester).model_dump())


@with_token.get("/access")
def access(client: AnyRequester) -> AccessView:
    """Return who the token of the request belongs to, and which requests its role permits."""
    return _access(client)


@of_machine.post("/code")
def code(app_state: AppStateDependency, request: Request, body: PairingCodeBody | None = None) -> PairingCode:
    """Make a pairing code. A former code is void from now on. The request requires the token of the machine."""
    asked = body or PairingCodeBody()
    ends = datetime.now(UTC) + timedelta(minutes=asked.minutes)
    digits, invitation = app_state.access.invite(asked.role, asked.name, asked.minutes)
    address = page_address(app_state.settings().service, str(request.base_url), digits)
    return PairingCode(
        code=digits,
        ends=f"{ends:%Y-%m-%dT%H:%M:%S}Z",
        role=invitation.role,
        name=invitation.name,
        address=address,
        picture=qr_picture(address),
        reachable=is_reachable(address),
    )


@of_machine.get("/clients")
def clients(app_state: AppStateDependency) -> PairedClientList:
    """Return the paired clients. The request requires the token of the machine."""
    found = app_state.access.clients.all
    return PairedClientList(clients=[PairedClientView(name=c.name, role=c.role, paired=c.paired) for c in found])


@of_machine.post("/revoke")
def revoke(app_state: AppStateDependency, body: RevokeBody) -> RequestAccepted:
    """Refuse the token of a paired client from now on. The request requires the token of the machine."""
    app_state.access.revoke(body.name)
    return RequestAccepted()


def _access(client: Requester) -> AccessView:
    return AccessView(role=client.role, name=client.name, may=sorted(client.may))
