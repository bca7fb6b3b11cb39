"""The small form of `python -m campaigns.fuzz`: few mutations with a fixed seed for every decoder."""

from __future__ import annotations

import json
import logging
import signal
import sqlite3
from collections.abc import Iterator
from contextlib import closing, suppress
from pathlib import Path
from random import Random
from time import process_time

import pytest
from journaled import journaled
from structlog.testing import capture_logs

from agent.execution.journal_schema import FILE_NAME
from campaigns.fuzz import __main__ as fuzz
from campaigns.fuzz.catalogue import quick_decoders
from campaigns.fuzz.device_decoders import device_decoders
from campaigns.fuzz.file_decoders import file_decoders
from campaigns.fuzz.journal_decoder import read_everything, run_for_journal
from campaigns.fuzz.mutation import mutated
from campaigns.fuzz.state_decoders import state_decoders
from campaigns.fuzz.trial import LARGEST_GROWTH_BYTES, Decoder, excesses, tried
from campaigns.fuzz.wire_decoders import SNAPSHOT, wire_decoders
from drivers.errors import VolcalError

COUNT, SEED = 60, 1


@pytest.fixture(autouse=True)
def silent() -> Iterator[None]:
    logging.disable(logging.CRITICAL)
    with capture_logs():
        yield
    logging.disable(logging.NOTSET)


@pytest.mark.parametrize(
    "decoder",
    [*file_decoders(), *wire_decoders(), *device_decoders(), *state_decoders()],
    ids=lambda decoder: decoder.name,
)
def test_no_input_raises_anything_outside_the_error_tree(decoder: Decoder) -> None:
    found = tried(decoder, COUNT, SEED)
    assert not found.failures
    assert found.read + found.refused == COUNT


NESTED = b"[" * 3000
LONG_OFFSET = json.dumps({"id": 1, "ok": SNAPSHOT | {"program_offset": [0.0, 10**400, 0.0]}}).encode()
NODE_SET_NAMESPACE = b"http://opcfoundation.org/UA/2011/03/UANodeSet.xsd"
LONG_VERSION = (
    b'<UANodeSet xmlns="%s"><Models><Model ModelUri="http://opcfoundation.org/UA/DI/" Version="%s"/></Models>'
    b"</UANodeSet>"
)


@pytest.mark.parametrize(
    ("name", "data"),
    [
        ("sequence number of panels (JSON)", NESTED),
        ("answer of the service (JSON)", NESTED),
        ("problem told by the service (JSON)", NESTED),
        ("problem told by the service (JSON)", b'{"where": ["a"]}'),
        ("problem told by the service (JSON)", b'{"where": {"hint": "a", "message": "b", "self": "c"}}'),
        ("events of the service", b"event: status\ndata: " + NESTED + b"\n\n"),
        ("head of an OPC UA node set (XML)", b'<?xml version="1.0" encoding="utf-9"?><UANodeSet/>'),
        ("line of the LinuxCNC bridge", LONG_OFFSET),
        ("line of G-code to the simulator", b"G10L2P" + b"9" * 400 + b"X1"),
        ("head of an OPC UA node set (XML)", LONG_VERSION % (NODE_SET_NAMESPACE, b"1." + b"9" * 5000)),
    ],
)
def test_what_was_once_raised_outside_the_error_tree_is_refused_in_words(name: str, data: bytes) -> None:
    (decoder,) = (one for one in quick_decoders() if one.name == name)
    with suppress(*decoder.allowed):
        decoder.decode(data)


def test_a_damaged_journal_is_refused_in_words(tmp_path: Path) -> None:
    journaled(tmp_path, 1)
    with closing(sqlite3.connect(tmp_path / FILE_NAME)) as connection:
        connection.execute("PRAGMA journal_mode = DELETE")
    good = (tmp_path / FILE_NAME).read_bytes()
    # This journal has no origin and no steps of its run, for which some readers refuse even the good one.
    decoder = Decoder("journal", [good], lambda data: None if data == good else read_everything(data))
    found = tried(decoder, COUNT, SEED)
    assert not found.failures
    assert found.refused > 0


@pytest.fixture(scope="module")
def whole_journal() -> bytes:
    """Return the journal of a run whose table was accepted."""
    return run_for_journal().journal


@pytest.mark.parametrize(
    "damage",
    [
        "UPDATE decisions SET record = replace(record, 'artefact', 'artefuct') WHERE kind = 'accepted'",
        "UPDATE runs SET state = 'walking'; UPDATE origins SET begun_s = NULL; DELETE FROM steps",
    ],
)
def test_a_damaged_row_is_refused_in_words_by_each_reader(damage: str, whole_journal: bytes) -> None:
    with closing(sqlite3.connect(":memory:")) as journal:
        journal.deserialize(whole_journal)
        journal.executescript(damage)
        assert journal.total_changes > 0
        with pytest.raises(VolcalError, match="the journal is damaged"):
            read_everything(journal.serialize())


def test_what_is_wrong_is_found() -> None:
    """The harness itself: an error outside the tree, and an input that takes too long."""

    def wrong(refusals: tuple[type[Exception], ...] = ()) -> Decoder:
        calls = iter((None,))  # the seed itself, at the first call, is good

        def decode(_: bytes) -> None:
            if next(calls, KeyError) is KeyError:
                raise KeyError("x")

        return Decoder("wrong", [b"seed"], decode, refusals)

    assert len(tried(wrong(), 5, SEED).failures) == 5
    assert tried(wrong((KeyError,)), 5, SEED).refused == 5


def test_a_decoder_that_refuses_its_own_seed_fails_alone(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Also with an error of the tree: a good input must be read."""

    def refuse(data: bytes) -> None:
        raise VolcalError(f"not read: {len(data)}")

    tried_ones = [Decoder("strict", [b"seed", b"other"], refuse), Decoder("good", [b"seed"], lambda _: None)]
    monkeypatch.setattr("campaigns.fuzz.__main__.decoders", lambda: iter(tried_ones))
    monkeypatch.setattr("campaigns.fuzz.__main__.be_quiet", lambda: None)
    assert fuzz.main(["5"]) == 1
    found = json.loads(capsys.readouterr().out.splitlines()[-1])["decoders"]
    strict, good = found["strict"], found["good"]
    assert [text.split(" at ")[0] for text in strict["failures"]] == [
        "seed 0: VolcalError: not read: 4",
        "seed 1: VolcalError: not read: 5",
    ]
    assert (strict["refused"], good["read"], good["failures"]) == (5, 5, [])


def test_a_hang_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("campaigns.fuzz.trial.BOUND_S", 0.05)
    found = tried(Decoder("slow", [b"seed"], lambda data: None if data == b"seed" else signal.pause()), 1, SEED)
    assert "Hang: longer than 0.05 s" in found.failures[0]


def test_an_input_that_computes_too_long_is_found() -> None:
    def compute(data: bytes) -> None:
        if data != b"seed":
            began_s = process_time()
            while process_time() - began_s < 0.02:
                pass

    decoder = Decoder("slow", [b"seed"], compute, cpu_bound_s=0.01)
    (told,) = excesses(decoder, tried(decoder, 1, SEED))
    assert "0.01 s allowed, for input 0" in told


def test_memory_that_is_kept_is_found() -> None:
    kept: list[bytes] = []

    def keep(data: bytes) -> None:
        if data != b"seed":
            kept.append(b"x" * (LARGEST_GROWTH_BYTES // 4))

    # The limit of CPU time is not what is tested here.
    decoder = Decoder("keeping", [b"seed"], keep, cpu_bound_s=float("inf"))
    (told,) = excesses(decoder, tried(decoder, 10, SEED))
    assert "the memory grew by" in told


def test_a_trial_ends_in_its_time() -> None:
    found = tried(Decoder("good", [b"seed"], lambda _: None), 10, SEED, seconds=-1.0)
    assert found.read + found.refused == 0


def test_mutations_are_the_same_for_a_seed_and_differ_otherwise() -> None:
    first, again = (
        [mutated(Random(seed), b"1,2,3\n" * 20) for seed in range(50)]  # noqa: S311  no secret
        for _ in range(2)
    )
    assert first == again
    assert len(set(first)) > 40
