"""Selection of runs of one machine in the history: by kind, verdict, time and text, one page at a time.

The verdict on a run is no column. The few combinations of the columns on which it depends (`agent.results.run_verdict`)
are read first, and a verdict is selected by those of the combinations that lead to it.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime

from sqlalchemy import ColumnElement, Select, and_, false, func, or_, select

from agent.history.schema import RUNS, StoredRun, utc_time
from agent.results.run_verdict import RunVerdict, verdict_of

_SEARCHED = (RUNS.c.run_id, RUNS.c.reason, RUNS.c.artefact, RUNS.c.position_set, RUNS.c.started_by, RUNS.c.software)
"""Columns in which a text is searched."""


@dataclass(frozen=True)
class RunSelection:
    """Conditions that the selected runs fulfil, each without effect if it is empty.

    `kinds` are the kinds and `verdicts` the names of the verdicts that are selected. The runs started at `since` or
    later and before `until`. `text` is contained, in upper or lower case, in the identity of the run, in its reason,
    artefact, position set, source or version of the software.
    """

    kinds: Sequence[str] = ()
    verdicts: Sequence[str] = ()
    since: datetime | None = None
    until: datetime | None = None
    text: str = ""


@dataclass(frozen=True)
class NumberedRun:
    """Run with its number among all runs of its machine, counted from 1 in the order in which the runs started."""

    number: int
    run: StoredRun


@dataclass(frozen=True)
class RunListing:
    """Page of the selected runs, the latest first.

    `total` is the number of all selected runs. `kinds` and `verdicts` map each kind and each verdict name that occurs
    among all runs of the machine to the number of these runs.
    """

    runs: Sequence[NumberedRun]
    total: int
    kinds: Mapping[str, int]
    verdicts: Mapping[str, int]


@dataclass(frozen=True)
class VerdictGroup:
    """Runs of one machine that agree in all columns on which the verdict depends, and the number of these runs."""

    kind: str
    state: str
    ended: bool
    accepted: bool | None
    decision: str | None
    count: int

    @property
    def verdict(self) -> RunVerdict:
        return verdict_of(self.kind, self.state, ended=self.ended, accepted=self.accepted, decision=self.decision)

    @property
    def condition(self) -> ColumnElement[bool]:
        ended = RUNS.c.ended.is_not(None) if self.ended else RUNS.c.ended.is_(None)
        texts = (RUNS.c.kind == self.kind, RUNS.c.state == self.state, RUNS.c.night == self.decision)
        return and_(ended, RUNS.c.accepted == self.accepted, *texts)


def groups_query(machine: str) -> Select[*tuple[object, ...]]:
    """Return the query of the columns of the `VerdictGroup`s of a machine."""
    columns = (RUNS.c.kind, RUNS.c.state, RUNS.c.ended.is_not(None), RUNS.c.accepted, RUNS.c.night)
    return select(*columns, func.count()).where(RUNS.c.machine == machine).group_by(*columns)


def counts(groups: Sequence[VerdictGroup]) -> tuple[Mapping[str, int], Mapping[str, int]]:
    """Return the numbers of runs by kind and by the name of the verdict."""
    kinds: Counter[str] = Counter()
    verdicts: Counter[str] = Counter()
    for group in groups:
        kinds[group.kind] += group.count
        verdicts[group.verdict.name] += group.count
    return dict(sorted(kinds.items())), dict(sorted(verdicts.items()))


def conditions(selection: RunSelection, groups: Sequence[VerdictGroup]) -> list[ColumnElement[bool]]:
    """Return the conditions of SQL that select the runs. `groups` are all groups of the machine."""
    found: list[ColumnElement[bool]] = []
    if selection.kinds:
        found.append(RUNS.c.kind.in_(selection.kinds))
    if selection.verdicts:
        found.append(or_(false(), *(one.condition for one in groups if one.verdict.name in selection.verdicts)))
    if selection.since is not None:
        found.append(RUNS.c.started >= utc_time(selection.since))
    if selection.until is not None:
        found.append(RUNS.c.started < utc_time(selection.until))
    if selection.text:
        found.append(or_(*(column.icontains(selection.text, autoescape=True) for column in _SEARCHED)))
    return found


def numbered_runs_query(machine: str) -> Select[*tuple[object, ...]]:
    """Return the query of the identities of all runs of a machine with their numbers."""
    number = func.row_number().over(order_by=(RUNS.c.started, RUNS.c.run_id)).label("number")
    return select(RUNS.c.run_id.label("numbered"), number).where(RUNS.c.machine == machine)
