"""Decoders of what volcal itself has written and reads again: compressed texts, files of the state directory, and
answers of its service; and of node sets."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import httpx

from agent.execution.journal_queries import PACKED_COLUMNS
from agent.execution.packed_run import PackedRun, expand_stored_text
from agent.files import read_text
from agent.history import metrics
from agent.history.kept_documents import KeptDocuments
from agent.notifications import outbox
from agent.notifications.outbox import Outbox
from agent.service.access import paired_clients
from agent.service.access.paired_clients import PairedClients
from agent.service.client import Client
from agent.service.gateway import sequence_ledger
from agent.service.gateway.sequence_ledger import SequenceLedger
from agent.service.opcua.node_set_files import NODE_SETS, XML, node_sets_to_load
from agent.service.token import read_token
from agent.settings.opcua import OpcUaSettings
from campaigns.fuzz.memory_file import MemoryFile, MemoryFolder
from campaigns.fuzz.trial import Decoder
from drivers.errors import LinkLost, VolcalError
from drivers.serial_cnc.bank_files import BankFiles
from twin.formats.compressed_text import compress_text

ROWS: dict[str, Any] = {
    "steps": [[1, "a/touch", "TouchTowards", {"target_mm": [0.0, 0.0, 1.0]}, 1.0, 2.0, {"touch": [1, 2, 3]}, None, 0]],
    "balls": [[1, "a/centre", {"ball": 0, "centre_mm": [1.0, 2.0, 3.0]}]],
    "temperatures": [[2, "a/temperatures", {"artefact": 20.25}]],
}
"""Rows of a run by their table; the journal has records as JSON texts."""
PACKED = PackedRun(
    {
        table: [[json.dumps(cell) if isinstance(cell, dict) else cell for cell in row] for row in ROWS[table]]
        for table in PACKED_COLUMNS
    }
)
CLIENTS = {
    "clients": [
        {"name": "tablet", "role": "operator", "paired": "2026-11-01T20:00:00.000+00:00", "sha256": "ab" * 32},
        {"name": "desk", "role": "engineer", "paired": "2026-11-02T20:00:00.000+00:00", "sha256": "cd" * 32},
    ]
}
NOTICE = {
    "version": 1,
    "notice_id": "20261101T200000Z-0000/ended",
    "at": "2026-11-01T21:00:00.000+00:00",
    "machine": "mill",
    "occasion": "run_ended",
    "severity": "information",
    "state": "complete",
    "subject": "mill: complete",
    "text": "The run is complete.",
    "alarms": [],
    "run": None,
}
OUTBOX = {
    "version": 1,
    "ids": [NOTICE["notice_id"]],
    "waiting": [{"notice": NOTICE, "channels": ["email"]}],
}
PROBLEM = {
    "title": "CommandRejected",
    "status": 409,
    "detail": "the run goes on",
    "hint": "wait",
    "where": {"run": "1"},
}
STATUS = {"state": "idle", "run": {"id": "20261101T200000Z-0000", "balls": 12}, "alarms": []}
EVENTS = b'event: status\ndata: {"state": "idle"}\n\n: waiting\n\nevent: state\ndata: {"state":\ndata: "measuring"}\n\n'
ACTIVE = b"volcal-active-bank 1\nbank 2\ncounts_crc32 0123ABCD\n"
KEY = "history"
ANSWERED: Final = "http://127.0.0.1:1"


def state_decoders() -> Iterator[Decoder]:
    compressed = compress_text(PACKED.text)
    yield Decoder("compressed file (gzip)", [compressed], _reading(read_text))
    yield Decoder("packed run of the journal (gzip)", [compressed], PackedRun.unpacked)
    yield Decoder("packed run of the journal (JSON)", [PACKED.text], _packed)
    yield Decoder("packed estimate of the journal (gzip)", [compressed], expand_stored_text)
    yield _file("paired clients (JSON)", paired_clients.FILE_NAME, CLIENTS, lambda folder: PairedClients(folder).all)
    yield _file("waiting notices (JSON)", outbox.FILE_NAME, OUTBOX, lambda folder: Outbox(folder, ["email"]).count(""))
    ledger = {"accepted": 12, "content": ["start", 1]}
    yield _file("sequence number of panels (JSON)", sequence_ledger.FILE_NAME, ledger, SequenceLedger)
    for kind, document in ((str, "# HELP volcal_runs runs in history"), (dict, {"trends": [], "runs": {}})):
        yield Decoder(f"kept documents (JSON, {kind.__name__})", [_kept(document)], _reading_kept(kind))
    yield Decoder("active bank of a driver (text)", [ACTIVE], _reading_active_bank())
    yield Decoder("token (text)", [b"0123456789abcdefghijklmnopqrstuvwxyz\n"], _reading(read_token))
    yield Decoder("head of an OPC UA node set (XML)", [_node_set(0)], _reading_node_sets())
    yield Decoder(
        "answer of the service (JSON)", [json.dumps(STATUS).encode()], lambda data: _client(200, data).get("/")
    )
    yield Decoder("problem told by the service (JSON)", [json.dumps(PROBLEM).encode()], _refused)
    yield Decoder("events of the service", [EVENTS], _events)


def _packed(data: bytes) -> object:
    run = PackedRun.unpacked(compress_text(data))
    return run.balls, run.touches


def _reading(read: Callable[[Path], object]) -> Callable[[bytes], object]:
    file = MemoryFile()
    return lambda data: read(file.holding(data))


def _file(name: str, file: str, good: Any, read: Callable[[Path], object]) -> Decoder:
    folder = MemoryFolder()
    return Decoder(name, [json.dumps(good).encode()], lambda data: folder.reading({file: data}, read))


def _kept(document: Any) -> bytes:
    with TemporaryDirectory(prefix="volcal-fuzz-") as folder:
        path = Path(folder) / metrics.FILE_NAME
        KeptDocuments(path).write(KEY, {"text": document})
        return path.read_bytes()


def _reading_kept(kind: type) -> Callable[[bytes], object]:
    read = _reading(lambda path: KeptDocuments(path).read(KEY, kind))
    # the key is that of the history: what is wrong comes after it
    head = _kept("")[: _kept("").index(b', "documents"')]
    return lambda data: read(data if data.startswith(head) else head + b', "documents": ' + data + b"}")


def _reading_active_bank() -> Callable[[bytes], object]:
    folder = MemoryFolder()
    return lambda data: folder.reading({"active": data}, lambda path: BankFiles(path, {"device": "cnc"}).active())


def _node_set(number: int) -> bytes:
    needed, namespace = NODE_SETS[number], XML.strip("{}")
    uris = f"<NamespaceUris><Uri>{needed.uri}</Uri></NamespaceUris>"
    base = NODE_SETS[-1]
    required = f'<RequiredModel ModelUri="{base.uri}" Version="{base.version}"/>' if needed is not base else ""
    model = f'<Models><Model ModelUri="{needed.uri}" Version="{needed.version}">{required}</Model></Models>'
    return f'<?xml version="1.0" encoding="utf-8"?><UANodeSet xmlns="{namespace}">{uris}{model}</UANodeSet>'.encode()


def _reading_node_sets() -> Callable[[bytes], object]:
    folder = MemoryFolder()
    others = {f"{number}.xml": _node_set(number) for number in range(1, len(NODE_SETS))}

    def read(path: Path) -> object:
        return node_sets_to_load(OpcUaSettings(node_sets=path))

    return lambda data: folder.reading({"0.xml": data, **others}, read)


class _AnsweredClient(Client):
    """Client of a service that gives one answer to every request."""

    def __init__(self, status: int, answer: bytes) -> None:
        transport = httpx.MockTransport(lambda _: httpx.Response(status, content=answer))
        object.__setattr__(self, "_http", httpx.Client(transport=transport, base_url=ANSWERED, trust_env=False))


def _client(status: int, answer: bytes) -> Client:
    return _AnsweredClient(status, answer)


def _refused(data: bytes) -> object:
    """Return the error as which the client raises the document."""
    try:
        return _client(409, data).get("/")
    except VolcalError as problem:
        return str(problem)


def _events(data: bytes) -> object:
    found: list[object] = []
    try:
        found += _client(200, data).events()
    except LinkLost as end:  # the end of every stream
        return found, str(end)
    return found
