"""Trends of many runs: read from the history database for the first time, after one more run, and with nothing new.
The list of runs: one page of it, also with a selection.

The runs are synthetic: the parameters of the case study drift and scatter from night to night. They are stored in a
SQLite database in a temporary directory, and the trends of all series are fitted, in one thread. Times are those of the
processor. The last line compares the search for steps (sudden changes) with that for a quarter of the runs.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import fields
from datetime import UTC, datetime, timedelta
from functools import partial
from itertools import count
from time import process_time
from typing import Any

import numpy as np
from sqlalchemy import make_url

from agent.history.cached_trends import CachedTrends
from agent.history.database_url import DatabaseAddress
from agent.history.run_row import RunRows
from agent.history.run_selection import RunSelection
from agent.history.schema import StoredRun
from agent.history.store import HistoryStore
from agent.planning.case_file import CASE_STUDY, load_case
from agent.settings.history import HistorySettings
from twin.monitoring import find_steps

MACHINE = "bench"
FIRST_NIGHT = datetime(2024, 1, 1, 2, tzinfo=UTC)
CALIBRATED_EVERY = 30
_NO_COLUMNS = ("digest", "parameters", "temperatures", "decisions")
NOISE, WALK = 0.3, 0.05  # standard deviations, as shares of the standard uncertainty


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=1000, help="number of runs in the history")
    runs = parser.parse_args().runs
    with tempfile.TemporaryDirectory() as folder:
        address = DatabaseAddress(make_url(f"sqlite:///{folder}/history.sqlite"), MACHINE, 60.0)
        store = HistoryStore(address)
        nights = synthetic_nights(np.random.default_rng(1))
        for _ in range(runs):
            store.put(next(nights))
        cached, settings = CachedTrends(), HistorySettings()
        first = seconds(lambda: cached.refreshed(store, settings))
        store.put(next(nights))
        after_one = seconds(lambda: cached.refreshed(store, settings))
        unchanged = seconds(lambda: cached.refreshed(store, settings))
        selections = (RunSelection(), RunSelection(verdicts=("accepted",), text="timer"))
        pages = [min(seconds(partial(store.listing, MACHINE, one, 25, 0)) for _ in range(5)) for one in selections]
        store.close()
    print(
        f"{runs} runs: first reading {first:.2f} s, after one more run {after_one:.2f} s, "
        f"with nothing new {unchanged:.3f} s"
    )
    print(f"page of 25 runs: {1e3 * pages[0]:.0f} ms, selected by verdict and text {1e3 * pages[1]:.0f} ms")
    few, many = (min(seconds(partial(steps_of, length)) for _ in range(9)) for length in (runs // 4, runs))
    print(f"search for steps: {1e3 * many:.1f} ms for {runs} nights; ratio to a quarter of them: {many / few:.1f}")


def synthetic_nights(rng: np.random.Generator) -> Iterator[RunRows]:
    """Yield the rows of one run after the other, one per night."""
    names = load_case(CASE_STUDY).machine.model.names
    level = rng.normal(0.0, 4.0, len(names))
    for night in count():
        level = level + WALK * rng.normal(size=len(names))
        seen = level + NOISE * rng.normal(size=len(names))
        ve = 10.0 + 0.02 * night + rng.normal(0.0, 0.3)
        at = (FIRST_NIGHT + timedelta(days=night)).isoformat()
        run: dict[str, Any] = dict.fromkeys(one.name for one in fields(StoredRun) if one.name not in _NO_COLUMNS)
        run |= {"machine": MACHINE, "run_id": f"{night:06d}", "started": at, "ended": at, "state": "complete"}
        run |= {"kind": "nightly" if night % CALIBRATED_EVERY else "calibrate", "reason": "", "software": "0"}
        run |= {"started_by": "timer", "artefact": "bar", "position_set": "S3.csv", "balls": 264, "touches": 792}
        run |= {"machine_minutes": 12.3, "ve_before_um": ve, "ve_before_sigma_um": 0.5, "acting_um": 0.3 * ve}
        run |= {"held_out_after_um": 0.2 * ve, "accepted": True, "settings_sha256": "0" * 64}
        parameters = tuple(
            {"name": name, "place": place, "value": value, "standard_uncertainty": 1.0, "unit": "µm"}
            for place, (name, value) in enumerate(zip(names, seen.tolist(), strict=True))
        )
        yield RunRows(run, parameters, (), ())


def steps_of(length: int) -> tuple[float, ...]:
    values = np.random.default_rng(2).normal(size=length) + 5.0 * (np.arange(length) > 0.6 * length)
    return find_steps(np.arange(float(length)), values, np.ones(length))


def seconds(work: Callable[[], object]) -> float:
    start = process_time()
    work()
    return process_time() - start


if __name__ == "__main__":
    main()
