"""Tokens that the service accepts: that of the machine, which lies in a file, and those of the paired clients."""

from __future__ import annotations

import secrets
from dataclasses import dataclass

import structlog

from agent.service.access.paired_clients import PairedClients
from agent.service.access.pairing_codes import Invitation, PairingCodes, TooManyTries, WrongCode
from agent.service.access.roles import MACHINE, Requester, Role

log = structlog.get_logger()


@dataclass(frozen=True)
class Pairing:
    """Result of a pairing: the token of the client, and who it is. The token is told once and to this client alone."""

    token: str
    requester: Requester


@dataclass(frozen=True)
class Access:
    """Access to the requests of the service. `token` is the token of the machine."""

    token: str
    clients: PairedClients
    codes: PairingCodes

    def requester(self, presented: str) -> Requester | None:
        """Return the client that has the token `presented`, or None if nobody has it."""
        if secrets.compare_digest(presented.encode(), self.token.encode()):
            return MACHINE
        return self.clients.requester(presented)

    def invite(self, role: Role, name: str | None, minutes: float) -> tuple[str, Invitation]:
        """Return a new code and the client that it lets in. A former code is void from now on. Raise UserError if the
        name cannot be used."""
        invitation = Invitation(role, self.clients.free_name(name, role))
        return self.codes.open(invitation, minutes), invitation

    def pair(self, code: str) -> Pairing:
        """Exchange a code for a token. Raise WrongCode, TooManyTries, or an error of `PairedClients.add`, after which
        the code can be used again."""
        try:
            pairing = self.codes.use(code, self._admit)
        except (WrongCode, TooManyTries) as error:
            log.warning("pairing refused", reason=error.message)
            raise
        log.info("client paired", name=pairing.requester.name, role=pairing.requester.role)
        return pairing

    def _admit(self, invitation: Invitation) -> Pairing:
        token = self.clients.add(invitation.name, invitation.role)
        return Pairing(token, Requester(invitation.role, invitation.name))

    def revoke(self, name: str) -> None:
        """Refuse the token of a client from now on. Raise UserError if there is no client of this name."""
        self.clients.revoke(name)
        log.info("client revoked", name=name)
