"""State shared by the routes of the HTTP application. Each route receives it as a dependency."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from fastapi import Depends, Request

from agent.service.access.access import Access
from agent.service.control import Control
from agent.service.state.archive import Archive
from agent.service.state.event_log import EventLog
from agent.service.state.live_view import LiveView
from agent.settings.schema import Settings


@dataclass(frozen=True)
class AppState:
    """State shared by all routes. `settings` is a function that returns the settings for the next run; `config` is
    the path of the settings file; `access` says who may send which request."""

    control: Control
    event_log: EventLog
    archive: Archive
    live_view: LiveView
    settings: Callable[[], Settings]
    config: Path
    access: Access


async def app_state_of(request: Request) -> AppState:
    # A coroutine, because an ordinary function would need one of the threads that slow requests may occupy.
    app_state: AppState = request.app.state.app_state
    return app_state


AppStateDependency = Annotated[AppState, Depends(app_state_of)]
