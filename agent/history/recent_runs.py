"""The latest runs of every machine in the history, with the few columns that an overview of the plant needs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from datetime import datetime

from sqlalchemy import CTE, ColumnElement, Select, func, select, union_all

from agent.history.schema import RUNS
from agent.results.run_verdict import RunVerdict, verdict_of


@dataclass(frozen=True)
class RecentRun:
    """Columns of one of the latest runs of a machine; `agent.history.schema.StoredRun` says what they mean."""

    machine: str
    run_id: str
    kind: str
    started: datetime
    ended: datetime | None
    state: str
    accepted: bool | None
    night: str | None
    ve_before_um: float | None
    ve_before_sigma_um: float | None
    acting_um: float | None
    held_out_before_um: float | None
    held_out_after_um: float | None
    table_bank: int | None
    table_crc32: str | None

    @property
    def verdict(self) -> RunVerdict:
        return verdict_of(
            self.kind, self.state, ended=self.ended is not None, accepted=self.accepted, decision=self.night
        )


def recent_runs_query(count: int, latest: datetime) -> Select[*tuple[object, ...]]:
    """Return the query of the latest `count` runs of each machine that started at `latest` or before, and of the latest
    `count` that are dated after it, the oldest run of a machine first.

    The names of the machines are found by one step in the index for each machine, and the runs of a machine are a range
    of the index by start. The work therefore depends on the number of machines, and not on that of their runs.
    """
    first = select(func.min(RUNS.c.machine).label("machine")).cte("machines", recursive=True)
    following = select(func.min(RUNS.c.machine)).where(RUNS.c.machine > first.c.machine).scalar_subquery()
    machines = first.union_all(select(following).where(first.c.machine.is_not(None)))
    found = union_all(
        _latest_runs(machines, count, lambda started: started <= latest),
        _latest_runs(machines, count, lambda started: started > latest),
    ).subquery()
    return select(found).order_by(found.c.machine, found.c.started, found.c.run_id)


def _latest_runs(
    machines: CTE, count: int, dated: Callable[[ColumnElement[datetime]], ColumnElement[bool]]
) -> Select[*tuple[object, ...]]:
    """Return the query of the latest `count` runs of each of the `machines` among those that are `dated` so."""
    starts = RUNS.alias("starts")
    of_machine = (starts.c.machine == machines.c.machine, dated(starts.c.started))
    latest_first = select(starts.c.started).where(*of_machine).order_by(starts.c.started.desc()).limit(1)
    oldest = select(func.min(starts.c.started)).where(*of_machine)
    since = func.coalesce(latest_first.offset(count - 1).scalar_subquery(), oldest.scalar_subquery())
    columns = [RUNS.c[one.name] for one in fields(RecentRun)]
    chosen = (RUNS.c.machine == machines.c.machine) & (RUNS.c.started >= since) & dated(RUNS.c.started)
    return select(*columns).select_from(machines.join(RUNS, chosen))
