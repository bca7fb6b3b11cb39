"""Read-only endpoints for status, journal, machine and plan. They never access a device or the engine, which carries
out the steps of a run."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Query
from fastapi.responses import FileResponse

from agent.model_files import position_set_names
from agent.planning.job_preparation import prepare_job
from agent.service.http.app_state import AppState, AppStateDependency
from agent.service.http.models import RunDetails, RunPage, RunSummary, StatusView, TableList, TableView, status_view
from agent.service.http.problems import DOCUMENTED
from agent.service.state.live_view import machine_facts
from twin.artefact.position_set import SET_EXPRESSIONS

router = APIRouter(prefix="/api", tags=["reading"], responses=DOCUMENTED)

Limit = Annotated[int, Query(ge=1, le=1000)]


@router.get("/status")
def status(app_state: AppStateDependency) -> StatusView:
    """Return the complete status of the service at one instant."""
    return status_now(app_state)


@router.get("/runs")
def runs(
    app_state: AppStateDependency, limit: Annotated[int, Query(ge=1, le=200)] = 50, before: str | None = None
) -> RunPage:
    """Return the runs in the journal, the latest first."""
    found = [RunSummary(**document) for document in app_state.archive.runs(limit, before)]
    return RunPage(runs=found, before=found[-1].run_id if len(found) == limit else None)


@router.get("/runs/{run_id}")
def run(app_state: AppStateDependency, run_id: str) -> RunDetails:
    """Return one run with its request, gates, decisions and final state."""
    return RunDetails(**app_state.archive.run(run_id))


@router.get("/runs/{run_id}/balls")
def balls(app_state: AppStateDependency, run_id: str) -> list[dict[str, Any]]:
    """Return the measured ball centres of a run in the order of measurement."""
    return app_state.archive.balls(run_id)


@router.get("/runs/{run_id}/temperatures")
def temperatures(app_state: AppStateDependency, run_id: str) -> list[dict[str, Any]]:
    """Return the temperature readings of a run. The machine time of each reading is in minutes."""
    return app_state.archive.temperatures(run_id)


@router.get("/runs/{run_id}/events")
def events(
    app_state: AppStateDependency, run_id: str, limit: Limit = 500, after: Annotated[int, Query(ge=0)] = 0
) -> list[dict[str, Any]]:
    """Return the recorded events of a run. `after` is the number of the last event that the client already has."""
    return app_state.archive.events(run_id, limit, after)


@router.get("/runs/{run_id}/estimate")
def estimate(app_state: AppStateDependency, run_id: str) -> dict[str, Any]:
    """Return the content of the estimate file of a run."""
    return app_state.archive.estimate(run_id)


@router.get("/runs/{run_id}/report", response_class=FileResponse)
def report(app_state: AppStateDependency, run_id: str) -> FileResponse:
    """Return the report of a run as self-contained HTML."""
    return FileResponse(app_state.archive.report(run_id), media_type="text/html", filename=f"volcal-{run_id}.html")


@router.get("/tables")
def tables(app_state: AppStateDependency, limit: Limit = 100) -> TableList:
    """Return the active bank of the controller and the stored compensation tables."""
    now = app_state.control.status()
    kept = [TableView(**document) for document in app_state.archive.tables(limit)]
    return TableList(active_bank=now.active_bank, written_not_active=now.written_not_active, kept=kept)


@router.get("/machine")
def machine(app_state: AppStateDependency) -> dict[str, Any]:
    """Return the axis limits, the stations, the artefact and the available position sets."""
    settings = app_state.settings()
    base = app_state.config.parent
    return {
        **machine_facts(prepare_job(settings, base)),
        "position_sets": [*SET_EXPRESSIONS, *position_set_names(base)],
    }


@router.get("/plan")
def plan(app_state: AppStateDependency) -> dict[str, Any]:
    """Return the path of the run in progress as computed by its preflight. Between runs, return the path of the next
    calibration.

    The document has the same format as the data of the plan preview (docs/reference/http.md).
    """
    return app_state.live_view.plan(app_state.settings(), app_state.config.parent)


def status_now(app_state: AppState) -> StatusView:
    """Return the status of the service with the number of its last event.

    The number of the last event is read before the status. An event that occurs between the two readings is therefore
    sent to the client a second time and never lost.
    """
    number = app_state.event_log.last_number
    return status_view(app_state.control.status(), number)
