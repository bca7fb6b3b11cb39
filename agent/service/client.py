"""HTTP client through which command-line commands use the service. If the service answers with a problem document (RFC
9457), the client raises the error that the document describes."""

from __future__ import annotations

import json
import ssl
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

import httpx

from agent import errors as run_errors
from agent.printable import printable
from agent.service.address_file import ADDRESS_FILE, MACHINE_HEADER, machine_header, read_address
from agent.service.token import read_token, token_path
from agent.settings.schema import Settings
from drivers import errors
from drivers.errors import ConfigurationError, LinkLost, LinkTimeout, ProtocolError, VolcalError
from drivers.foreign_errors import cause_of

Document = dict[str, Any]

ANSWER_TIMEOUT_S = 60.0
"""This timeout is long because a start request first reads the state of the machine and may have to wait for the
connection to it.
"""
STREAM_TIMEOUT_S = 45.0
"""This timeout is three times the interval at which the service sends comments to keep a stream of events alive."""


class NoService(LinkLost):
    """Error raised if no service runs for this machine."""


@dataclass(frozen=True)
class Client:
    """HTTP connection to the service of the machine that `settings` describes."""

    settings: Settings
    _http: httpx.Client = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_http", _connect(self.settings))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._http.close()

    @property
    def url(self) -> str:
        """Address at which this computer reaches the service."""
        return str(self._http.base_url).rstrip("/")

    def get(self, path: str, *, token: bool = False) -> Document:
        return self._request("GET", path, None, self._authorization() if token else {})

    def post(self, path: str, body: Mapping[str, Any] | None = None, *, token: bool = True) -> Document:
        return self._request("POST", path, body, self._authorization() if token else {})

    def events(self, after: int | None = None) -> Iterator[tuple[str, Document]]:
        """Yield the status of the service and then every event of the service, each as a pair (kind, document).

        `after` is the number of the last event that the caller already has. All later events are yielded, including
        events that occurred before this call.

        Raise LinkLost if the service ends or the connection fails, LinkTimeout if the service does not respond,
        ProtocolError if an event cannot be read, and the error of the service if it refuses the stream.
        """
        headers = {} if after is None else {"Last-Event-ID": str(after)}
        timeout = httpx.Timeout(ANSWER_TIMEOUT_S, read=STREAM_TIMEOUT_S)
        try:
            with self._http.stream("GET", "/api/events", headers=headers, timeout=timeout) as answer:
                if answer.is_error:
                    answer.read()
                    self._document(answer)
                yield from _parse_events(answer.iter_lines())
        except httpx.TransportError as error:
            raise self._lost(error) from error
        raise LinkLost("the service has stopped", link=str(self._http.base_url))

    def _authorization(self) -> dict[str, str]:
        return {"Authorization": f"Bearer {read_token(token_path(self.settings))}"}

    def _request(self, method: str, path: str, body: Mapping[str, Any] | None, headers: dict[str, str]) -> Document:
        try:
            answer = self._http.request(method, path, json=body, headers=headers)
        except httpx.TransportError as error:
            raise self._lost(error) from error
        return self._document(answer)

    def _document(self, answer: httpx.Response) -> Document:
        """Return the JSON object of an answer. Raise the error that a problem document describes."""
        try:
            document = answer.json()
        except (ValueError, RecursionError):
            document = None
        if not isinstance(document, dict):
            raise ProtocolError(
                f"the server at this address is not a volcal service (status {answer.status_code})",
                link=str(self._http.base_url),
            )
        if answer.is_error:
            raise error_of(document)
        shown: Document = _printable(document)
        return shown

    def _lost(self, error: httpx.TransportError) -> VolcalError:
        link = str(self._http.base_url)
        if isinstance(error, httpx.TimeoutException):
            return LinkTimeout("the service does not answer", link=link, hint="check it with `systemctl status volcal`")
        return NoService(f"the service cannot be reached: {error}", link=link, hint=_START_IT)


_START_IT = "start the service with `systemctl start volcal`, or `volcal serve --config …` in a terminal"


def error_of(problem: Mapping[str, Any]) -> VolcalError:
    """Return the error that a problem document describes. If this program does not know the class of the error, return
    CommandRejected."""
    title = str(problem.get("title"))
    kind = getattr(errors, title, None) or getattr(run_errors, title, None)
    if not (isinstance(kind, type) and issubclass(kind, VolcalError)):
        kind = errors.CommandRejected
    where = problem.get("where")
    places = {str(name): str(value) for name, value in where.items()} if isinstance(where, Mapping) else {}
    error: VolcalError = kind(str(problem.get("detail", "refused")), hint=str(problem.get("hint", "")))
    error.where.update(places)
    return error


def _connect(settings: Settings) -> httpx.Client:
    try:
        url = read_address(settings.state_directory)
    except FileNotFoundError:
        raise NoService(
            "no service runs for this machine", hint=_START_IT, file=str(settings.state_directory)
        ) from None
    except (OSError, ValueError, KeyError, RecursionError) as error:
        raise NoService(
            f"the address file of the service cannot be read: {error}",
            file=str(settings.state_directory / ADDRESS_FILE),
        ) from error
    verify = _ssl_context(settings.service.certificate_file)
    headers = {MACHINE_HEADER: machine_header(settings.machine)}
    return httpx.Client(base_url=url, headers=headers, verify=verify, timeout=ANSWER_TIMEOUT_S, trust_env=False)


def _ssl_context(certificate: Path | None) -> ssl.SSLContext | bool:
    """Return a context that trusts only the first certificate of the file, that of the service. It may therefore be
    self-signed or issued by any authority, and contain any host name. If `certificate` is None, return True, which
    stands for the usual verification.

    Raise ConfigurationError if the file has no certificate that can be read.
    """
    if certificate is None:
        return True
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname = False
    # The certificate itself is the anchor. Its authorities, which the file may contain too, issue others as well.
    context.verify_flags |= ssl.VERIFY_X509_PARTIAL_CHAIN
    try:
        context.load_verify_locations(cadata=_first_certificate(certificate))
    except (OSError, ValueError) as error:  # ssl.SSLError is an OSError
        raise ConfigurationError(
            f"the certificate of the service cannot be read: {_certificate_problem(error)}",
            key="service.certificate_file",
            hint="the command was not sent; correct the file, or run the command as a user who may read it",
            file=str(certificate),
        ) from error
    return context


_PEM_BEGIN, _PEM_END = "-----BEGIN CERTIFICATE-----", "-----END CERTIFICATE-----"


def _first_certificate(file: Path) -> str:
    """Return the first certificate of a PEM file, without the text and the keys that the file may contain besides.
    Raise ValueError if there is none."""
    text = file.read_bytes().decode("ascii", errors="replace")
    begin = text.index(_PEM_BEGIN)
    return text[begin : text.index(_PEM_END, begin)] + _PEM_END


def _certificate_problem(error: Exception) -> str:
    unreadable = isinstance(error, OSError) and not isinstance(error, ssl.SSLError)
    return cause_of(error) if unreadable else "it is not a certificate in PEM form"


def _printable(value: Any) -> Any:
    """Return the document with all its texts printable, so that a terminal shows and never obeys them."""
    if isinstance(value, str):
        return printable(value)
    if isinstance(value, list):
        return [_printable(part) for part in value]
    return {key: _printable(part) for key, part in value.items()} if isinstance(value, dict) else value


def _parse_events(lines: Iterator[str]) -> Iterator[tuple[str, Document]]:
    """Yield (kind, document) of each event in the lines of a `text/event-stream`; comments are skipped."""
    kind, data = "message", ""
    for line in lines:
        name, _, value = line.partition(":")
        match name:
            case "event":
                kind = value.strip()
            case "data":
                data += value.strip()
            case "" if not line and data:
                try:
                    document = _printable(json.loads(data))
                except (ValueError, RecursionError) as error:
                    raise ProtocolError(f"an event of the service cannot be read: {error}") from error
                yield kind, document
                kind, data = "message", ""
