"""Access control of the OPC UA server. The session object of each client enforces it, because asyncua does not.

asyncua does not pass the user to a method, so the session checks each call. asyncua also binds a session to any channel
that names the session's authentication token, which is a small and therefore guessable number. It binds the session
before it checks the user, and the binding remains if the check fails. With this module only the channel that created a
session can use it.
"""

from __future__ import annotations

import hmac
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import structlog
from asyncua import ua
from asyncua.crypto.permission_rules import User, UserRole
from asyncua.server.binary_server_asyncio import OPCUAProtocol
from asyncua.server.internal_server import InternalServer
from asyncua.server.internal_session import InternalSession
from asyncua.server.user_managers import UserManager
from asyncua.ua.status_codes import StatusCodes

from agent.service.opcua.certificates import is_trusted

MAX_CONNECTIONS: Final = 20
"""If more clients are connected, those that have waited for longest without a session make room."""
MOST_CONNECTIONS: Final = 200
"""Number of connections above which asyncua refuses a new one. It is reached only by a client that opens this number
between two calls of `make_room`."""
ACTIVATE_WITHIN_S: Final = 10.0
OPERATOR: Final = "operator"
ANONYMOUS: Final = "anonymous"
REFRESHES: Final[Mapping[ua.NodeId, int]] = {
    ua.NodeId(ua.Int32(ua.ObjectIds.ConditionType_ConditionRefresh)): 1,
    ua.NodeId(ua.Int32(ua.ObjectIds.ConditionType_ConditionRefresh2)): 2,
}
"""Methods with which a client asks for the alarms that are open, with the number of their arguments, all of them
integers; asyncua carries them out."""
log = structlog.get_logger()


def refusal_result(code: int) -> ua.CallMethodResult:
    """Return the call result with the status `code` for a method that was refused."""
    return ua.CallMethodResult(StatusCode=ua.StatusCode(ua.UInt32(code)))


def make_room(clients: Sequence[OPCUAProtocol]) -> None:
    """End the oldest connections without an active session if more than MAX_CONNECTIONS clients are connected.
    `clients` are in the order in which they connected.

    A connection needs neither a certificate nor the token, so that idle ones could otherwise keep trusted clients out.
    """
    excess = len(clients) - MAX_CONNECTIONS
    ended = [client for client in clients if not _is_active(client)][: max(excess, 0)]
    for client in ended:
        if client.transport is not None:
            client.transport.abort()
    if ended:
        peers = sorted({str(client.peer_name[0]) for client in ended})
        log.warning("OPC UA connections ended", count=len(ended), peers=peers, reason="too many without a session")


def _is_active(client: OPCUAProtocol) -> bool:
    session = None if client.processor is None else client.processor.session
    return session is not None and session.is_activated()


class ClientAuthentication(UserManager):
    """Authentication of clients. The certificate of the client must be trusted. The access token of the service is also
    required, except for anonymous reading."""

    def __init__(self, token: str, trusted_clients: Path, *, anonymous_reading: bool) -> None:
        self._token = token.encode()
        self._trusted_clients = trusted_clients
        self._anonymous_reading = anonymous_reading

    def get_user(
        self,
        iserver: InternalServer,
        username: str | None = None,
        password: str | None = None,
        certificate: bytes | None = None,
    ) -> User | None:
        """Return the user, or None if the client is refused.

        `certificate` is the client's certificate of the secure channel. The client has already proved that it holds the
        private key of this certificate.
        """
        if not is_trusted(certificate, self._trusted_clients):
            log.warning("OPC UA client refused", reason="certificate not trusted")
            return None
        if username is None:
            return User(UserRole.User, ANONYMOUS) if self._anonymous_reading else None
        if hmac.compare_digest(self._token, (password or "").encode()):
            return User(UserRole.User, OPERATOR)
        log.warning("OPC UA client refused", reason="wrong token")
        return None


class GuardedSession(InternalSession):
    """Session of a client. To call a method that moves the machine or writes to it, a client needs the access token of
    the service. Clients cannot write the values of nodes."""

    iserver: GuardedServer

    async def call(self, params: list[ua.CallMethodRequest]) -> list[ua.CallMethodResult]:
        """Execute the requests to call methods in order. A request that is not allowed is refused without any effect on
        the others."""
        return [await self._call(request) for request in params]

    async def write(self, params: ua.WriteParameters) -> list[ua.StatusCode]:
        """Refuse every write, even to a node of the standard address space that is marked as writable."""
        return [ua.StatusCode(ua.UInt32(StatusCodes.BadUserAccessDenied)) for _ in params.NodesToWrite]

    async def _call(self, request: ua.CallMethodRequest) -> ua.CallMethodResult:
        free = self.iserver.free_methods.get(request.MethodId, False)
        if not free and self.user.name != OPERATOR:
            log.warning("OPC UA method refused", user=self.user.name, method=str(request.MethodId))
            return refusal_result(StatusCodes.BadUserAccessDenied)
        if request.MethodId in REFRESHES and (refusal := self._refresh_refusal(request)) is not None:
            log.warning("OPC UA condition refresh refused", user=self.user.name)
            return refusal
        (result,) = await super().call([request])
        return result

    def _refresh_refusal(self, request: ua.CallMethodRequest) -> ua.CallMethodResult | None:
        """Return the result with which a ConditionRefresh is refused, or None if it may be carried out.

        A session may refresh only its own subscriptions (OPC 10000-9:2025, 5.5.7). asyncua knows each subscription by a
        small number and refreshes it for anybody, so one client could send events to another.
        """
        arguments, count = request.InputArguments or [], REFRESHES[request.MethodId]
        if len(arguments) != count:
            few = len(arguments) < count
            return refusal_result(StatusCodes.BadArgumentsMissing if few else StatusCodes.BadTooManyArguments)
        mismatched = [not _is_integer(argument.Value) for argument in arguments]
        if any(mismatched):
            refusal = refusal_result(StatusCodes.BadInvalidArgument)
            codes = [StatusCodes.BadTypeMismatch if wrong else StatusCodes.Good for wrong in mismatched]
            refusal.InputArgumentResults = [ua.StatusCode(ua.UInt32(code)) for code in codes]
            return refusal
        subscription = self.subscription_service.subscriptions.get(arguments[0].Value)
        if subscription is None:
            return refusal_result(StatusCodes.BadSubscriptionIdInvalid)
        is_own = subscription.session_id == self.session_id
        return None if is_own else refusal_result(StatusCodes.BadUserAccessDenied)


def _is_integer(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


REFRESH_SEVERITY = 1
"""Severity of the events before and after the open alarms of a ConditionRefresh."""


class GuardedServer(InternalServer):
    """Server whose sessions are `GuardedSession` objects. `free_methods` maps the id of each method to True if the
    method can be called without the access token of the service."""

    def __init__(self, users: ClientAuthentication) -> None:
        super().__init__(user_manager=users)
        self.bind_condition_methods = REFRESH_SEVERITY  # this also switches ConditionRefresh on
        self.free_methods: Mapping[ua.NodeId, bool] = {}
        self.max_connections = MOST_CONNECTIONS
        self.max_pending_activation_seconds = ACTIVATE_WITHIN_S

    def create_session(self, name: str, user: User | None = None, external: bool = False) -> InternalSession:
        kind = GuardedSession if external else InternalSession
        nobody = User(role=UserRole.Anonymous)
        return kind(self, self.aspace, self.subscription_service, name, user=user or nobody, external=external)

    def lookup_external_session(self, auth_token: Any) -> InternalSession | None:
        """Return None. A client that has lost its connection must therefore create a new session."""
        return None
