"""Trial of short calibrations, each with one or two faults at random instants. The output ends with one line of JSON.

    python -m campaigns.faults [--count 10000] [--first 0] [--seed 1] [--workers 2] [--only NIGHT | --known]

Each night is a whole run with probe check, qualification, measuring, identification, staging, activation and
verification on a simulated machine, with the table of an earlier run (the former table) active. One fault of the
controller, the cell, the computer or the wire begins at a random instant with a random size. Fifty nights have one
machine, whose undisturbed night ends with an accepted table, and share the time before their faults: the process is
forked at each of them. One night in 12 has a real link
(Modbus TCP, Modbus RTU or CAN) with a proxy that disturbs it. In a third of the nights a second fault begins: while the
run ends because of the first one, or in the resumed run. In the morning the faults are removed. Volcal is started
again, or its run is resumed, or given up; a resumed run is judged as the night was.

A night that violates an invariant is printed, one JSON object a line, with its seed and number; `--only NIGHT` plays it
again in this process and prints its whole record. `--first`, a multiple of 50, goes on with the nights of a seed after
earlier calls; `python -m campaigns.sum` sums their output. `--count` is a multiple of 50, too, or less than 50.
`--known` plays the nights that have once found a defect. The exit code is 0 only if no invariant is violated and at
least 85 % of the nights have reached their fault.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict
from multiprocessing import get_context
from time import perf_counter, process_time
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # must be set before numpy is imported

from campaigns.faults.excuses import EXCUSES, cannot_be_seen, not_shown
from campaigns.faults.invariants import INVARIANTS, violations
from campaigns.faults.night_record import NightRecord
from campaigns.faults.nights import (
    NIGHTS_PER_MACHINE,
    NightMachine,
    PlayedShare,
    Share,
    accepted_machine,
    drawn_seed,
    play_nights,
    play_share,
)
from campaigns.faults.planned_night import KNOWN_DURATION_S, KNOWN_NIGHTS, PlannedNight, plan_night

REACHED_SHARE = 0.85
"""Smallest share of the nights that must reach their fault: a trial whose runs end before it shows nothing."""
NOT_SHOWN_SHARE = 0.1
"""Largest share of the resumed nights whose undisturbed proof may show no effect, beside a single one: twice the
probability with which a proof of a table that works fails."""


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=10000, help="number of nights, a multiple of 50 or less than 50")
    parser.add_argument("--first", type=int, default=0, help="number of the first night, a multiple of 50")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--workers", type=int, default=2, help="number of processes")
    chosen = parser.add_mutually_exclusive_group()
    chosen.add_argument("--only", type=int, metavar="NIGHT", help="play this night alone, in this process")
    chosen.add_argument("--known", action="store_true", help="play the nights that have once found a defect")
    given = parser.parse_args(arguments)
    if given.first < 0 or given.first % NIGHTS_PER_MACHINE:
        parser.error(f"--first must be a multiple of {NIGHTS_PER_MACHINE}: so many nights have one machine")
    if given.count < 1 or (given.count > NIGHTS_PER_MACHINE and given.count % NIGHTS_PER_MACHINE):
        parser.error(f"--count must be a multiple of {NIGHTS_PER_MACHINE} or less: so many nights have one machine")
    began = perf_counter()
    records: list[NightRecord] = []
    cpu_s = 0.0
    refused = 0
    alone: list[tuple[PlannedNight, NightMachine]] = []
    if given.known:
        alone = [(one, NightMachine(drawn_seed(one.seed, one.night), KNOWN_DURATION_S)) for one in KNOWN_NIGHTS]
    elif given.only is not None:
        alone = [(plan_night(given.seed, given.only), accepted_machine(given.seed, given.only))]
    for planned, machine in alone:
        records += play_nights([planned], machine, forked=False)
        print(json.dumps(asdict(records[-1]), default=str))
        cpu_s = process_time()
    for played in () if alone else _played(given.seed, given.first, given.count, given.workers):
        records += played.records
        cpu_s += played.cpu_s
        refused += played.machine.refused
        for night in played.records:
            wrong = violations(night)
            if wrong:
                print(
                    json.dumps({"seed": night.seed, "night": night.night, **_summary(night), "violated": wrong}),
                    flush=True,
                )
    result = summarise(records)
    if not alone:  # nights that are played again are not a part of their seed
        result |= {"seed": given.seed, "first": given.first}
    result |= {
        "machines_refused": refused,
        "cpu_s": round(cpu_s, 1),
        "wall_seconds": round(perf_counter() - began, 1),
    }
    print(json.dumps(result, allow_nan=False))
    return 0 if result["passed"] else 1


def _played(seed: int, first: int, count: int, workers: int) -> Iterator[PlayedShare]:
    end = first + count
    shares = [
        Share(seed, begin, min(begin + NIGHTS_PER_MACHINE, end)) for begin in range(first, end, NIGHTS_PER_MACHINE)
    ]
    if workers == 1:
        yield from map(play_share, shares)
        return
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        yield from pool.map(play_share, shares)


def _summary(night: NightRecord) -> dict[str, Any]:
    return {
        "kind": night.kind,
        "second": night.second,
        "at_s": night.at_s,
        "size": night.size,
        "state": night.state,
        "reason": night.reason,
        "morning": night.morning_says,
        **({"not_resumed": night.resume_refused} if night.resume_refused else {}),
        **({} if night.later is None else {"later": _summary(night.later)}),
    }


def summarise(records: Sequence[NightRecord]) -> dict[str, Any]:
    """Return the totals over all nights: faults by kind, ends, how many have reached their fault, and the number of
    violations of each invariant."""
    violated = Counter(name for night in records for name in violations(night))
    reached = sum(night.reached for night in records)
    resumed = sum(night.later is not None for night in records)
    excused = {name: sum(excuse(night.last) for night in records) for name, excuse in EXCUSES.items()}
    return {
        "passed": bool(records)
        and not violated
        and reached >= REACHED_SHARE * len(records)
        and excused[not_shown.__name__] <= 1 + NOT_SHOWN_SHARE * resumed,
        "nights": len(records),
        "by_group": dict(sorted(Counter(night.group for night in records).items())),
        "by_kind": dict(sorted(Counter(night.kind for night in records).items())),
        "ended": dict(sorted(Counter(night.state for night in records).items())),
        "reached": reached,
        "with_a_second_fault": sum(night.last.second_begun for night in records),
        "resumed": resumed,
        "resumed_twice": sum(night.last.resumed > 1 for night in records),
        "resumed_to": dict(sorted(Counter(night.last.state for night in records if night.later is not None).items())),
        "resumption_refused": sum(bool(night.last.resume_refused) for night in records),
        "accepted": sum(night.last.accepted for night in records),
        "left_to_the_morning": sum(night.active != night.former and not night.accepted for night in records),
        **excused,
        "cannot_be_seen": dict(Counter(night.last.unseen for night in records if cannot_be_seen(night.last))),
        "violations": {name: violated[name] for name in INVARIANTS},
    }


if __name__ == "__main__":
    sys.exit(main())
