"""Overview of a plant: many machines with many nights each in one PostgreSQL database.

A server of its own is started on loopback and filled with synthetic runs by COPY. The overview (`volcal history plant`)
is then read and computed as often as `--times`; the smallest wall time counts. The last column is the ratio to a plant
with a tenth of the nights: the work should depend on the number of machines alone.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import sys
import time
from contextlib import closing
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import psycopg

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "system"))
from postgresql_server import Server, running_server

from agent.history.plant import RECENT_RUNS, plant_summaries
from agent.history.store import HistoryStore
from twin.arrays import Array

SCATTER_UM = 0.3
FIRST_NIGHT = datetime(2024, 1, 1, 2, tzinfo=UTC)
COLUMNS = (
    "machine, run_id, kind, started, ended, state, reason, software, started_by, artefact, position_set, balls, "
    "touches, machine_minutes, ve_before_um, ve_before_sigma_um, acting_um, held_out_before_um, held_out_after_um, "
    "accepted, night, settings_sha256, digest"
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--machines", type=int, default=1000, help="number of machines")
    parser.add_argument("--nights", type=int, default=1000, help="number of runs of each machine")
    parser.add_argument("--times", type=int, default=5, help="number of readings, of which the fastest counts")
    chosen = parser.parse_args()
    with running_server() as server:
        few_s = overview_s(server, chosen.machines, max(chosen.nights // 10, 1), chosen.times)
        many_s = overview_s(server, chosen.machines, chosen.nights, chosen.times)
    print(f"overview {many_s:.2f} s; ratio to a tenth of the nights: {many_s / few_s:.2f}")


def overview_s(server: Server, machines: int, nights: int, times: int) -> float:
    """Return the smallest wall time in s of reading the latest runs of all machines and of their summaries."""
    with closing(HistoryStore(server.address("bench"))) as store:
        begun = time.perf_counter()
        size_mb = fill(server, machines, nights)
        print(f"{machines} machines × {nights} nights: {size_mb:.0f} MB in {time.perf_counter() - begun:.0f} s")
        readings, fits, now = [], [], FIRST_NIGHT + timedelta(days=nights)
        for _ in range(times):
            begun = time.perf_counter()
            runs = store.recent_runs(RECENT_RUNS, now)
            readings.append(time.perf_counter() - begun)
            found = [one.as_json() for one in plant_summaries(runs, now)]
            fits.append(time.perf_counter() - begun - readings[-1])
            if len(found) != machines:
                raise SystemExit(f"{len(found)} machines instead of {machines}")
    print(f"  read {min(readings):.2f} s, trends {min(fits):.2f} s")
    return min(map(sum, zip(readings, fits, strict=True)))


def fill(server: Server, machines: int, nights: int) -> float:
    """Replace the stored runs by synthetic ones. Return the size of the table with its indexes in MB."""
    rng = np.random.default_rng(1)
    with psycopg.connect(**server.login, autocommit=True) as connection:
        connection.execute("TRUNCATE volcal_runs CASCADE")
        with connection.cursor().copy(f"COPY volcal_runs ({COLUMNS}) FROM STDIN") as copy:
            for night in range(nights):
                copy.write(synthetic_night(night, rng.normal(0.0, SCATTER_UM, machines)))
        connection.execute("VACUUM ANALYZE volcal_runs")
        row = connection.execute("SELECT pg_total_relation_size('volcal_runs')").fetchone()
    return 0.0 if row is None else float(row[0]) / 1e6


def synthetic_night(night: int, scatter_um: Array) -> str:
    """Return the lines of COPY for one night: a run of each machine. The VE of six machines in seven drifts."""
    at = (FIRST_NIGHT + timedelta(days=night)).isoformat()
    lines = []
    for machine, scatter in enumerate(scatter_um):
        ve = 10.0 + machine % 7 * 0.01 * night + scatter
        state, decision = ("faulted", "\\N") if (machine + night) % 199 == 0 else ("complete", "confirmed")
        lines.append(
            f"mill-{machine:04d}\t{night:06d}\tnightly\t{at}\t{at}\t{state}\t\t0.1.0\ttimer\tbar\tS3.csv\t264\t792\t"
            f"12.3\t{ve:.3f}\t0.5\t{0.3 * ve:.3f}\t2.5\t\\N\t\\N\t{decision}\t{'0' * 64}\t{'0' * 64}\n"
        )
    return "".join(lines)


if __name__ == "__main__":
    main()
