"""Trial of every decoder with mutated inputs. The last output line is JSON and lists what was raised outside the error
tree, what took too long, and how much the memory grew.

python -m campaigns.fuzz [COUNT] [SEED] [SECONDS]

COUNT inputs are tried per decoder, for journals a tenth of them. SEED selects other mutations. With SECONDS, no decoder
takes longer than this many s of wall time, and the numbers say how many inputs it had.
"""

from __future__ import annotations

import json
import logging
import sys
import warnings
from collections.abc import Iterator, Sequence
from time import perf_counter
from typing import Any

import structlog

from campaigns.fuzz.device_decoders import device_decoders
from campaigns.fuzz.file_decoders import estimate_decoder, file_decoders
from campaigns.fuzz.journal_decoder import journal_decoder, run_for_journal
from campaigns.fuzz.trial import Decoder, excesses, tried
from campaigns.fuzz.wire_decoders import wire_decoders

COUNT = 1000
JOURNAL_SHARE = 0.1
"""Share of inputs that a journal gets: one takes half a second, because it is read in a dozen ways."""


def main(arguments: Sequence[str]) -> int:
    count = int(arguments[0]) if arguments else COUNT
    seed = int(arguments[1]) if len(arguments) > 1 else 1
    seconds = float(arguments[2]) if len(arguments) > 2 else float("inf")
    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(logging.CRITICAL))
    logging.disable(logging.CRITICAL)
    warnings.simplefilter("error")  # as in the tests: a decoder that makes numpy warn has not judged its input
    began = perf_counter()
    decoders: dict[str, dict[str, Any]] = {}
    for decoder, inputs in _shares(count):
        found = tried(decoder, inputs, seed, seconds)
        wrong = [*found.failures, *excesses(decoder, found)]
        tries = found.read + found.refused + len(found.failures)
        decoders[found.name] = {
            "read": found.read,
            "refused": found.refused,
            "per_cpu_second": round(tries / max(found.cpu_s, 1e-6)),
            "slowest_cpu_s": round(found.slowest_s, 4),
            "grown_kib": found.grown_bytes // 1024,
            "failures": wrong,
        }
        print(
            f"{found.name:36} {found.read:7} read {found.refused:7} refused {len(wrong):5} wrong"
            f" {found.slowest_s:8.3f} s slowest",
            flush=True,
        )
    result = {
        "passed": not any(found["failures"] for found in decoders.values()),
        "inputs": sum(found["read"] + found["refused"] for found in decoders.values()),
        "decoders": decoders,
        "wall_seconds": round(perf_counter() - began, 1),
    }
    print(json.dumps(result, allow_nan=False))
    return 0 if result["passed"] else 1


def _shares(count: int) -> Iterator[tuple[Decoder, int]]:
    for decoder in (*file_decoders(), *wire_decoders(), *device_decoders()):
        yield decoder, count
    journal, estimate = run_for_journal()
    yield estimate_decoder(estimate), count
    yield journal_decoder(journal), round(JOURNAL_SHARE * count)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
