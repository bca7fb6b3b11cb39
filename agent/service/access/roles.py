"""Roles of the clients of the service, and the least role that each request needs.

An operator runs the machine: a run is started, held, resumed, answered, acknowledged and given up. An engineer may also
choose which compensation table acts and see what the diagnostics contain. Nobody needs a role for an abort.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType
from typing import Final, Literal, get_args

from agent.service.allowed_requests import ANSWER, GIVE_UP, HOLD, RESET, RESTORE_FORMER, RESUME, RESUME_RUN, START

Role = Literal["operator", "engineer"]
ROLES: tuple[Role, ...] = get_args(Role)
"""Roles, each of which may do what the ones before it may."""

RESTORE_TABLE, CHECK_SETTINGS, DIAGNOSTICS = "restore_table", "check_settings", "diagnostics"

LEAST_ROLE: Final = MappingProxyType[str, Role](
    {
        START: "operator",
        RESUME_RUN: "operator",
        HOLD: "operator",
        RESUME: "operator",
        RESET: "operator",
        ANSWER: "operator",
        GIVE_UP: "operator",
        RESTORE_FORMER: "operator",  # giving a run up and a reset do the same first
        RESTORE_TABLE: "engineer",
        CHECK_SETTINGS: "engineer",
        DIAGNOSTICS: "engineer",
    }
)
"""Least role of each request."""


@dataclass(frozen=True)
class Requester:
    """Client that sent a request. `name` is the name under which it was paired; it is empty if the client has the token
    of the machine, which lies in a file and belongs to nobody in particular."""

    role: Role
    name: str = ""

    @property
    def has_machine_token(self) -> bool:
        return not self.name

    @property
    def may(self) -> frozenset[str]:
        """Requests that the role of this client permits; the state of the run may still forbid them."""
        return frozenset(request for request in LEAST_ROLE if self.permits(request))

    def permits(self, request: str) -> bool:
        return ROLES.index(self.role) >= ROLES.index(LEAST_ROLE[request])


MACHINE: Final = Requester("engineer")
"""Client with the token of the machine."""
