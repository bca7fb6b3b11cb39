"""Every decoder of foreign bytes that the program has."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import cache

from campaigns.fuzz.device_decoders import device_decoders
from campaigns.fuzz.estimate_decoder import estimate_decoder
from campaigns.fuzz.file_decoders import file_decoders
from campaigns.fuzz.journal_decoder import (
    RunFiles,
    compacted_decoder,
    history_decoder,
    journal_decoder,
    run_for_journal,
)
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
    yield from (decoder_at(number) for number in range(decoder_count()))


def decoder_count() -> int:
    """Return the number of all decoders."""
    return len(_quick()) + len(OF_RUN)


def decoder_at(number: int) -> Decoder:
    """Return the decoder with this number, counted from 0."""
    quick = _quick()
    return quick[number] if number < len(quick) else OF_RUN[number - len(quick)](_run())


OF_RUN: Sequence[Callable[[RunFiles], Decoder]] = (
    lambda files: estimate_decoder(files.estimate),
    lambda files: history_decoder(files.history),
    journal_decoder,
    compacted_decoder,
)
"""Functions that return the decoders of the files of a run."""


@cache
def _quick() -> Sequence[Decoder]:
    return tuple(quick_decoders())


@cache
def _run() -> RunFiles:
    return run_for_journal()
