"""Trial of one decoder with many mutated inputs."""

from __future__ import annotations

import resource
import signal
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from math import inf
from pathlib import Path
from random import Random
from time import monotonic, process_time
from types import FrameType

from campaigns.fuzz.mutation import mutated
from drivers.errors import VolcalError
from twin.errors import TwinError

BOUND_S = 60.0
"""Longest time for one input. It is far above the usual one, so that a busy computer is not blamed on a decoder."""
PAGE_BYTES = resource.getpagesize()
WARM_UP = 5
"""Memory is compared with that after one part in this many of the inputs: the first fill caches and load modules."""

LARGEST_GROWTH_BYTES = 64 * 2**20
"""A decoder that keeps a few hundred bytes of each input exceeds this in the long form; caches of modules do not."""


@dataclass(frozen=True)
class Decoder:
    """Decoder of foreign bytes. `seeds` are good inputs. `decode` may raise the errors of the tree and `refusals`,
    which its callers handle themselves. `cpu_bound_s` is the longest CPU time in s that one input may take, and `share`
    the share of the inputs that this decoder gets."""

    name: str
    seeds: Sequence[bytes]
    decode: Callable[[bytes], object]
    refusals: tuple[type[Exception], ...] = ()
    cpu_bound_s: float = 1.0
    share: float = 1.0

    @property
    def allowed(self) -> tuple[type[Exception], ...]:
        """Errors with which an input may be refused."""
        return (VolcalError, TwinError, *self.refusals)


@dataclass
class TrialResult:
    """Numbers of inputs of one decoder that were read and refused, and what else happened.

    `cpu_s` is the CPU time of all inputs in s, `slowest_s` that of the slowest, which `slowest` shows, and
    `grown_bytes` the growth of the resident memory after the warm-up.
    """

    name: str
    read: int = 0
    refused: int = 0
    failures: list[str] = field(default_factory=list)
    cpu_s: float = 0.0
    slowest_s: float = 0.0
    slowest: str = ""
    grown_bytes: int = 0


class Hang(BaseException):
    """Error raised in a decoder that exceeds its time. It is not an Exception, so that no decoder handles it."""


def tried(decoder: Decoder, count: int, seed: int, seconds: float = inf) -> TrialResult:
    """Give `count` mutated inputs to the decoder, or as many as it takes in `seconds` s of wall time, after its seeds.
    A seed that it does not read is a failure, like an error outside the tree."""
    ends_s = monotonic() + seconds
    result, random = TrialResult(decoder.name), Random(f"{decoder.name} {seed}")  # noqa: S311  no secret
    allowed = decoder.allowed
    with hang_detection() as time_limit:
        for number, good in enumerate(decoder.seeds):
            try:
                time_limit(BOUND_S)
                decoder.decode(good)
            except (Exception, Hang) as error:  # noqa: BLE001  the other decoders are tried nevertheless
                result.failures.append(_told(f"seed {number}", error, good))
        settled = resident_bytes()
        for number in range(count):
            if monotonic() > ends_s:
                break
            if number == count // WARM_UP:
                settled = resident_bytes()
            data = mutated(random, random.choice(decoder.seeds))
            began_s = process_time()
            try:
                time_limit(BOUND_S)
                decoder.decode(data)
            except allowed:
                result.refused += 1
            except (Exception, Hang) as error:  # noqa: BLE001  whatever it is, it is the finding
                result.failures.append(_told(f"input {number}", error, data))
            else:
                result.read += 1
            taken_s = process_time() - began_s
            result.cpu_s += taken_s
            if taken_s > result.slowest_s:
                result.slowest_s, result.slowest = taken_s, f"input {number}: {data[:200]!r}"
    result.grown_bytes = resident_bytes() - settled
    return result


def _told(name: str, error: BaseException, data: bytes) -> str:
    """Return the failure of the input `name` in words: the error, its place, and the beginning of the input."""
    place = traceback.extract_tb(error.__traceback__)[-1]
    what = f"{type(error).__name__}: {str(error)[:120]}"
    return f"{name}: {what} at {place.filename}:{place.lineno}; {data[:200]!r}"


def excesses(decoder: Decoder, found: TrialResult) -> Iterator[str]:
    """Yield what the decoder used too much of: CPU time of one input, memory over all."""
    if found.slowest_s > decoder.cpu_bound_s:
        yield f"{found.slowest_s:.1f} s of CPU, {decoder.cpu_bound_s:g} s allowed, for {found.slowest}"
    if found.grown_bytes > LARGEST_GROWTH_BYTES:
        yield f"the memory grew by {found.grown_bytes // 2**20} MiB"


def resident_bytes() -> int:
    """Return the resident memory of this process in bytes."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * PAGE_BYTES


@contextmanager
def hang_detection() -> Iterator[Callable[[float], None]]:
    """Yield a function `time_limit(bound_s)` for the `with` block. After its call, Hang is raised in the main thread
    unless it is called again, or the block ends, within `bound_s` of wall time. The handler is installed once, because
    its installation takes longer than a fast decoder."""
    bound_s = inf

    def ring(_: int, __: FrameType | None) -> None:
        raise Hang(f"longer than {bound_s:g} s")

    def time_limit(seconds: float) -> None:
        nonlocal bound_s
        bound_s = seconds
        signal.setitimer(signal.ITIMER_REAL, seconds)

    former = signal.signal(signal.SIGALRM, ring)
    try:
        yield time_limit
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, former)
