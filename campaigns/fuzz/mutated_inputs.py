"""Mutated inputs for one decoder, in a process that may be one of several."""

from __future__ import annotations

import logging
import warnings
from dataclasses import dataclass

import structlog

from campaigns.fuzz.catalogue import decoder_at
from campaigns.fuzz.trial import Decoder, TrialResult, excesses, tried


@dataclass(frozen=True)
class TrialExtent:
    """Inputs that each decoder gets: `count` of them, drawn with `seed`, in `seconds` s of wall time at most."""

    count: int
    seed: int
    seconds: float


def be_quiet() -> None:
    """Let nothing be logged in this process, and let warnings be errors."""
    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(logging.CRITICAL))
    logging.disable(logging.CRITICAL)
    warnings.simplefilter("error")  # as in the tests: a decoder that makes numpy warn has not judged its input


def try_numbered(number: int, only: str, extent: TrialExtent) -> tuple[TrialResult, list[str]] | None:
    """Return what `try_decoder` returns for the decoder with this number; None if it is not wanted."""
    decoder = decoder_at(number)
    return try_decoder(decoder, extent) if only in decoder.name else None


def try_decoder(decoder: Decoder, extent: TrialExtent) -> tuple[TrialResult, list[str]]:
    """Return what the decoder did with its inputs, and what is wrong with it."""
    found = tried(decoder, round(decoder.share * extent.count), extent.seed, extent.seconds)
    return found, [*found.failures, *excesses(decoder, found)]
