"""Trial of one decoder with many mutated inputs."""

from __future__ import annotations

import signal
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from random import Random
from types import FrameType

from campaigns.fuzz.mutation import mutated
from drivers.errors import VolcalError
from twin.errors import TwinError

BOUND_S = 60.0
"""Longest time for one input. It is far above the usual one, so that a busy computer is not blamed on a decoder."""


@dataclass(frozen=True)
class Decoder:
    """Decoder of foreign bytes. `seeds` are good inputs. `decode` may raise the errors of the tree and `refusals`,
    which its callers handle themselves."""

    name: str
    seeds: Sequence[bytes]
    decode: Callable[[bytes], object]
    refusals: tuple[type[Exception], ...] = ()


@dataclass
class TrialResult:
    """Numbers of inputs of one decoder that were read and refused, and what else happened."""

    name: str
    read: int = 0
    refused: int = 0
    failures: list[str] = field(default_factory=list)


class Hang(BaseException):
    """Error raised in a decoder that exceeds its time. It is not an Exception, so that no decoder handles it."""


def tried(decoder: Decoder, count: int, seed: int) -> TrialResult:
    """Give `count` mutated inputs to the decoder, after its seeds, which it must read."""
    result, random = TrialResult(decoder.name), Random(f"{decoder.name} {seed}")  # noqa: S311  no secret
    allowed: tuple[type[Exception], ...] = (VolcalError, TwinError, *decoder.refusals)
    for good in decoder.seeds:
        decoder.decode(good)
    for number in range(count):
        data = mutated(random, random.choice(decoder.seeds))
        try:
            with time_limit(BOUND_S):
                decoder.decode(data)
        except allowed:
            result.refused += 1
        except (Exception, Hang) as error:  # noqa: BLE001  whatever it is, it is the finding
            place = traceback.extract_tb(error.__traceback__)[-1]
            told = f"input {number}: {type(error).__name__}: {str(error)[:120]} at {place.filename}:{place.lineno}"
            result.failures.append(f"{told}; {data[:200]!r}")
        else:
            result.read += 1
    return result


@contextmanager
def time_limit(bound_s: float) -> Iterator[None]:
    """Raise Hang in the main thread if the `with` block takes longer than `bound_s` of wall time."""

    def ring(_: int, __: FrameType | None) -> None:
        raise Hang(f"longer than {bound_s:g} s")

    former = signal.signal(signal.SIGALRM, ring)
    signal.setitimer(signal.ITIMER_REAL, bound_s)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, former)
