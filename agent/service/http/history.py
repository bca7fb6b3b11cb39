"""Read-only endpoints for the history of runs and alarms, one page at a time. The client of the history database is
imported at the first request for runs."""

from __future__ import annotations

from contextlib import closing
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Annotated

from fastapi import APIRouter, Query
from pydantic import AfterValidator, AwareDatetime

from agent.results.run_verdict import RUNNING
from agent.service.http.app_state import AppStateDependency
from agent.service.http.history_models import (
    HistoryAlarm,
    HistoryAlarmList,
    HistoryRun,
    HistoryRunList,
    PlantMachine,
    PlantView,
)
from agent.service.http.models import AlarmView, VerdictView
from agent.service.http.problems import DOCUMENTED
from agent.service.state.alarm_list import alarm_page
from drivers.clock import utc_timestamp

if TYPE_CHECKING:
    from agent.history.run_selection import NumberedRun

router = APIRouter(prefix="/api/history", tags=["reading"], responses=DOCUMENTED)


def _utc(moment: datetime) -> datetime:
    """Return the same instant in UTC. Raise ValueError if it lies outside the calendar there."""
    try:
        return moment.astimezone(UTC)
    except OverflowError:
        raise ValueError("the instant lies outside the calendar") from None


Limit = Annotated[int, Query(ge=1, le=200)]
Offset = Annotated[int, Query(ge=0, le=10_000_000)]
Moment = Annotated[AwareDatetime, AfterValidator(_utc)]
Words = Annotated[list[Annotated[str, Query(max_length=40)]], Query(max_length=20)]


@router.get("/runs")
def history_runs(
    app_state: AppStateDependency,
    limit: Limit = 50,
    offset: Offset = 0,
    kind: Words = [],  # noqa: B006  FastAPI copies it
    verdict: Words = [],  # noqa: B006
    since: Moment | None = None,
    until: Moment | None = None,
    text: Annotated[str, Query(max_length=100)] = "",
) -> HistoryRunList:
    """Return runs of this machine, the latest first: those of the given kinds and verdicts, started from `since` until
    before `until`, with `text` in their identity, reason, artefact, position set, source or software."""
    from agent.history.database_url import database_address  # noqa: PLC0415
    from agent.history.run_selection import RunSelection  # noqa: PLC0415
    from agent.history.store import HistoryStore  # noqa: PLC0415
    from agent.history.sync import sync_missing  # noqa: PLC0415

    settings = app_state.settings()
    with closing(HistoryStore(database_address(settings))) as store:
        journaled = sync_missing(settings.state_directory, store)
        machine = store.address.machine
        found = store.listing(machine, RunSelection(kind, verdict, since, until, text), limit, offset)
    running = app_state.archive.running()
    runs = [_run_view(one, running, journaled) for one in found.runs]
    return HistoryRunList(
        machine=machine, runs=runs, total=found.total, kinds=dict(found.kinds), verdicts=dict(found.verdicts)
    )


@router.get("/alarms")
def history_alarms(app_state: AppStateDependency, limit: Limit = 50, offset: Offset = 0) -> HistoryAlarmList:
    """Return the alarms of the journal, those of all runs and those between runs, the latest first."""
    found = alarm_page(app_state.archive.directory, limit, offset)
    alarms = [
        HistoryAlarm(
            since=one.since,
            until=one.until,
            run_id=one.run_id,
            kind=one.kind,
            alarm=AlarmView.model_validate(one.alarm, from_attributes=True),
        )
        for one in found.alarms
    ]
    return HistoryAlarmList(alarms=alarms, total=found.total)


@router.get("/plant")
def history_plant(app_state: AppStateDependency, limit: Limit = 50, offset: Offset = 0) -> PlantView:
    """Return the machines that share the history database, those that need attention first."""
    from agent.history.database_url import database_address  # noqa: PLC0415
    from agent.history.plant import RECENT_RUNS, plant_summaries  # noqa: PLC0415
    from agent.history.store import HistoryStore  # noqa: PLC0415
    from agent.history.sync import sync_missing  # noqa: PLC0415

    settings = app_state.settings()
    with closing(HistoryStore(database_address(settings))) as store:
        sync_missing(settings.state_directory, store)
        now = datetime.fromisoformat(utc_timestamp())
        runs = store.recent_runs(RECENT_RUNS, now)
    own, running = store.address.machine, app_state.archive.running()
    found = plant_summaries(runs, now, None if running is None else (own, running))
    machines = [PlantMachine.model_validate(one.as_json()) for one in found[offset : offset + limit]]
    return PlantView(machine=own, machines=machines, total=len(found))


def _run_view(numbered: NumberedRun, running: str | None, journaled: frozenset[str]) -> HistoryRun:
    from agent.history.export import run_document  # noqa: PLC0415

    run = numbered.run
    verdict = RUNNING if run.ended is None and run.run_id == running else run.verdict
    document = run_document(run, whole=False)
    return HistoryRun.model_validate(
        {
            **document,
            "number": numbered.number,
            "verdict": VerdictView(**verdict.as_json()),
            "ve_um": run.ve_before_um,
            "vce_um": run.acting_um,
            "report": run.ended is not None and run.run_id in journaled,
        }
    )
