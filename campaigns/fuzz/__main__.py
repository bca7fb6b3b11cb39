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
import os
import sys
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from time import perf_counter
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # must be set before numpy is imported

from campaigns.fuzz.catalogue import decoder_count, decoders
from campaigns.fuzz.mutated_inputs import TrialExtent, be_quiet, try_decoder, try_numbered
from campaigns.fuzz.trial import TrialResult

COUNT = 1000


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("count", type=int, nargs="?", default=COUNT, help="number of inputs of each decoder")
    parser.add_argument("seed", type=int, nargs="?", default=1)
    parser.add_argument("seconds", type=float, nargs="?", default=float("inf"), help="longest duration of each decoder")
    parser.add_argument("--workers", type=int, default=1, help="number of processes")
    parser.add_argument("--only", default="", metavar="TEXT", help="part of the names of the decoders to try")
    given = parser.parse_args(arguments)
    began = perf_counter()
    results: list[tuple[TrialResult, list[str]]] = []
    for found, wrong in _found(TrialExtent(given.count, given.seed, given.seconds), given.only, given.workers):
        results.append((found, wrong))
        tries = found.read + found.refused + len(found.failures)
        print(
            f"{found.name:36} {found.read:7} read {found.refused:7} refused {len(wrong):5} wrong"
            f" {1e6 * found.cpu_s / max(tries, 1):9.1f} µs each {found.slowest_s:8.3f} s slowest",
            flush=True,
        )
    result = summarise(results) | {"seed": given.seed, "wall_seconds": round(perf_counter() - began, 1)}
    print(json.dumps(result, allow_nan=False))
    return 0 if result["passed"] else 1


def summarise(results: Sequence[tuple[TrialResult, Sequence[str]]]) -> dict[str, Any]:
    """Return the numbers of all decoders from what each did with its inputs and what is wrong with it."""
    return {
        "passed": bool(results) and not any(wrong for _, wrong in results),
        "inputs": sum(found.read + found.refused for found, _ in results),
        "decoders": {
            found.name: {
                "read": found.read,
                "refused": found.refused,
                "cpu_s": round(found.cpu_s, 3),
                "slowest_cpu_s": round(found.slowest_s, 4),
                "grown_kib": found.grown_bytes // 1024,
                "failures": list(wrong),
            }
            for found, wrong in results
        },
    }


def _found(extent: TrialExtent, only: str, workers: int) -> Iterator[tuple[TrialResult, list[str]]]:
    """Yield what each decoder did with its inputs, and what is wrong with it, in the order of the decoders."""
    if workers == 1:
        be_quiet()
        yield from (try_decoder(decoder, extent) for decoder in decoders() if only in decoder.name)
        return
    # Each process makes the decoders anew, because they hold open files. Those of a run, which come last and take
    # longest, begin first.
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn"), initializer=be_quiet) as pool:
        trials = [pool.submit(try_numbered, number, only, extent) for number in reversed(range(decoder_count()))]
        yield from (found for trial in reversed(trials) if (found := trial.result()) is not None)


if __name__ == "__main__":
    sys.exit(main())
