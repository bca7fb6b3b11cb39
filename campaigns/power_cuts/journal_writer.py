"""Process whose system calls are recorded: it writes a journal and a file, and acknowledges each record on its standard
output as soon as the agent would. Then it compacts the run, which must lose nothing.

    python -m campaigns.power_cuts.journal_writer DIRECTORY [--synchronous NORMAL]
"""

from __future__ import annotations

import argparse
import os
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from agent.execution.journal import Journal
from agent.execution.states import RunState
from agent.execution.steps import ActivateBank, MoveTo, Record, TouchTowards
from agent.files import write_all_atomically, write_atomically
from agent.history.retention import compact, due_runs
from agent.settings.history import HistorySettings
from drivers.clock import VirtualClock
from drivers.roles import TableImage, Touch

STATE, RESULT = "state", "result.txt"
BALLS = 12
ROUNDS = 3
RESULT_LINES = 2000
BEGUN, FINISHED, BALL, TABLE, STATED, VERSION = "begun", "finished", "ball", "table", "state", "version"
ESTIMATE, COMPACTED = "estimate", "compacted"
LATE = datetime(2100, 1, 1, tzinfo=UTC)
RUN_ID, ESTIMATE_FILE = "run", "estimate.json"
ESTIMATE_TEXT = '{"parameters": [' + ", ".join(f"{number / 7.0}" for number in range(1000)) + "]}\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("directory", type=Path)
    parser.add_argument("--synchronous", default="", help="mode of SQLite that replaces the journal's own")
    given = parser.parse_args()
    journal = Journal(given.directory / STATE)
    if given.synchronous:
        journal._connection.execute(f"PRAGMA synchronous={given.synchronous}")
    clock = VirtualClock()
    run = journal.start_run(RUN_ID, "calibrate", {"machine": "power-cuts"}, "volcal", clock)
    run.origin({"machine": "power-cuts"})
    run.begun()
    for number in range(ROUNDS):
        for ball in range(BALLS):
            key = f"round-{number}/ball-{ball}"
            for step in (MoveTo(f"{key}/move", (0.0, 1.0, 2.0)), TouchTowards(f"{key}/touch", (1.0, 1.0, 2.0), 5.0)):
                run.begin(step)
                _acknowledge(BEGUN, step.key)
                clock.sleep(1.0)
                touch = Touch((0.5, 1.0, 2.0)) if isinstance(step, TouchTowards) else None
                run.finish(step, touch, begun=True)
                _acknowledge(FINISHED, step.key)
            centre = Record(f"{key}/centre", "ball", {"centre_mm": [0.5, 1.0, 2.0]})
            run.finish(centre, None, begun=False)
            _acknowledge(BALL, centre.key)
        counts = np.full((20, 15, 15, 3), number, dtype=np.int32)
        run.table("staged", number + 1, TableImage((0.0, 0.0, 0.0), (10.0, 10.0, 10.0), 1e-4, counts))
        _acknowledge(TABLE, str(number + 1))
        run.begin(ActivateBank(f"round-{number}/activate", number + 1))
        _acknowledge(BEGUN, f"round-{number}/activate")
        write_atomically(given.directory / RESULT, f"version {number}\n" * RESULT_LINES)
        _acknowledge(VERSION, str(number))
    run.estimate(ESTIMATE_TEXT)
    run.state(RunState.COMPLETE, final=True)
    _acknowledge(STATED, RunState.COMPLETE.value)
    write_all_atomically(given.directory / STATE / RUN_ID, {ESTIMATE_FILE: ESTIMATE_TEXT})
    _acknowledge(ESTIMATE, RUN_ID)
    later = journal.start_run("later", "verify", {"machine": "power-cuts"}, "volcal", clock)
    later.begin(TouchTowards("touch", (1.0, 1.0, 2.0), 5.0))  # it could be resumed, so the first run no longer can
    _acknowledge(BEGUN, "touch")
    for row in due_runs(given.directory / STATE, HistorySettings(whole_runs=1, whole_days=0.0), LATE):
        compact(given.directory / STATE, row, write=True)
        _acknowledge(COMPACTED, row.run_id)
    os._exit(0)  # without the checkpoint of a connection that is closed


def _acknowledge(kind: str, value: str) -> None:
    os.write(1, f"{kind} {value}\n".encode())


if __name__ == "__main__":
    main()
