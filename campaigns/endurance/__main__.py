"""Endurance of the service: many runs, one after another, in one service process, with clients that read and abort.

    python -m campaigns.endurance [--runs 1000] [--minutes MINUTES] [--csv endurance.csv]

The machine is simulated and is reached over Modbus TCP and CAN. Of ten runs one is a calibration, four are
verifications, one is aborted while it measures, and reset, and four activate a stored table: that from before the last
calibration that wrote one, and then that of this calibration, twice. After each run clients read what the page reads,
and the report of the run if it is complete, and an event stream is opened and dropped. All runs but the latest are
compacted. With --minutes no run begins after so many minutes of wall time, but for the first ten.

The output ends with one line of JSON. The exit code is 0 only if memory, file handles and threads do not grow with the
number of runs, every run has ended as it should, old runs were compacted and have their reports and tables, the machine
had no collision, and the service ends on SIGTERM.
"""

from __future__ import annotations

import argparse
import json
import logging
import os
import sys
from collections.abc import Sequence
from dataclasses import asdict
from datetime import timedelta
from pathlib import Path
from time import perf_counter
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # must be set before numpy is imported

import numpy as np
import structlog

from agent.execution.journal_reader import open_journal
from agent.execution.journal_rows import RunRow
from agent.execution.run_record import read_record
from agent.reports.run_report import report_of
from benchmarks.places import memory_directory, write_csv
from campaigns.endurance.process_use import Use, growth_per_run
from campaigns.fortnight.incidents import FIRST_EVENING
from campaigns.fortnight.plant import FortnightPlant
from campaigns.fortnight.play import SHORT
from campaigns.fortnight.service_process import STATUS_POLL_S, ServiceHost, wait_for
from twin.units import S_PER_MIN

KINDS = ("calibrate", "backup", "staged", "verify", "verify", "aborted", "verify", "backup", "staged", "verify")
"""Kinds of ten runs. One is aborted while it measures. `backup` activates the table from before the last calibration
that wrote one, and `staged` that of this calibration."""
RESTORED = ("backup", "staged")
EVERY = len(KINDS)
WHOLE_RUNS = 5
"""Latest runs that are not compacted."""
MOST_WAITING = 3
"""Largest number of other runs that are not compacted yet when the service is stopped: the next run interrupts it."""
LARGEST_GROWTH_MB = 0.1
"""Largest growth of the memory per run that is no leak: a service of 200 MB has doubled after six years of nights. The
event log, which has a limit, is full after some 25 runs and grows by 0.2 MB per run until then, so the growth is judged
well only with 60 runs or more."""
READ_AFTER_A_RUN = ("/api/status", "/api/runs", "/api/machine", "/api/tables", "/metrics", "/api/page/trends", "/")

Row = dict[str, Any]


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=1000)
    parser.add_argument("--minutes", type=float, default=float("inf"), help="wall time after which no run begins")
    parser.add_argument("--csv", type=Path, help="write one row for each run")
    given = parser.parse_args(arguments)
    if given.runs < EVERY:
        parser.error(f"--runs must be at least {EVERY}, so that each kind of run occurs")
    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(logging.ERROR))
    began = perf_counter()
    plant = FortnightPlant(SHORT.scenario, lambda _: 1)
    with memory_directory("endurance") as directory, ServiceHost(Path(directory), plant.ready, SHORT.changes) as host:
        host.set_time(FIRST_EVENING)
        settings = host.config.read_text(encoding="utf-8")
        compacting = f"[history]\nwhole_runs = {WHOLE_RUNS}\nwhole_days = 0.0\n"
        host.config.write_text(settings.replace("[history]\n", compacting), encoding="utf-8")
        host.serve()
        rows: list[Row] = []
        wrote: list[str] = []
        ends = began + S_PER_MIN * given.minutes
        while len(rows) < given.runs and (len(rows) < EVERY or perf_counter() < ends):
            rows.append(_run(host, len(rows), wrote))
        ended = host.stop()
        with open_journal(host.state) as journal:
            compacted = [row for row in journal.runs() if row.run in journal.compacted_runs()]
        lost = [row.run_id for row in compacted if row.state == "complete" and not _is_whole(host.state, row)]
    plant.switch_off()
    if given.csv is not None:
        write_csv(rows, given.csv)
    result = verdict(rows, len(compacted), lost, ended, plant.collisions)
    print(json.dumps(result | {"wall_seconds": round(perf_counter() - began, 1)}, allow_nan=False))
    return 0 if result["passed"] else 1


def _run(host: ServiceHost, number: int, wrote: list[str]) -> Row:
    """Carry out one run, let the clients read, and return what the service then uses. The identity of a calibration
    that has written a table is appended to `wrote`."""
    host.set_time(FIRST_EVENING + timedelta(days=number))
    kind = KINDS[number % EVERY]
    aborted = kind == "aborted"
    if kind in RESTORED:
        asked = host.post("/api/tables/restore", {"run_id": wrote[-1], "role": kind, "source": "page"})
    else:
        request = {"kind": "verify" if aborted else kind, "source": "page", "consent": True}
        asked = host.post("/api/start", request | ({} if kind == "calibrate" else {"stations": [1]}))
    run_id = asked.raise_for_status().json()["run_id"]
    if aborted:
        wait_for(lambda: host.status()["state"] == "measuring", "the measurement", STATUS_POLL_S)
        host.post("/api/abort", {"reason": "a person walks in"}, token=False).raise_for_status()
    state = host.at_rest(run_id)["state"]
    if state in ("aborted", "faulted"):
        host.post("/api/reset").raise_for_status()
    # Without a pause between the runs, their reports would be rendered ever later, until the service is stopped.
    report = () if aborted else (f"/api/runs/{run_id}/report",)
    host.read((*READ_AFTER_A_RUN, f"/api/runs/{run_id}", *report))
    if kind == "calibrate":
        kept = host.get("/api/tables")["kept"]
        if any((one["run_id"], one["role"]) == (run_id, "staged") for one in kept):
            wrote.append(run_id)
    use = Use.of(host.pid, host.state)
    row = {"run": number + 1, "kind": kind, "state": state, **asdict(use)}
    print(f"{number + 1:4d} {kind:9s} {state:9s} {use.memory_mb:6.1f} MB, {use.handles} handles, ", end="")
    print(f"{use.threads} threads, {use.disk_mb:.1f} MB on disk, {use.cpu_s:.1f} s", flush=True)
    return row


def _is_whole(state: Path, row: RunRow) -> bool:
    """Return True if a complete and compacted run has its report and, after a calibration, its table, and if its
    report can be made again."""
    folder = state / row.run_id
    report = (folder / "report.html").read_text(encoding="utf-8") if (folder / "report.html").is_file() else ""
    report_of(read_record(state, row.run_id))
    has_table = row.kind != "calibrate" or (folder / "table.csv").is_file()
    return report.rstrip().endswith("</html>") and has_table


def verdict(rows: Sequence[Row], compacted: int, lost: Sequence[str], exit_code: int, collisions: int) -> Row:
    """Return the growth per run and what the service has left: the number of compacted runs, those of them that have
    lost their report or table, its exit code and the number of collisions; and whether all is as it should be."""
    grown = judged(rows)
    tidy = compacted >= len(rows) - WHOLE_RUNS - MOST_WAITING
    return {
        **grown,
        "passed": grown["passed"] and tidy and not lost and exit_code == 0 and collisions == 0,
        "compacted": compacted,
        "lost": list(lost),
        "exit_code": exit_code,
        "collisions": collisions,
    }


def judged(rows: Sequence[Row]) -> Row:
    """Return the growth per run, and whether it is none."""
    columns = {name: np.array([row[name] for row in rows], dtype=float) for name in ("memory_mb", "disk_mb", "cpu_s")}
    half = len(rows) // 2
    disk = np.diff(columns["disk_mb"], prepend=0.0)
    kinds = sorted({str(row["kind"]) for row in rows})

    def per_run(values: np.ndarray, kind: str, part: slice) -> float:
        chosen = [float(value) for row, value in zip(rows[part], values[part], strict=True) if row["kind"] == kind]
        return round(float(np.median(chosen)), 3) if chosen else 0.0

    growth_mb = growth_per_run(columns["memory_mb"], EVERY)
    counts = {name: [int(row[name]) for row in rows] for name in ("handles", "threads")}
    # the pools of threads and handles are filled in the first half
    steady = all(max(values[half:]) <= max(values[:half]) for values in counts.values())
    ended_well = all(row["state"] == ("aborted" if row["kind"] == "aborted" else "complete") for row in rows)
    return {
        "passed": ended_well and steady and growth_mb <= LARGEST_GROWTH_MB,
        "runs": len(rows),
        "ended_well": ended_well,
        "memory_mb": [round(float(columns["memory_mb"][index]), 1) for index in (0, half, -1)],
        "memory_growth_mb_per_run": round(growth_mb, 4),
        "handles": [max(counts["handles"][:half]), max(counts["handles"][half:])],
        "threads": [max(counts["threads"][:half]), max(counts["threads"][half:])],
        "disk_mb_per_run": {
            kind: [per_run(disk, kind, slice(half)), per_run(disk, kind, slice(half, None))] for kind in kinds
        },
        "cpu_s_per_run": {
            kind: [
                per_run(np.diff(columns["cpu_s"], prepend=0.0), kind, part) for part in (slice(half), slice(half, None))
            ]
            for kind in kinds
        },
    }


if __name__ == "__main__":
    sys.exit(main())
