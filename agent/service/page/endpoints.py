"""Read-only HTTP routes for the engineers' view of the service's web page. They provide curves and maps of the machine
errors, predicted errors of a part, trends, the expected benefit of the position set, compensation tables and reports.

The routes belong to the web page and may change with it; they are not part of the documented interface.
"""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Annotated, Any, Literal

from fastapi import APIRouter, Query
from fastapi.responses import Response

from agent.language.sentences import Language
from agent.planning.job_preparation import prepare_job
from agent.reports.render_in_subprocess import render_in_subprocess
from agent.reports.run_comparison import compare_runs
from agent.runs.kinds.calibrate import calibration_of
from agent.runs.kinds.restoration import TableRole, stored_table
from agent.runs.last_latencies import prepare_next_job
from agent.service.access.roles import CHECK_SETTINGS
from agent.service.http.app_state import AppStateDependency
from agent.service.http.permission import permitted
from agent.service.http.problems import DOCUMENTED
from agent.service.page.part_prediction import PartBody, PartPredictions
from agent.service.page.result_cache import ResultCache, comparison_document

if TYPE_CHECKING:
    from agent.service.page.trends import TrendCache
from threading import Lock

from agent.files import translated
from agent.planning.job import Job
from agent.planning.planning_options import planning_options
from agent.planning.run_minutes import run_minutes
from agent.results.table_difference import table_difference
from agent.results.table_image import table_of
from agent.settings.listing import setting_rows
from drivers.errors import ConfigurationError, InputError
from drivers.roles import TableImage
from twin.arrays import Array
from twin.artefact.position_set import Position
from twin.compensation.table_file import format_table
from twin.design.candidates import CandidatePositions, build_candidates
from twin.design.valuation import Valuation
from twin.machine.volumetric import evaluation_grid

Document = dict[str, Any]
RunId = Annotated[str, Query(max_length=40)]
REPORT_TYPES = {"html": "text/html", "pdf": "application/pdf"}


def page_router() -> APIRouter:
    """Return the router with the read-only routes of the engineers' view of the web page. The router caches the results
    of runs that have ended, because these results never change."""
    router = APIRouter(prefix="/api/page", include_in_schema=False, responses=DOCUMENTED)
    results, set_values, parts = ResultCache(), SetValueCache(), PartPredictions()
    trends = cache(_trend_cache)

    @router.get("/runs/{run_id}/curves")
    def curves(app_state: AppStateDependency, run_id: str) -> Document:
        """Return the error functions with standard uncertainties, the cross-effect and the squareness errors."""
        return results.curves(app_state.archive.directory, run_id)

    @router.get("/runs/{run_id}/plane")
    def error_plane(
        app_state: AppStateDependency,
        run_id: str,
        normal: Literal["x", "y", "z"] = "z",
        at: Annotated[float | None, Query(allow_inf_nan=False)] = None,
    ) -> Document:
        """Return the deviation without and with the table of the run, and its uncertainty, in µm on a plane of the
        workspace. `normal` is the axis across the plane and `at` the position on it in mm, by default the middle."""
        return results.plane(app_state.archive.directory, run_id, normal, at)

    @router.post("/runs/{run_id}/part")
    def part(app_state: AppStateDependency, run_id: str, body: PartBody) -> Document:
        """Return the predicted errors of the features of a part. Nothing moves, and nothing is stored."""
        return parts.document(app_state.archive.directory, run_id, body)

    @router.get("/runs/{run_id}/report.{form}")
    def report(
        app_state: AppStateDependency, run_id: str, form: Literal["html", "pdf"], language: Language | None = None
    ) -> Response:
        """Return the same report as `volcal report` writes, rendered from the journal alone; its language is that of
        the settings unless `language` says otherwise."""
        directory, language = app_state.archive.directory, language or app_state.settings().report.language
        content = render_in_subprocess(directory, run_id, pdf=form == "pdf", language=language)[f"report.{form}"]
        headers = {"Content-Disposition": f'attachment; filename="volcal-{run_id}.{form}"'}
        return Response(content, media_type=REPORT_TYPES[form], headers=headers)

    @router.get("/trends")
    def all_trends(app_state: AppStateDependency, of: Annotated[str | None, Query(max_length=20)] = None) -> Document:
        """Return volumetric errors and the 21 errors over the nights or, if `of` names an error, its parameters."""
        return trends().document(app_state.settings(), of)

    @router.get("/worth")
    def worth(app_state: AppStateDependency) -> Document:
        """Return the position set of the settings, its expected benefit, and the loss if each position were omitted."""
        return set_values.document(prepare_next_job(app_state.settings(), app_state.config.parent))

    @router.get("/settings", dependencies=[permitted(CHECK_SETTINGS)])
    def settings(app_state: AppStateDependency, run: RunId | None = None) -> Document:
        """Return the settings that the service has read, and those of a run beside them, without secrets."""
        in_run = None if run is None else app_state.archive.settings(run)
        rows = setting_rows(app_state.settings(), in_run)
        return {"file": app_state.config.name, "run_id": run, "rows": [vars(row) for row in rows]}

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
        tables = (stored_table(directory, run, role) for run, role in ((one, one_role), (other, other_role)))
        return table_difference(*tables).as_json()

    @router.get("/comparison")
    def comparison(app_state: AppStateDependency, one: RunId, other: RunId) -> Document:
        """Return the differences of two runs, `other` minus `one`, with curves and maps."""
        return comparison_document(compare_runs(app_state.archive.directory, one, other))

    return router


def _trend_cache() -> TrendCache:
    """Return the cache of trends. The database client is imported here, at the first request."""
    from agent.history.cached_trends import shared_trends  # noqa: PLC0415
    from agent.service.page.trends import TrendCache  # noqa: PLC0415

    return TrendCache(shared_trends())


def table_csv(image: TableImage | None, tool_offset_mm: Array, run_id: str, role: str) -> str:
    """Return a stored table as CSV text. Raise InputError if `image` is None, which means that bank 0, without a table,
    was active when the run stored this entry."""
    if image is None:
        raise InputError(f"run {run_id} stored no table as {role}", hint="bank 0 contains no table")
    return format_table(table_of(image, tool_offset_mm))


class SetValueCache:
    """Cache of the document that `set_value_document` computed last. It is safe to use from any thread."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._cached: tuple[str, Document] | None = None

    def document(self, job: Job) -> Document:
        """Return the document of `set_value_document` for `job`. Raise ConfigurationError if no position of the set is
        reachable."""
        key = job.settings.model_dump_json()
        with self._lock:
            if self._cached is None or self._cached[0] != key:
                self._cached = (key, set_value_document(job))
            return self._cached[1]


def set_value_document(job: Job) -> Document:
    """Return a document with the expected benefit of measuring the position set of `job`.

    `before_um` and `after_um` are the volumetric errors expected for the machine family (the population from which the
    machine comes) before and after the set has been measured. They are in µm, after the best-fitting rigid motion is
    removed. `lost_um` of a position is the amount, in µm, by which `after_um` would be larger without this position.
    """
    with translated(ConfigurationError, key="procedure.position_set"):
        candidates = build_candidates(
            job.procedure,
            job.positions,
            job.machine.family,
            planning_options(job.settings.temperature),
            evaluation_grid(job.machine.model.ranges_mm),
            job.tool_offset_mm,
        )
    everything = range(candidates.count)
    worth = Valuation(candidates.vce([]), candidates.vce(everything))
    after_um = worth.after.aligned_um
    minutes = run_minutes(job, calibration_of)
    return {
        "position_set": job.settings.procedure.position_set.rpartition("/")[2],
        "minutes": minutes.total,
        "latencies_from": job.latencies_from,
        "balls": int(candidates.balls.sum()),
        "before_um": worth.before.aligned_um,
        "after_um": after_um,
        "percent": worth.percent,
        "positions": [_position(candidates, index, after_um) for index in everything],
        "held_out": [_position_fields(position) for position in job.held_out],
        "out_of_reach": [_position_fields(p) for p in dict.fromkeys(job.positions) if p not in candidates.positions],
    }


def _position(candidates: CandidatePositions, index: int, after_um: float) -> Document:
    others = [other for other in range(candidates.count) if other != index]
    return {
        **_position_fields(candidates.positions[index]),
        "balls": int(candidates.balls[index]),
        "lost_um": candidates.vce(others).aligned_um - after_um,
    }


def _position_fields(position: Position) -> Document:
    return {
        "station": position.station,
        "azimuth_deg": position.azimuth_deg,
        "elevation_deg": position.elevation_deg,
        "tool": position.tool,
    }
