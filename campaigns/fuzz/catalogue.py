"""Every decoder of foreign bytes that the program has."""

from __future__ import annotations

from collections.abc import Iterator

from campaigns.fuzz.device_decoders import device_decoders
from campaigns.fuzz.file_decoders import estimate_decoder, file_decoders
from campaigns.fuzz.journal_decoder import compacted_decoder, history_decoder, journal_decoder, run_for_journal
from campaigns.fuzz.state_decoders import state_decoders
from campaigns.fuzz.trial import Decoder
from campaigns.fuzz.wire_decoders import wire_decoders


def quick_decoders() -> Iterator[Decoder]:
    """Yield the decoders whose good inputs need no run."""
    yield from file_decoders()
    yield from wire_decoders()
    yield from device_decoders()
    yield from state_decoders()


def decoders() -> Iterator[Decoder]:
    """Yield all decoders. Those of the files of a run come last: a short run is carried out for them."""
    yield from quick_decoders()
    files = run_for_journal()
    yield estimate_decoder(files.estimate)
    yield history_decoder(files.history)
    yield journal_decoder(files)
    yield compacted_decoder(files)
