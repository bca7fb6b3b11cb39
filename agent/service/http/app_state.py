"""What the pages and endpoints are made from; handed to every router."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from fastapi import Depends, Request

from agent.service.control import Control
from agent.service.state.archive import Archive
from agent.service.state.event_log import EventLog
from agent.service.state.live_view import Scenes
from agent.settings.schema import Settings


@dataclass(frozen=True)
class Site:
    """`settings`: those that the next run will have; `config`: the file they come from."""

    control: Control
    event_log: EventLog
    archive: Archive
    scenes: Scenes
    settings: Callable[[], Settings]
    config: Path
    token: str


def site_of(request: Request) -> Site:
    site: Site = request.app.state.site
    return site


SiteHere = Annotated[Site, Depends(site_of)]
