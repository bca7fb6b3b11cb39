"""What the commands make of answers of the service that are not what they expect."""

from __future__ import annotations

import httpx
import pytest

from agent.service.client import Client
from drivers.errors import LinkLost, ProtocolError, VolcalError


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
