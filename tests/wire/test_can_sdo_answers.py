"""Answers of a CANopen node that no protocol allows. They come from a peer that knows nothing of the driver."""

from __future__ import annotations

import itertools
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import can
import pytest
from canopen import ObjectDictionary
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.canopen_mount.node import DriveNode
from drivers.canopen_mount.objects import STATUSWORD
from drivers.errors import CommandRejected, LinkError, ProtocolError, VolcalError
from drivers.links.can_adapters import CanAddress
from drivers.links.can_bus import CanNetworks

NODE = 5
STATUS_ANSWER = bytes.fromhex("4b 41 60 00 37 06 00 00")
_channels = itertools.count()


class Peer:
    """Node that answers every SDO request with the next of `answers`; afterwards it is silent."""

    def __init__(self, bus: can.BusABC) -> None:
        self.answers: list[bytes] = []
        self._bus = bus
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._serve)
        self._thread.start()

    def _serve(self) -> None:
        while not self._stopped.is_set():
            request = self._bus.recv(0.02)
            if request is not None and request.arbitration_id == 0x600 + NODE and self.answers:
                data = self.answers.pop(0)
                self._bus.send(can.Message(arbitration_id=0x580 + NODE, data=data, is_extended_id=False))

    def stop(self) -> None:
        self._stopped.set()
        self._thread.join()


@contextmanager
def connected() -> Iterator[tuple[DriveNode, Peer]]:
    channel = f"sdo-answers-{next(_channels)}"
    with can.Bus(interface="virtual", channel=channel) as bus:
        peer = Peer(bus)
        link = CanNetworks().acquire(CanAddress("virtual", channel))
        try:
            yield DriveNode(link, NODE, "azimuth", ObjectDictionary(), sdo_timeout_s=0.05), peer
        finally:
            link.close()
            peer.stop()


@pytest.mark.parametrize("length", range(1, 8))
@pytest.mark.parametrize("answer", [STATUS_ANSWER, bytes.fromhex("80 41 60 00 00 00 02 06")])
def test_a_short_answer_is_an_error_of_the_protocol(answer: bytes, length: int) -> None:
    with connected() as (node, peer):
        peer.answers = [answer[:length]]
        try:
            assert node.read(STATUSWORD) == 0x0637
            assert length >= 6
        except ProtocolError as error:
            assert error.where["node"] == "5"
            assert length < 8
        peer.answers = [STATUS_ANSWER]
        assert node.read(STATUSWORD) == 0x0637


@settings(max_examples=60, deadline=None)
@given(answers=st.lists(st.binary(min_size=0, max_size=8), min_size=1, max_size=4))
def test_no_answer_raises_anything_but_our_errors(answers: Sequence[bytes]) -> None:
    with connected() as (node, peer):
        for ask in (lambda: node.read(STATUSWORD), lambda: node.write(STATUSWORD, 1), lambda: node.read_text(0x1008)):
            peer.answers = list(answers)
            try:
                ask()
            except VolcalError as error:
                assert isinstance(error, LinkError) or error.where


SEGMENTED = bytes.fromhex("41 08 10 00 00 00 00 00")
"""Answer to the upload of object 0x1008 that announces segments and no size."""


def segment(number: int, text: bytes, *, last: bool) -> bytes:
    return bytes([(number % 2) << 4 | (7 - len(text)) << 1 | last]) + text.ljust(7, b"\0")


def test_an_object_that_is_refused_after_it_was_sent_is_an_altered_request() -> None:
    """Golden frames of CiA 301: an expedited upload of 0x6041 with two bytes, and the abort 0x06020000."""
    sent, refused = bytes.fromhex("4B41600037020000"), bytes.fromhex("8041600000000206")
    with connected() as (node, peer):
        peer.answers += [sent, refused]
        assert node.read(STATUSWORD) == 0x0237
        with pytest.raises(ProtocolError, match="has sent 0x6041:00 statusword before") as caught:
            node.read(STATUSWORD)
        assert caught.value.where["axis"] == "azimuth"
    with connected() as (node, peer):
        peer.answers.append(refused)
        with pytest.raises(CommandRejected, match="0x06020000"):
            node.read(STATUSWORD)


def test_a_text_in_segments_is_read() -> None:
    with connected() as (node, peer):
        peer.answers = [SEGMENTED, segment(0, b"a long ", last=False), segment(1, b"name", last=True)]
        assert node.read_text(0x1008) == "a long name"


def test_an_empty_segment_that_is_not_the_last_does_not_end_the_text() -> None:
    with connected() as (node, peer):
        peer.answers = [
            SEGMENTED,
            segment(0, b"a long ", last=False),
            segment(1, b"", last=False),
            segment(2, b"name", last=False),
            segment(3, b"", last=True),
        ]
        assert node.read_text(0x1008) == "a long name"
        assert peer.answers == []


def test_empty_segments_without_an_end_are_an_error_of_the_protocol() -> None:
    with connected() as (node, peer):
        peer.answers = [SEGMENTED, *(segment(number, b"", last=False) for number in range(1000))]
        with pytest.raises(ProtocolError, match="more than 512 bytes"):
            node.read_text(0x1008)
        assert len(peer.answers) > 400
        peer.answers = [STATUS_ANSWER]
        assert node.read(STATUSWORD) == 0x0637


def test_a_text_without_an_end_is_an_error_of_the_protocol_after_few_segments() -> None:
    with connected() as (node, peer):
        endless = [segment(number, b"endless", last=False) for number in range(1000)]
        peer.answers = [SEGMENTED, *endless]
        with pytest.raises(ProtocolError, match="more than 512 bytes") as caught:
            node.read_text(0x1008)
        assert len(peer.answers) > 900
        assert caught.value.where["node"] == "5"
        peer.answers = [STATUS_ANSWER]
        assert node.read(STATUSWORD) == 0x0637
