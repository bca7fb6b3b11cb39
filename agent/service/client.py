"""The other end of the HTTP door, for commands: requests out, errors of the one tree back."""

from __future__ import annotations

import json
import ssl
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

import httpx

from agent import errors as run_errors
from agent.service.address_file import PLACE_FILE, told
from agent.service.token import read_token, token_path
from agent.settings.schema import Settings
from drivers import errors
from drivers.errors import LinkLost, LinkTimeout, ProtocolError, VolcalError

Document = dict[str, Any]

ANSWER_WITHIN_S = 60.0
"""A start looks at the machine first, and may have to wait for its link."""
SILENT_AT_MOST_S = 45.0
"""Three of the comments that keep a stream of events."""


class NoService(LinkLost):
    """Nobody serves this machine."""


@dataclass(frozen=True)
class Client:
    """One connection to the service of `settings`."""

    settings: Settings
    _http: httpx.Client = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_http", _connected(self.settings))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._http.close()

    def get(self, path: str) -> Document:
        return self._asked("GET", path, None, {})

    def post(self, path: str, body: Mapping[str, Any] | None = None, *, token: bool = True) -> Document:
        headers = {"Authorization": f"Bearer {read_token(token_path(self.settings))}"} if token else {}
        return self._asked("POST", path, body, headers)

    def events(self, after: int | None = None) -> Iterator[tuple[str, Document]]:
        """(kind, document) of the status and of every event that follows; LinkLost where the service ends."""
        headers = {} if after is None else {"Last-Event-ID": str(after)}
        timeout = httpx.Timeout(ANSWER_WITHIN_S, read=SILENT_AT_MOST_S)
        try:
            with self._http.stream("GET", "/api/events", headers=headers, timeout=timeout) as answer:
                yield from _parsed(answer.iter_lines())
        except httpx.TransportError as error:
            raise self._lost(error) from error
        raise LinkLost("the service has ended", link=str(self._http.base_url))

    def _asked(self, method: str, path: str, body: Mapping[str, Any] | None, headers: dict[str, str]) -> Document:
        try:
            answer = self._http.request(method, path, json=body, headers=headers)
        except httpx.TransportError as error:
            raise self._lost(error) from error
        try:
            document: Document = answer.json()
        except ValueError as error:
            raise ProtocolError(
                f"what answers is no volcal service (status {answer.status_code})", link=str(self._http.base_url)
            ) from error
        if answer.is_error:
            raise error_of(document)
        return document

    def _lost(self, error: httpx.TransportError) -> VolcalError:
        link = str(self._http.base_url)
        if isinstance(error, httpx.TimeoutException):
            return LinkTimeout("the service does not answer", link=link, hint="see `systemctl status volcal`")
        return NoService(f"the service cannot be reached: {error}", link=link, hint=_START_IT)


_START_IT = "start it with `systemctl start volcal`, or `volcal serve --config …` in a terminal"


def error_of(problem: Mapping[str, Any]) -> VolcalError:
    """Return the error that a problem document describes; CommandRejected if its class is unknown here."""
    title = str(problem.get("title"))
    kind = getattr(errors, title, None) or getattr(run_errors, title, None)
    if not (isinstance(kind, type) and issubclass(kind, VolcalError)):
        kind = errors.CommandRejected
    where = {str(name): str(value) for name, value in dict(problem.get("where") or {}).items()}
    return kind(str(problem.get("detail", "refused")), hint=str(problem.get("hint", "")), **where)


def _connected(settings: Settings) -> httpx.Client:
    try:
        url = told(settings.state_directory)
    except FileNotFoundError:
        raise NoService(
            "no service runs for this machine", hint=_START_IT, file=str(settings.state_directory)
        ) from None
    except (OSError, ValueError, KeyError) as error:
        raise NoService(
            f"where the service is cannot be read: {error}", file=str(settings.state_directory / PLACE_FILE)
        ) from error
    verify = _context(settings.service.certificate_file)
    return httpx.Client(base_url=url, verify=verify, timeout=ANSWER_WITHIN_S, trust_env=False)


def _context(certificate: Path | None) -> ssl.SSLContext | bool:
    """Nobody but who has this very certificate's key: so it may be self-signed, and say any name."""
    if certificate is None:
        return True
    context = ssl.create_default_context(cafile=str(certificate))
    context.check_hostname = False
    return context


def _parsed(lines: Iterator[str]) -> Iterator[tuple[str, Document]]:
    """Events of a stream of `text/event-stream` lines; comments are passed over."""
    kind, data = "message", ""
    for line in lines:
        name, _, value = line.partition(":")
        match name:
            case "event":
                kind = value.strip()
            case "data":
                data += value.strip()
            case "" if not line and data:
                yield kind, json.loads(data)
                kind, data = "message", ""
