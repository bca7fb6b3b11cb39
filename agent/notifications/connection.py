"""Connections to receivers that end in time, whatever the receiver does, and the secrets that they need."""

from __future__ import annotations

import os
import socket
import ssl
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Protocol

from agent.files import read_text
from agent.notifications.notice import Notice
from agent.settings.credentials import handed_over, open_mode
from drivers.clock import Deadline, RealClock
from drivers.errors import ConfigurationError, VolcalError
from drivers.foreign_errors import OurWords, cause_of, certificate_cause

_SHORTEST_S = 0.05


class DeliveryFailed(VolcalError):
    """A receiver could not be reached, or did not take a notice."""

    exit_code = 3


class NoticeRefused(DeliveryFailed):
    """A receiver answered that it does not take this notice; it may take others."""


class ReceiverFailure(OurWords, OSError):
    """Failure of a receiver that no class of Python describes; its text is ours."""


class Channel(Protocol):
    """Way to one receiver."""

    def send(self, notice: Notice) -> str:
        """Deliver a notice. Return an empty text, or the complaint of a receiver that took it only in part. Raise
        DeliveryFailed if it was not taken, and NoticeRefused if the reason is the notice itself."""
        ...


class BoundedConnections:
    """Connections of one delivery, all of which are shut down at its deadline.

    A timeout of a socket limits only the silence between two bytes: a receiver that sends a byte now and then would
    hold the delivery for ever.
    """

    def __init__(self, timeout_s: float) -> None:
        self._deadline = Deadline.after(RealClock(), timeout_s)
        self._guards: list[socket.socket] = []
        self._shut = False
        self._lock = threading.Lock()

    @property
    def expired(self) -> bool:
        return self._deadline.expired

    @property
    def remaining_s(self) -> float:
        return max(self._deadline.remaining_s, _SHORTEST_S)

    def connect(self, host: str, port: int) -> socket.socket:
        """Return a connected TCP socket. Raise OSError if the receiver cannot be reached.

        The addresses of a name share the time that is left: one that does not answer must not use up that of the next.
        """
        connected = self._first_connected(socket.getaddrinfo(host, port, type=socket.SOCK_STREAM))
        with self._lock:
            if self._shut:
                connected.close()
                raise TimeoutError
            connected.settimeout(self.remaining_s)
            self._guards.append(connected.dup())  # TLS takes over the descriptor of the socket itself
        return connected

    def _first_connected(self, addresses: Sequence[tuple[int, int, int, str, Any]]) -> socket.socket:
        failure: OSError = ReceiverFailure("the name of the receiver has no address")
        for tried, (family, kind, protocol, _, address) in enumerate(addresses):
            candidate = socket.socket(family, kind, protocol)
            try:
                candidate.settimeout(self.remaining_s / (len(addresses) - tried))
                candidate.connect(address)
            except OSError as error:
                candidate.close()
                failure = error
            else:
                return candidate
        raise failure

    def shut_down(self) -> None:
        with self._lock:
            self._shut = True
            for guard in self._guards:
                with suppress(OSError):  # the receiver has closed the connection already
                    guard.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        with self._lock:
            for guard in self._guards:
                guard.close()
            self._guards.clear()


@contextmanager
def delivery(receiver: str, timeout_s: float, failures: tuple[type[Exception], ...]) -> Iterator[BoundedConnections]:
    """Yield the connections of one delivery, which must end after `timeout_s`.

    Raise DeliveryFailed in place of an OSError or of an error of the classes `failures`. `receiver` names the receiver
    in the error.
    """
    connections = BoundedConnections(timeout_s)
    timer = threading.Timer(timeout_s, connections.shut_down)
    timer.daemon = True
    timer.start()
    try:
        yield connections
    except Exception as error:
        if isinstance(error, DeliveryFailed) or not isinstance(error, (OSError, *failures)):
            raise
        raise DeliveryFailed(_reason(error, timeout_s, expired=connections.expired), receiver=receiver) from error
    finally:
        timer.cancel()
        connections.close()


def _reason(error: Exception, timeout_s: float, *, expired: bool) -> str:
    if expired or isinstance(error, TimeoutError):
        return f"no complete answer within {timeout_s:g} s"
    if isinstance(error, ssl.SSLCertVerificationError):
        return f"the certificate of the receiver is not accepted: {certificate_cause(error)}"
    if isinstance(error, OSError) and error.strerror:
        return f"the receiver cannot be reached: {cause_of(error)}"
    return f"the receiver does not keep to the protocol: {cause_of(error)}"


def tls_context(ca_file: Path | None, key: str) -> ssl.SSLContext:
    """Return a TLS context that checks the certificate and the name of the receiver.

    Raise ConfigurationError, which names the settings key `key`, if `ca_file` cannot be used.
    """
    if ca_file is None:
        return ssl.create_default_context()
    read_text(ca_file, error=ConfigurationError)
    try:
        return ssl.create_default_context(cafile=ca_file)
    except (OSError, ValueError) as error:
        raise ConfigurationError(
            "the file has no certificate in PEM form",
            key=key,
            file=str(ca_file),
            hint="it must contain the certificate of the authority that signed the receiver's",
        ) from error


def read_secret(
    credential: str, file: Path | None, key: str, environment: Mapping[str, str] = os.environ
) -> str | None:
    """Return the secret that systemd has passed as `credential`, or else the one in `file`; None if there is neither.

    Raise ConfigurationError, which names the settings key `key`, if the file cannot be read, does not hold one line, or
    can be read by other users than its owner.
    """
    path = handed_over(credential, environment) or file
    if path is None:
        return None
    text = read_text(path, error=ConfigurationError).strip()
    if (mode := open_mode(path, environment)) is not None:
        raise ConfigurationError(
            f"the file of a secret can be read by others (mode {mode:04o})",
            key=key,
            file=str(path),
            hint=f"chmod 600 {path}",
        )
    if not text or not text.isprintable():
        hint = "write the secret on a single line"
        raise ConfigurationError("the file of a secret does not contain one line", key=key, file=str(path), hint=hint)
    return text
