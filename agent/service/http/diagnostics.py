"""Download of a diagnostics archive for support. Secrets are removed from the archive."""

from __future__ import annotations

from fastapi import APIRouter, Depends
from fastapi.responses import Response

from agent.service.http.app_state import AppStateDependency
from agent.service.http.diagnostics_archive import diagnostics_zip
from agent.service.http.guard import require_token
from agent.service.http.problems import DOCUMENTED
from agent.service.http.queries import status_now

router = APIRouter(prefix="/api", tags=["reading"], responses=DOCUMENTED, dependencies=[Depends(require_token)])


@router.get("/diagnostics", response_class=Response)
def diagnostics(app_state: AppStateDependency) -> Response:
    """Return a ZIP file with status, events, versions, settings and journal, from which secrets are removed. The
    request requires the access token, because the file contains everything known about the machine."""
    _, events = app_state.event_log.since(0)
    content = diagnostics_zip(app_state.settings(), status_now(app_state).model_dump(mode="json"), events)
    headers = {"Content-Disposition": 'attachment; filename="volcal-diagnostics.zip"'}
    return Response(content, media_type="application/zip", headers=headers)
