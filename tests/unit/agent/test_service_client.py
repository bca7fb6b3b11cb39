"""What the commands make of answers of the service that are not what they expect."""

from __future__ import annotations

import ssl
from pathlib import Path

import httpx
import pytest
from signers import Identity, identity

from agent.service.client import Client, _ssl_context
from drivers.errors import ConfigurationError, LinkLost, ProtocolError, VolcalError

ROOT = identity("plant root", authority=True)
ISSUING = identity("plant issuing", ROOT, authority=True)
LEAF = identity("mill-7", ISSUING)
OTHER = identity("office printer", ISSUING)


def client(answer: httpx.Response) -> Client:
    """Client of a service that gives this answer to every request."""
    made = Client.__new__(Client)
    transport = httpx.MockTransport(lambda _: answer)
    object.__setattr__(made, "_http", httpx.Client(transport=transport, base_url="http://volcal.test"))
    return made


def test_a_stream_that_is_refused_is_not_a_service_that_has_stopped() -> None:
    problem = {"title": "too many streams", "status": 503, "detail": "64 streams are open", "hint": "close one"}
    with pytest.raises(VolcalError, match="64 streams are open") as raised:
        list(client(httpx.Response(503, json=problem)).events())
    assert not isinstance(raised.value, LinkLost)


@pytest.mark.parametrize("text", ["<html>proxy</html>", "[1]", '"no"'])
def test_an_answer_that_is_no_document_is_of_another_server(text: str) -> None:
    with pytest.raises(ProtocolError, match="not a volcal service"):
        list(client(httpx.Response(502, text=text)).events())
    with pytest.raises(ProtocolError, match="not a volcal service"):
        client(httpx.Response(200, text=text)).get("/api/status")


def test_an_event_that_cannot_be_read_is_named() -> None:
    with pytest.raises(ProtocolError, match="cannot be read"):
        list(client(httpx.Response(200, text='event: note\ndata: {"text": \n\n')).events())


def test_a_stream_that_ends_is_a_service_that_has_stopped() -> None:
    events = client(httpx.Response(200, text='event: note\ndata: {"text": "x"}\n\n')).events()
    assert next(events) == ("note", {"text": "x"})
    with pytest.raises(LinkLost, match="has stopped"):
        next(events)


def file_of(path: Path, *parts: bytes) -> Path:
    path.write_bytes(b"".join(parts))
    return path


def accepted(trusted: Path, server: ssl.SSLContext) -> bool:
    """Return True if a client that trusts this file shakes hands with this server."""
    client_to_server, server_to_client = ssl.MemoryBIO(), ssl.MemoryBIO()
    context = _ssl_context(trusted)
    assert isinstance(context, ssl.SSLContext)
    sides = [
        context.wrap_bio(server_to_client, client_to_server, server_hostname="127.0.0.1"),
        server.wrap_bio(client_to_server, server_to_client, server_side=True),
    ]
    while sides:
        side = sides.pop(0)
        try:
            side.do_handshake()
        except ssl.SSLWantReadError:
            sides.append(side)
        except ssl.SSLCertVerificationError:
            return False
    return True


@pytest.mark.parametrize(
    ("own", "chain"),
    [(identity("mill-7"), ()), (LEAF, ()), (LEAF, (ISSUING,)), (LEAF, (ISSUING, ROOT))],
)
def test_exactly_the_certificate_of_the_service_is_trusted(
    tmp_path: Path, own: Identity, chain: tuple[Identity, ...]
) -> None:
    """Whoever issued it; other certificates of the same authority are not the service's."""
    said = "Aussteller: Werk Süd\n".encode("latin-1")
    trusted = file_of(tmp_path / "trusted.pem", said, *(one.pem for one in (own, *chain)))
    for served, is_own in ((own, True), (OTHER, False)):
        server = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        shown = file_of(tmp_path / "shown.pem", served.pem, ISSUING.pem)
        server.load_cert_chain(shown, file_of(tmp_path / "key.pem", served.key_pem))
        assert accepted(trusted, server) is is_own


@pytest.mark.parametrize(
    ("content", "cause"),
    [
        (None, "not found"),
        (b"nonsense\n", "not a certificate"),
        (LEAF.key_pem, "not a certificate"),
        (LEAF.pem[:200], "not a certificate"),
        (LEAF.pem.replace(b"\nM", b"\n-", 1), "not a certificate"),
        (b"\xff\x00", "not a certificate"),
    ],
)
def test_a_certificate_that_cannot_be_read_is_named(tmp_path: Path, content: bytes | None, cause: str) -> None:
    file = tmp_path / "service.pem"
    if content is not None:
        file.write_bytes(content)
    with pytest.raises(ConfigurationError, match=cause) as raised:
        _ssl_context(file)
    assert raised.value.where["file"] == str(file)
    assert "not sent" in raised.value.hint
