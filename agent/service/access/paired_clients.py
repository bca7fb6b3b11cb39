"""Clients that were paired with the service. Each has a token of its own, of which the service keeps only the digest.

They are kept in a file of the state directory that only its owner can read, so that they stay paired when the service
is restarted. The tokens are random with 256 bits: a plain digest of such a text cannot be inverted by guessing.
"""

from __future__ import annotations

import hashlib
import json
import re
import secrets
from collections.abc import Callable
from dataclasses import asdict, dataclass
from datetime import datetime
from pathlib import Path
from threading import Lock
from typing import Any, Final

from agent.files import write_atomically
from agent.printable import one_line
from agent.service.access.roles import ROLES, Requester, Role
from agent.settings.credentials import open_mode
from drivers.clock import utc_timestamp
from drivers.errors import ConfigurationError, InputError, UserError
from drivers.foreign_errors import cause_of

FILE_NAME: Final = "paired-clients.json"
OWNER_ONLY: Final = 0o600
MAX_CLIENTS: Final = 100
_SHA256: Final = re.compile(r"[0-9a-f]{64}")
MAX_NAME: Final = 40


@dataclass(frozen=True)
class PairedClient:
    """Client with its `name`, which is unique, its role, the UTC time of its pairing, and the SHA-256 of its token."""

    name: str
    role: Role
    paired: str
    sha256: str


class PairedClients:
    """Paired clients of one service, kept in its state directory. It is safe to use from any thread.

    Raise ConfigurationError if the file with the clients cannot be read or if others than its owner can read it.
    """

    def __init__(self, directory: Path, stamp: Callable[[], str] = utc_timestamp) -> None:
        self._path = directory / FILE_NAME
        self._stamp = stamp
        self._lock = Lock()
        self._clients = _read(self._path)

    @property
    def all(self) -> tuple[PairedClient, ...]:
        """The clients in the order in which they were paired."""
        return self._clients

    def requester(self, token: str) -> Requester | None:
        """Return the client that has this token, or None."""
        digest = _digest(token)
        known = [client for client in self._clients if secrets.compare_digest(client.sha256, digest)]
        return Requester(known[0].role, known[0].name) if known else None

    def free_name(self, name: str | None, role: Role) -> str:
        """Return `name` in a form that can be shown, or a name of the form ``operator 2`` if it is None. Raise
        UserError if it is empty, too long or taken, or if there are too many clients."""
        taken = {client.name for client in self._clients}
        if len(taken) >= MAX_CLIENTS:
            raise UserError(f"{MAX_CLIENTS} clients are paired already", hint="revoke one: `volcal pair --revoke NAME`")
        if name is None:
            return next(free for number in range(1, MAX_CLIENTS + 1) if (free := f"{role} {number}") not in taken)
        shown = one_line(name, MAX_NAME + 1)
        if not shown or len(shown) > MAX_NAME:
            raise UserError(f"the name of a client has 1 to {MAX_NAME} characters", key="name")
        if shown in taken:
            raise UserError(
                f"a client is already paired as {shown}",
                hint=f"choose another name, or revoke it: `volcal pair --revoke '{shown}'`",
                key="name",
            )
        return shown

    def add(self, name: str, role: Role) -> str:
        """Pair a client and return its token. Raise UserError as `free_name` does, and ConfigurationError if the file
        cannot be written."""
        with self._lock:
            token = secrets.token_urlsafe(32)
            client = PairedClient(self.free_name(name, role), role, self._stamp(), _digest(token))
            self._keep((*self._clients, client))
            return token

    def revoke(self, name: str) -> None:
        """Forget a client, whose token is refused from now on. Raise UserError if there is no client of this name."""
        with self._lock:
            left = tuple(client for client in self._clients if client.name != name)
            if len(left) == len(self._clients):
                raise UserError(f"no client is paired as {one_line(name, MAX_NAME)}", hint="see `volcal pair --list`")
            self._keep(left)

    def _keep(self, clients: tuple[PairedClient, ...]) -> None:
        text = json.dumps({"clients": [asdict(client) for client in clients]}, indent=1, ensure_ascii=False)
        try:
            write_atomically(self._path, f"{text}\n", OWNER_ONLY)
        except InputError as error:
            raise ConfigurationError(
                f"the paired clients cannot be kept: {error.message}", hint=error.hint, file=str(self._path)
            ) from error
        self._clients = clients


def _digest(token: str) -> str:
    return hashlib.sha256(token.encode()).hexdigest()


def _read(path: Path) -> tuple[PairedClient, ...]:
    try:
        mode = open_mode(path)
        document = json.loads(path.read_text(encoding="utf-8"))
        clients = tuple(_client(entry) for entry in document["clients"])
    except FileNotFoundError:
        return ()
    except OSError as error:
        raise _unusable(f"cannot be read: {cause_of(error)}", path, "check its owner and mode") from error
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        hint = "delete the file, start the service and pair every client again (`volcal pair`)"
        raise _unusable("is damaged", path, hint) from error
    if mode is not None:
        raise _unusable(f"can be read by others (mode {mode:04o})", path, f"chmod 600 {path}")
    return clients


def _client(entry: Any) -> PairedClient:
    client = PairedClient(**entry)
    if client.role not in ROLES or not all(isinstance(value, str) and value for value in asdict(client).values()):
        raise ValueError("not a client")
    if not _SHA256.fullmatch(client.sha256) or datetime.fromisoformat(client.paired).tzinfo is None:
        raise ValueError("not a client")
    return client


def _unusable(what: str, path: Path, hint: str) -> ConfigurationError:
    return ConfigurationError(f"the file of the paired clients {what}", hint=hint, file=str(path))
