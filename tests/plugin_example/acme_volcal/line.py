"""Requests and answers over TCP; every failure is a volcal error that says where it happened and what to do."""

from __future__ import annotations

import socket

from drivers.errors import LinkLost, LinkTimeout, ProtocolError


class AcmeLine:
    """Line to the controller. An answer consists of words; the first is ``ok`` or ``no``."""

    def __init__(self, address: tuple[str, int], timeout_s: float, device: str) -> None:
        self._address, self._timeout_s = address, timeout_s
        self.where = {"device": device, "link": f"acme {address[0]}:{address[1]}"}
        self._socket: socket.socket | None = None

    @property
    def connected(self) -> bool:
        return self._socket is not None

    def open(self) -> None:
        try:
            self._socket = socket.create_connection(self._address, self._timeout_s)
        except OSError as error:
            raise LinkLost(f"no connection: {error}", hint="check address and power", **self.where) from error

    def close(self) -> None:
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def ask(self, question: str) -> list[str]:
        """Send a request and return the words of its answer."""
        if self._socket is None:
            raise LinkLost("the device is not open", hint="open it first", **self.where)
        try:
            self._socket.sendall(question.encode() + b"\n")
            answer = b""
            while not answer.endswith(b"\n"):
                chunk = self._socket.recv(1024)
                if not chunk:
                    raise ConnectionResetError("hung up")
                answer += chunk
        except TimeoutError as error:
            self.close()  # a late answer would be taken for the next one
            raise LinkTimeout(f"no answer to {question!r}", hint="check the controller", **self.where) from error
        except OSError as error:
            self.close()
            raise LinkLost(f"connection lost: {error}", hint="check cable and power", **self.where) from error
        words = answer.decode("ascii", "replace").split()
        if not words or words[0] not in ("ok", "no"):
            raise ProtocolError(f"{question!r} answered with {answer!r}", **self.where)
        return words
