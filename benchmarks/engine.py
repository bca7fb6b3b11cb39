"""Time that the agent's engine, which carries out the steps of a plan, needs for a step in addition to the time of the
device.

The time is measured once with two durable database commits per step in the journal, and once without a journal.
"""

from __future__ import annotations

import statistics
import tempfile
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from time import perf_counter
from typing import Any

from agent.execution.engine import Engine
from agent.execution.journal import Journal
from agent.execution.steps import MoveTo, Plan
from drivers.clock import VirtualClock

STEPS = 2000


def moves(count: int, stamps: list[float]) -> Plan[None]:
    """Yield the steps of a plan with `count` moves. Append the clock time to `stamps` whenever the next step is
    requested.
    """
    for number in range(count):
        yield MoveTo(f"station-1/az090-el045/ball-{number:04d}/touch-2/above", (1.0, 2.0, 3.0 + number))
        stamps.append(perf_counter())


def median_step_us(engine: Engine) -> float:
    stamps: list[float] = []
    engine.run(moves(STEPS, stamps))
    return statistics.median(b - a for a, b in pairwise(stamps)) * 1e6


def commit_us(directory: Path) -> float:
    """Return the median time in µs of a single minimal durable database commit on the disk of `directory`.

    This time is the lower limit for the time of a step that is committed to the journal.
    """
    journal = Journal(directory)
    connection = journal._connection
    connection.execute("CREATE TABLE bare (n INTEGER PRIMARY KEY, t TEXT)")
    times = []
    for number in range(STEPS // 4):
        start = perf_counter()
        connection.execute("INSERT INTO bare VALUES (?, ?)", (number, "x" * 120))
        times.append(perf_counter() - start)
    journal.close()
    return statistics.median(times) * 1e6


def run() -> dict[str, float]:
    actions: dict[type, Callable[[Any], Any]] = {MoveTo: lambda _: None}
    dry = median_step_us(Engine(actions))
    with tempfile.TemporaryDirectory() as folder:
        journal = Journal(Path(folder) / "journal")
        run_journal = journal.start_run("bench", "calibrate", {}, "0", VirtualClock())
        durable = median_step_us(Engine(actions, run_journal))
        journal.close()
        bare = commit_us(Path(folder) / "bare")
    return {
        "dry_step_us": dry,
        "durable_step_us": durable,
        "bare_commit_us": bare,
        "durable_step_in_bare_commits": durable / bare,
    }


def main() -> None:
    result = run()
    print(f"engine step, dry run        {result['dry_step_us']:8.1f} µs   (at most 15)")
    print(f"engine step, two commits    {result['durable_step_us']:8.1f} µs   (at most 500)")
    print(f"one bare durable commit     {result['bare_commit_us']:8.1f} µs")
    print(f"step in bare commits        {result['durable_step_in_bare_commits']:8.2f} ×")


if __name__ == "__main__":
    main()
