"""Drifts of foreign machines over many nights: how often they are told, on machines with and without a drift, and how
often the stated 95 % limits contain the true error meanwhile.

    python -m campaigns.foreign.drifts --histories 200 [--case still] [--case "EBX 0.8"]

A case is `still`, `walk` (of everything), or an error of ISO 230-1 with its change per night in µm or µrad over the
travel. Each history is a machine of its own. The output ends with one line of JSON.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # must be set before numpy is imported

import numpy as np

from campaigns.foreign.nights import Change, NightScore, drift, fused_nights, still, walk_of_everything

NIGHTS = 20
CASES = ("still", "walk", "EBX 0.4", "EBX 0.8", "EBX 1.6", "EXX 1.5", "B0Z 0.5")
_SEED = 100


@dataclass(frozen=True)
class DriftHistory:
    """Nights of one machine. `told` is the first night in which a drift was told, with the error named, and `last` the
    error, the rate and its standard uncertainty in the last night; None if no drift was told. `held` is the share of
    the nights whose limits contained the true error, and `worst` the largest ratio of true and predicted error."""

    told: tuple[int, str] | None
    last: tuple[str, float, float] | None
    held: float
    worst: float
    not_fitting: int

    @classmethod
    def of(cls, nights: Sequence[NightScore]) -> DriftHistory:
        found = [(night.number, night.fit.drift) for night in nights]
        told = [(number, one.suspects[0].error) for number, one in found if one is not None]
        last = found[-1][1]
        return cls(
            told=told[0] if told else None,
            last=None
            if last is None
            else (last.suspects[0].error, last.suspects[0].rate, last.suspects[0].standard_uncertainty),
            held=float(np.mean([night.held for night in nights])),
            worst=max(night.ratio for night in nights),
            not_fitting=sum(not night.fit.fits for night in nights),
        )


def change_of(case: str) -> Change:
    """Return the change of the machine in a case."""
    if case in ("still", "walk"):
        return {"still": still, "walk": walk_of_everything}[case]
    error, rate = case.split()
    micro = 1e-6 if error in ("A0Z", "B0Z", "C0Y") or error[1] in "ABC" else 1e-3
    return drift(error, micro * float(rate))


def history(case: str, number: int) -> DriftHistory:
    """Return the history of machine `number` in a case."""
    return DriftHistory.of(fused_nights(change_of(case), NIGHTS, seed=_SEED + number))


def summary(case: str, histories: Sequence[DriftHistory]) -> dict[str, object]:
    """Return shares in per cent, the median of the first night in which a drift was told, and means."""
    told = [one.told for one in histories if one.told is not None]
    right = [error for _, error in told if error == case.split(maxsplit=1)[0]]
    rates = [one.last for one in histories if one.last is not None and one.last[0] == case.split(maxsplit=1)[0]]
    return {
        "histories": len(histories),
        "told_percent": round(100.0 * len(told) / len(histories), 1),
        "right_at_first_percent": round(100.0 * len(right) / len(histories), 1),
        "right_at_last_percent": round(100.0 * len(rates) / len(histories), 1),
        "median_night": float(np.median([night for night, _ in told])) if told else None,
        "mean_rate": round(float(np.mean([rate for _, rate, _ in rates])), 3) if rates else None,
        "mean_standard_uncertainty": round(float(np.mean([sigma for *_, sigma in rates])), 3) if rates else None,
        "limits_hold_percent": round(100.0 * float(np.mean([one.held for one in histories])), 1),
        "mean_worst_ratio": round(float(np.mean([one.worst for one in histories])), 2),
        "worst_ratio": round(max(one.worst for one in histories), 2),
        "nights_not_fitting": sum(one.not_fitting for one in histories),
    }


def main() -> int:
    """Carry out the cases of the command line."""
    parser = argparse.ArgumentParser(prog="python -m campaigns.foreign.drifts", description="Drifts over many nights.")
    parser.add_argument("--histories", type=int, default=40, help="machines of each case")
    parser.add_argument("--case", action="append", help="one of the cases; all if not given")
    parser.add_argument("--workers", type=int, help="processes; as many as processors if not given")
    given = parser.parse_args()
    found = {}
    with ProcessPoolExecutor(given.workers) as workers:
        for case in given.case or CASES:
            found[case] = summary(case, list(workers.map(partial(history, case), range(given.histories), chunksize=2)))
            print(f"{case}: {json.dumps(found[case])}", flush=True)
    print(json.dumps(found))
    return 0


if __name__ == "__main__":
    sys.exit(main())
