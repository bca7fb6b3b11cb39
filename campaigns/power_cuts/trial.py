"""Power cuts after each system call of the recorded process, and what is there afterwards."""

from __future__ import annotations

import random
import shutil
import sqlite3
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from agent.execution.journal import Journal
from agent.execution.journal_reader import has_journal, open_journal
from agent.execution.journal_schema import FILE_NAME
from agent.files import read_text
from campaigns.power_cuts.journal_writer import (
    BALL,
    BEGUN,
    COMPACTED,
    ESTIMATE,
    ESTIMATE_FILE,
    ESTIMATE_TEXT,
    FINISHED,
    RESULT,
    RESULT_LINES,
    RUN_ID,
    STATE,
    STATED,
    TABLE,
    VERSION,
)
from campaigns.power_cuts.recorded_calls import Acknowledged, FileCall, Synced
from campaigns.power_cuts.volatile_disk import CUTS, VolatileDisk
from drivers.errors import VolcalError


@dataclass
class CutResult:
    """Number of cuts, of calls and of synchronisations, and what was lost, in words."""

    calls: int = 0
    synced: int = 0
    acknowledged: int = 0
    cuts: Counter[str] = field(default_factory=Counter)
    lost: list[str] = field(default_factory=list)


def cut_everywhere(
    calls: Sequence[FileCall], directory: Path, work: Path, seed: int, every: int = 1, ignored_syncs: Sequence[str] = ()
) -> CutResult:
    """Cut the power after each `every`-th call, in each way of `CUTS`, and look for what was acknowledged before.

    `directory` is that of the recorded process, and `work` an empty one. The synchronisation of the paths
    `ignored_syncs` has no effect, as if it were left out.
    """
    rng = random.Random(seed)  # noqa: S311  no secret
    disk = VolatileDisk(directory, ignored_syncs)
    result = CutResult(calls=len(calls), synced=sum(isinstance(call, Synced) for call in calls))
    told: list[Acknowledged] = []
    for number, call in enumerate(calls):
        disk.apply(call)
        if isinstance(call, Acknowledged):
            told.append(call)
        if number % every:
            continue
        for kept in CUTS:
            place = work / "cut"
            disk.cut(place, kept, rng)
            result.cuts[kept] += 1
            result.lost += [f"after call {number}, {kept} of the rest is kept: {text}" for text in lost_of(place, told)]
            shutil.rmtree(place)
    result.acknowledged = len(told)
    return result


def lost_of(place: Path, told: Sequence[Acknowledged]) -> list[str]:
    """Return in words what is not in the directory `place`, although it was acknowledged, or what is damaged there."""
    lost = [*_lost_of_result(place, told), *_lost_of_estimate(place, told)]
    records = [one for one in told if one.kind != VERSION]
    if not has_journal(place / STATE):
        return [*lost, "there is no journal"] if records else lost
    try:
        Journal(place / STATE).close()  # as the next start does; it also ends an interrupted creation
        found = _journaled(place)
    except (VolcalError, sqlite3.Error) as error:
        return [*lost, f"the journal cannot be read: {error}"]
    return [*lost, *(f"{one.kind} {one.value} is lost" for one in records if one not in found)]


def _journaled(place: Path) -> set[Acknowledged]:
    connection = sqlite3.connect(place / STATE / FILE_NAME)
    try:
        [(verdict,)] = connection.execute("PRAGMA integrity_check").fetchall()
    finally:
        connection.close()
    if verdict != "ok":
        raise sqlite3.DatabaseError(verdict)
    found: set[Acknowledged] = set()
    with open_journal(place / STATE) as journal:
        for run in journal.runs():
            for step in journal.steps(run.run):
                found.add(Acknowledged(BEGUN, step.key))
                if step.finished_s is not None:
                    found.add(Acknowledged(FINISHED, step.key))
            found |= {Acknowledged(BALL, ball.key) for ball in journal.balls(run.run)}
            found |= {Acknowledged(TABLE, str(table.bank)) for table in journal.tables(run.run)}
            found.add(Acknowledged(STATED, run.state))
            found |= {
                Acknowledged(ESTIMATE, run.run_id) for text in journal.estimates(run.run) if text == ESTIMATE_TEXT
            }
            if run.run in journal.compacted_runs():
                found.add(Acknowledged(COMPACTED, run.run_id))
    return found


def _lost_of_estimate(place: Path, told: Sequence[Acknowledged]) -> list[str]:
    if not any(one.kind == ESTIMATE for one in told):
        return []
    try:
        text = read_text(place / STATE / RUN_ID / ESTIMATE_FILE)
    except VolcalError as error:
        return [f"the estimate cannot be read: {error}"]
    return [] if text == ESTIMATE_TEXT else ["the estimate is not complete"]


def _lost_of_result(place: Path, told: Sequence[Acknowledged]) -> list[str]:
    versions = [int(one.value) for one in told if one.kind == VERSION]
    path = place / RESULT
    if not path.exists():
        return ["the result is lost"] if versions else []
    lines = path.read_text(errors="replace").splitlines()
    if len(lines) != RESULT_LINES or len(set(lines)) != 1:
        return [f"the result is not complete: {len(lines)} lines"]
    version = int(lines[0].removeprefix("version "))
    return [f"the result has version {version} again"] if versions and version < versions[-1] else []
