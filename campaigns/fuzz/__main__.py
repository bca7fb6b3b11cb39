"""Trial of every decoder with mutated inputs. The last output line is JSON and lists what was raised outside the error
tree, what took too long, and how much the memory grew.

    python -m campaigns.fuzz [COUNT] [SEED] [SECONDS] [--workers 2] [--only TEXT]

COUNT inputs are tried per decoder, less for databases, which are read in a dozen ways. SEED selects other mutations;
`python -m campaigns.sum` sums the output of calls with different seeds. With SECONDS, no decoder takes longer than this
many s of wall time, and the numbers say how many inputs it had. With `--only`, only decoders whose names contain TEXT
are tried.
"""

from __future__ import annotations

import argparse
import json
import logging
import os
import sys
import warnings
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from time import perf_counter
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # must be set before numpy is imported

import structlog

from campaigns.fuzz.catalogue import decoder_at, decoder_count, decoders
from campaigns.fuzz.trial import Decoder, TrialResult, excesses, tried

COUNT = 1000


@dataclass(frozen=True)
class TrialExtent:
    """Inputs that each decoder gets: `count` of them, drawn with `seed`, in `seconds` s of wall time at most."""

    count: int
    seed: int
    seconds: float


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("count", type=int, nargs="?", default=COUNT, help="number of inputs of each decoder")
    parser.add_argument("seed", type=int, nargs="?", default=1)
    parser.add_argument("seconds", type=float, nargs="?", default=float("inf"), help="longest duration of each decoder")
    parser.add_argument("--workers", type=int, default=1, help="number of processes")
    parser.add_argument("--only", default="", metavar="TEXT", help="part of the names of the decoders to try")
    given = parser.parse_args(arguments)
    began = perf_counter()
    results: dict[str, dict[str, Any]] = {}
    for found, wrong in _found(TrialExtent(given.count, given.seed, given.seconds), given.only, given.workers):
        results[found.name] = {
            "read": found.read,
            "refused": found.refused,
            "cpu_s": round(found.cpu_s, 3),
            "slowest_cpu_s": round(found.slowest_s, 4),
            "grown_kib": found.grown_bytes // 1024,
            "failures": wrong,
        }
        tries = found.read + found.refused + len(found.failures)
        print(
            f"{found.name:36} {found.read:7} read {found.refused:7} refused {len(wrong):5} wrong"
            f" {1e6 * found.cpu_s / max(tries, 1):9.1f} µs each {found.slowest_s:8.3f} s slowest",
            flush=True,
        )
    result = {
        "passed": bool(results) and not any(found["failures"] for found in results.values()),
        "inputs": sum(found["read"] + found["refused"] for found in results.values()),
        "decoders": results,
        "seed": given.seed,
        "wall_seconds": round(perf_counter() - began, 1),
    }
    print(json.dumps(result, allow_nan=False))
    return 0 if result["passed"] else 1


def _found(extent: TrialExtent, only: str, workers: int) -> Iterator[tuple[TrialResult, list[str]]]:
    """Yield what each decoder did with its inputs, and what is wrong with it, in the order of the decoders."""
    if workers == 1:
        _be_quiet()
        yield from (_try_decoder(decoder, extent) for decoder in decoders() if only in decoder.name)
        return
    # Each process makes the decoders anew, because they hold open files. Those of a run, which come last and take
    # longest, begin first.
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn"), initializer=_be_quiet) as pool:
        trials = [pool.submit(_try_numbered, number, only, extent) for number in reversed(range(decoder_count()))]
        yield from (found for trial in reversed(trials) if (found := trial.result()) is not None)


def _be_quiet() -> None:
    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(logging.CRITICAL))
    logging.disable(logging.CRITICAL)
    warnings.simplefilter("error")  # as in the tests: a decoder that makes numpy warn has not judged its input


def _try_numbered(number: int, only: str, extent: TrialExtent) -> tuple[TrialResult, list[str]] | None:
    """Return what `_try_decoder` returns for the decoder with this number; None if it is not wanted."""
    decoder = decoder_at(number)
    return _try_decoder(decoder, extent) if only in decoder.name else None


def _try_decoder(decoder: Decoder, extent: TrialExtent) -> tuple[TrialResult, list[str]]:
    found = tried(decoder, round(decoder.share * extent.count), extent.seed, extent.seconds)
    return found, [*found.failures, *excesses(decoder, found)]


if __name__ == "__main__":
    sys.exit(main())
