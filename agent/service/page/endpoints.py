"""What the engineer's view asks for beyond the documented interface: curves, maps, trends, worth of the set, tables,
reports. The page's own, so it may change with it; reading only, behind the same guard."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Annotated, Any, Literal

from fastapi import APIRouter, Query
from fastapi.responses import Response

from agent.planning.job import prepare_job
from agent.reports.render_in_subprocess import rebuilt_apart
from agent.runs.kinds.restoration import TableRole, stored_table
from agent.service.http.app_state import SiteHere
from agent.service.http.problems import DOCUMENTED
from agent.service.page.result_data import Findings
from agent.service.page.set_value import Worths
from agent.service.page.tables import difference, table_csv

if TYPE_CHECKING:
    from agent.service.page.trends import Trends

Document = dict[str, Any]
REPORT_TYPES = {"html": "text/html", "pdf": "application/pdf"}


def page_router() -> APIRouter:
    """With memories of its own: what a run has found never changes, so it is computed once."""
    router = APIRouter(prefix="/api/page", include_in_schema=False, responses=DOCUMENTED)
    findings, worths = Findings(), Worths()
    trends = cache(_trends)

    @router.get("/runs/{run_id}/curves")
    def curves(site: SiteHere, run_id: str) -> Document:
        """The error functions with their standard uncertainties, the cross-effect, and the squarenesses."""
        return findings.curves(site.archive.directory, run_id)

    @router.get("/runs/{run_id}/map")
    def error_map(site: SiteHere, run_id: str) -> Document:
        """Deviation and its uncertainty in µm on planes of the workspace."""
        return findings.maps(site.archive.directory, run_id)

    @router.get("/runs/{run_id}/report.{form}")
    def report(site: SiteHere, run_id: str, form: Literal["html", "pdf"]) -> Response:
        """As `volcal report` writes it, from the journal alone."""
        content = rebuilt_apart(site.archive.directory, run_id, pdf=form == "pdf")[f"report.{form}"]
        headers = {"Content-Disposition": f'attachment; filename="volcal-{run_id}.{form}"'}
        return Response(content, media_type=REPORT_TYPES[form], headers=headers)

    @router.get("/trends")
    def all_trends(site: SiteHere, of: Annotated[str | None, Query(max_length=20)] = None) -> Document:
        """Volumetric errors and the 21 errors over the nights; `of`: the parameters of one error."""
        return trends().document(site.settings(), of)

    @router.get("/worth")
    def worth(site: SiteHere) -> Document:
        """The positions of the settings, what the set is worth, and what it would lose without each of them."""
        return worths.document(prepare_job(site.settings(), site.config.parent))

    @router.get("/tables/{run_id}/{role}.csv")
    def table(site: SiteHere, run_id: str, role: TableRole) -> Response:
        """Return a stored table as a neutral file."""
        job = prepare_job(site.settings(), site.config.parent)
        text = table_csv(stored_table(site.archive.directory, run_id, role), job.tool_offset_mm, run_id, role)
        headers = {"Content-Disposition": f'attachment; filename="volcal-{run_id}-{role}.csv"'}
        return Response(text, media_type="text/csv", headers=headers)

    @router.get("/tables/difference")
    def tables_difference(site: SiteHere, one: str, one_role: TableRole, other: str, other_role: TableRole) -> Document:
        """Return `other` minus `one`, each the table stored by a run with a role."""
        directory = site.archive.directory
        return difference(stored_table(directory, one, one_role), stored_table(directory, other, other_role))

    return router


def _trends() -> Trends:
    """A database's client is loaded when the first reader asks for trends."""
    from agent.service.page.trends import Trends  # noqa: PLC0415

    return Trends()
