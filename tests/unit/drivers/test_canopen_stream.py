"""Private flag of the package canopen that the driver of the mount reads, since no public one tells the end of an SDO
upload. A release of canopen that changes it fails here, not at a machine."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

from canopen.sdo.client import ReadableStream

from drivers.canopen_mount.node import DriveNode

UPLOAD, EMPTY, LAST_TWO_BYTES = "40 08 10 00 00 00 00 00", "0E 00 00 00 00 00 00 00", "1B 61 62 00 00 00 00 00"
"""Answers of a node by CiA 301, 7.2.4.3: a segmented upload, an empty segment amid, and the last segment."""


def answering_node(answers: list[str]) -> Any:
    """Return a client of a node that gives the answers one by one and takes them from the list."""
    return SimpleNamespace(rx_cobid=0x605, request_response=lambda _: bytes.fromhex(answers.pop(0)))


def is_done(stream: ReadableStream) -> bool:
    return bool(stream._done)


def test_the_stream_is_done_after_the_last_segment_and_not_after_an_empty_one() -> None:
    assert "_done" in DriveNode._upload.__code__.co_names, "the driver no longer reads it: delete this module"
    answers = [UPLOAD, EMPTY, LAST_TWO_BYTES]
    stream = ReadableStream(answering_node(answers), 0x1008)
    assert not is_done(stream)
    assert (bytes(stream.read(1)), is_done(stream)) == (b"", False)
    assert (bytes(stream.read(1)), is_done(stream)) == (b"ab", True)
    assert not answers


def test_the_stream_of_an_expedited_upload_is_done_when_it_has_been_read() -> None:
    stream = ReadableStream(answering_node(["4B 08 10 00 61 62 00 00"]), 0x1008)
    assert not is_done(stream)
    assert (bytes(stream.read(1)), is_done(stream)) == (b"ab", True)
