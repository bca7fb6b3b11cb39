"""What everybody may read: status, journal, machine, plan. Nothing here asks the engine or a device."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Query
from fastapi.responses import FileResponse

from agent.planning.job import prepare_job
from agent.service.http.app_state import Site, SiteHere
from agent.service.http.models import RunDetails, RunPage, RunSummary, StatusView, Tables, TableView, status_view
from agent.service.http.problems import DOCUMENTED
from agent.service.state.live_view import machine_facts

router = APIRouter(prefix="/api", tags=["reading"], responses=DOCUMENTED)

Limit = Annotated[int, Query(ge=1, le=1000)]


@router.get("/status")
def status(site: SiteHere) -> StatusView:
    """The whole of it at one instant."""
    return status_now(site)


@router.get("/runs")
def runs(site: SiteHere, limit: Annotated[int, Query(ge=1, le=200)] = 50, before: str | None = None) -> RunPage:
    """The journal's runs, the latest first."""
    found = [RunSummary(**document) for document in site.archive.runs(limit, before)]
    return RunPage(runs=found, before=found[-1].run_id if len(found) == limit else None)


@router.get("/runs/{run_id}")
def run(site: SiteHere, run_id: str) -> RunDetails:
    """One run: who asked for it, gates, decisions, end."""
    return RunDetails(**site.archive.run(run_id))


@router.get("/runs/{run_id}/balls")
def balls(site: SiteHere, run_id: str) -> list[dict[str, Any]]:
    """Every ball centre that was measured, in order."""
    return site.archive.balls(run_id)


@router.get("/runs/{run_id}/temperatures")
def temperatures(site: SiteHere, run_id: str) -> list[dict[str, Any]]:
    return site.archive.temperatures(run_id)


@router.get("/runs/{run_id}/events")
def events(
    site: SiteHere, run_id: str, limit: Limit = 500, after: Annotated[int, Query(ge=0)] = 0
) -> list[dict[str, Any]]:
    """What the journal keeps of what happened; `after`: the number of the last one that is known."""
    return site.archive.events(run_id, limit, after)


@router.get("/runs/{run_id}/estimate")
def estimate(site: SiteHere, run_id: str) -> dict[str, Any]:
    """The estimate file's document."""
    return site.archive.estimate(run_id)


@router.get("/runs/{run_id}/report", response_class=FileResponse)
def report(site: SiteHere, run_id: str) -> FileResponse:
    """Self-contained HTML."""
    return FileResponse(site.archive.report(run_id), media_type="text/html", filename=f"volcal-{run_id}.html")


@router.get("/tables")
def tables(site: SiteHere, limit: Limit = 100) -> Tables:
    """Which bank acts, and every table that was kept."""
    now = site.control.status()
    kept = [TableView(**document) for document in site.archive.tables(limit)]
    return Tables(active_bank=now.active_bank, written_not_active=now.written_not_active, kept=kept)


@router.get("/machine")
def machine(site: SiteHere) -> dict[str, Any]:
    """Limits, stations, artefact, and the sets that there are."""
    settings = site.settings()
    files = sorted(path.name for path in site.config.parent.glob("*.csv"))
    return {**machine_facts(prepare_job(settings, site.config.parent)), "position_files": files}


@router.get("/plan")
def plan(site: SiteHere) -> dict[str, Any]:
    """The path of the run under way as its preflight rehearsed it, or of the next calibration; the preview's document
    (docs/reference/http.md)."""
    return site.scenes.plan(site.settings(), site.config.parent)


def status_now(site: Site) -> StatusView:
    """The event's number is taken first: what happens between the two is told again rather than lost."""
    number = site.event_log.last_number
    return status_view(site.control.status(), number)
