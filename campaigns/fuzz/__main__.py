"""Trial of every decoder with mutated inputs. The last output line is JSON and lists what was raised outside the error
tree and what took too long.

python -m campaigns.fuzz [COUNT] [SEED]

COUNT inputs are tried per decoder, for journals a tenth of them. SEED selects other mutations.
"""

from __future__ import annotations

import json
import logging
import sys
from collections.abc import Iterator, Sequence
from time import perf_counter

import structlog

from campaigns.fuzz.file_decoders import estimate_decoder, file_decoders
from campaigns.fuzz.journal_decoder import journal_decoder, run_for_journal
from campaigns.fuzz.trial import Decoder, tried
from campaigns.fuzz.wire_decoders import wire_decoders

COUNT = 1000
JOURNAL_SHARE = 0.1
"""Share of inputs that a journal gets: one takes half a second, because it is read in a dozen ways."""


def main(arguments: Sequence[str]) -> int:
    count = int(arguments[0]) if arguments else COUNT
    seed = int(arguments[1]) if len(arguments) > 1 else 1
    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(logging.CRITICAL))
    logging.disable(logging.CRITICAL)
    began, decoders = perf_counter(), {}
    for decoder, inputs in _shares(count):
        found = tried(decoder, inputs, seed)
        decoders[found.name] = {"read": found.read, "refused": found.refused, "failures": found.failures}
        print(
            f"{found.name:34} {found.read:7} read {found.refused:7} refused {len(found.failures):5} wrong", flush=True
        )
    result = {
        "passed": not any(found["failures"] for found in decoders.values()),
        "decoders": decoders,
        "wall_seconds": round(perf_counter() - began, 1),
    }
    print(json.dumps(result, allow_nan=False))
    return 0 if result["passed"] else 1


def _shares(count: int) -> Iterator[tuple[Decoder, int]]:
    for decoder in (*file_decoders(), *wire_decoders()):
        yield decoder, count
    journal, estimate = run_for_journal()
    yield estimate_decoder(estimate), count
    yield journal_decoder(journal), round(JOURNAL_SHARE * count)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
