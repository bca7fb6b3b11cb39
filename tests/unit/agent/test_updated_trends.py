"""Trends that are kept up to date run by run are those of a full fit of all runs."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing
from dataclasses import fields, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from sqlalchemy import make_url

from agent.history.cached_trends import CachedTrends
from agent.history.database_url import DatabaseAddress
from agent.history.overview import VOLUMETRIC, trends_of
from agent.history.run_row import RunRows
from agent.history.schema import StoredRun
from agent.history.store import HistoryStore
from agent.history.trends import Trend
from agent.results.run_outcome import Decision
from agent.settings.history import HistorySettings

MACHINE = "mine"
SETTINGS = HistorySettings(parameter_tolerances={"EXX[1]": 12.0}, ve_tolerance_um=6.0)
NAMES = ("EXX[1]", "EXX[2]", "EYX[2]", "A0Z")
RUNS = 24
LATE = (5, 17)
"""Runs that are stored after later ones, as `volcal history sync` does after a database was away."""


@pytest.fixture
def store(tmp_path: Path) -> Iterator[HistoryStore]:
    address = DatabaseAddress(make_url(f"sqlite:///{tmp_path}/history.sqlite"), MACHINE, 60.0)
    with closing(HistoryStore(address)) as opened:
        yield opened


def rows(number: int, rng: np.random.Generator, *, measured: bool = True, **columns: Any) -> RunRows:
    """Return a run with or without an estimate."""
    at = (datetime(2026, 3, 1, 2, tzinfo=UTC) + timedelta(days=number + 0.2 * rng.uniform())).isoformat()
    left_out = ("digest", "parameters", "temperatures", "decisions")
    run: dict[str, Any] = dict.fromkeys(one.name for one in fields(StoredRun) if one.name not in left_out)
    run |= {"machine": MACHINE, "run_id": f"{number:04d}", "kind": "calibrate", "started": at, "ended": at}
    run |= {"state": "complete", "reason": "", "software": "0", "started_by": "timer", "artefact": "bar"}
    run |= {"position_set": "S3", "balls": 9, "touches": 45, "machine_minutes": 12.3, "settings_sha256": "0" * 64}
    run |= {"held_out_before_um": 2.0 + rng.normal(0.0, 0.1), "acting_um": 5.0 + 0.1 * number, **columns}
    values = rng.normal(0.2 * number + 9.0 * (number > 12), 1.0, len(NAMES)).tolist()
    if measured:
        run |= {"ve_before_um": 10.0 + rng.normal(), "ve_before_sigma_um": 0.5}
    parameters = [
        {"name": name, "place": place, "value": value, "standard_uncertainty": 1.0, "unit": "µm"}
        for place, (name, value) in enumerate(zip(NAMES, values, strict=True))
    ]
    return RunRows(run, tuple(parameters) if measured else (), (), ())


def same(some: tuple[Trend, ...], others: tuple[Trend, ...]) -> bool:
    return [one.as_json() for one in some] == [one.as_json() for one in others]


@pytest.mark.parametrize("seed", range(3))
def test_updated_trends_are_those_of_a_full_fit(store: HistoryStore, seed: int) -> None:
    """Also if runs arrive late, if the verdict and a figure of a run change, and if a run found the machine changed."""
    rng = np.random.default_rng(seed)
    stored: list[RunRows] = []
    for night in range(RUNS):
        decision = Decision.FULL_NEEDED.value if rng.uniform() < 0.1 else None
        accepted = [None, True, False][int(rng.integers(3))]
        stored.append(rows(night, rng, measured=rng.uniform() < 0.7, accepted=accepted, night=decision))
    cached = CachedTrends()
    order = [*(night for night in range(RUNS) if night not in LATE), *LATE]
    for place, night in enumerate(order):
        written = [stored[night]]
        if rng.uniform() < 0.3:
            changed = stored[int(rng.choice(order[: place + 1]))]
            anew = {"accepted": rng.uniform() < 0.5, "acting_um": 5.0 + rng.uniform()}
            written.append(replace(changed, run={**changed.run, **anew}))
        for one in written:
            store.put(one)
            found = cached.refreshed(store, SETTINGS).trends
            assert same(found, trends_of(store.runs(MACHINE), SETTINGS))
    assert any(trend.drift is not None and trend.drift.steps for trend in found)
    assert any(trend.alarms for trend in found)


def test_only_series_that_got_a_value_are_fitted_again(store: HistoryStore) -> None:
    rng = np.random.default_rng(1)
    for night in range(10):
        store.put(rows(night, rng))
    cached = CachedTrends()
    before = {trend.series.name: trend for trend in cached.refreshed(store, SETTINGS).trends}
    store.put(rows(10, rng, measured=False))
    after = cached.refreshed(store, SETTINGS).trends
    assert {trend.series.name for trend in after if before[trend.series.name] is not trend} == set(VOLUMETRIC[1:])
    tolerant = SETTINGS.model_copy(update={"warn_nights": 1})
    assert not {id(trend) for trend in cached.refreshed(store, tolerant).trends} & {id(trend) for trend in after}
