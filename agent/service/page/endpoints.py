"""Read-only HTTP routes for the engineers' view of the service's web page. They provide curves and maps of the machine
errors, trends, the expected benefit of the position set, compensation tables and reports.

The routes belong to the web page and may change with it; they are not part of the documented interface.
"""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Annotated, Any, Literal

from fastapi import APIRouter, Query
from fastapi.responses import Response

from agent.planning.job_preparation import prepare_job
from agent.reports.render_in_subprocess import render_in_subprocess
from agent.runs.kinds.restoration import TableRole, stored_table
from agent.service.http.app_state import AppStateDependency
from agent.service.http.problems import DOCUMENTED
from agent.service.page.result_cache import ResultCache
from agent.service.page.set_value import SetValueCache
from agent.service.page.tables import table_csv, table_difference

if TYPE_CHECKING:
    from agent.service.page.trends import TrendCache

Document = dict[str, Any]
REPORT_TYPES = {"html": "text/html", "pdf": "application/pdf"}


def page_router() -> APIRouter:
    """Return the router with the read-only routes of the engineers' view of the web page. The router caches the results
    of runs that have ended, because these results never change."""
    router = APIRouter(prefix="/api/page", include_in_schema=False, responses=DOCUMENTED)
    results, set_values = ResultCache(), SetValueCache()
    trends = cache(_trend_cache)

    @router.get("/runs/{run_id}/curves")
    def curves(app_state: AppStateDependency, run_id: str) -> Document:
        """Return the error functions with standard uncertainties, the cross-effect and the squareness errors."""
        return results.curves(app_state.archive.directory, run_id)

    @router.get("/runs/{run_id}/map")
    def error_map(app_state: AppStateDependency, run_id: str) -> Document:
        """Return the deviation and its uncertainty, both in µm, on planes of the workspace."""
        return results.maps(app_state.archive.directory, run_id)

    @router.get("/runs/{run_id}/report.{form}")
    def report(app_state: AppStateDependency, run_id: str, form: Literal["html", "pdf"]) -> Response:
        """Return the same report as `volcal report` writes, rendered from the journal alone."""
        content = render_in_subprocess(app_state.archive.directory, run_id, pdf=form == "pdf")[f"report.{form}"]
        headers = {"Content-Disposition": f'attachment; filename="volcal-{run_id}.{form}"'}
        return Response(content, media_type=REPORT_TYPES[form], headers=headers)

    @router.get("/trends")
    def all_trends(app_state: AppStateDependency, of: Annotated[str | None, Query(max_length=20)] = None) -> Document:
        """Return volumetric errors and the 21 errors over the nights or, if `of` names an error, its parameters."""
        return trends().document(app_state.settings(), of)

    @router.get("/worth")
    def worth(app_state: AppStateDependency) -> Document:
        """Return the position set of the settings, its expected benefit, and the loss if each position were omitted."""
        return set_values.document(prepare_job(app_state.settings(), app_state.config.parent))

    @router.get("/tables/{run_id}/{role}.csv")
    def table(app_state: AppStateDependency, run_id: str, role: TableRole) -> Response:
        """Return a stored table as a neutral file."""
        job = prepare_job(app_state.settings(), app_state.config.parent)
        text = table_csv(stored_table(app_state.archive.directory, run_id, role), job.tool_offset_mm, run_id, role)
        headers = {"Content-Disposition": f'attachment; filename="volcal-{run_id}-{role}.csv"'}
        return Response(text, media_type="text/csv", headers=headers)

    @router.get("/tables/difference")
    def tables_difference(
        app_state: AppStateDependency, one: str, one_role: TableRole, other: str, other_role: TableRole
    ) -> Document:
        """Return the difference of two stored tables, `other` minus `one`; run and role identify each table."""
        directory = app_state.archive.directory
        return table_difference(stored_table(directory, one, one_role), stored_table(directory, other, other_role))

    return router


def _trend_cache() -> TrendCache:
    """Return the cache of trends. The database client is imported here, at the first request."""
    from agent.service.page.trends import TrendCache  # noqa: PLC0415

    return TrendCache()
