"""One archive for whoever is asked for help: what there is to know, without secrets."""

from __future__ import annotations

from fastapi import APIRouter, Depends
from fastapi.responses import Response

from agent.service.http.app_state import SiteHere
from agent.service.http.diagnostics_archive import diagnosis
from agent.service.http.guard import require_token
from agent.service.http.problems import DOCUMENTED
from agent.service.http.queries import status_now

router = APIRouter(prefix="/api", tags=["reading"], responses=DOCUMENTED, dependencies=[Depends(require_token)])


@router.get("/diagnostics", response_class=Response)
def diagnostics(site: SiteHere) -> Response:
    """ZIP: status, events, versions, settings and journal, secrets removed. It needs the token: it is everything that
    is known of the machine."""
    _, events = site.event_log.since(0)
    content = diagnosis(site.settings(), status_now(site).model_dump(mode="json"), events)
    headers = {"Content-Disposition": 'attachment; filename="volcal-diagnostics.zip"'}
    return Response(content, media_type="application/zip", headers=headers)
