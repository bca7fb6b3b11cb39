"""Server-sent events of the service. The service first sends the status, then all events that the client has not yet
received."""

from __future__ import annotations

import asyncio
import re
from collections.abc import AsyncIterator
from typing import Annotated

from fastapi import APIRouter, Header
from fastapi.sse import EventSourceResponse, ServerSentEvent

from agent.service.control import Event
from agent.service.http.app_state import AppState, AppStateDependency
from agent.service.http.problems import DOCUMENTED
from agent.service.http.queries import status_now

router = APIRouter(prefix="/api", tags=["reading"], responses=DOCUMENTED)

RECONNECT_AFTER_MS = 2000
EVENT_NUMBER = re.compile(r"[0-9]{1,18}")


@router.get("/events", response_class=EventSourceResponse)
async def events(
    app_state: AppStateDependency, last_event_id: Annotated[str | None, Header()] = None
) -> AsyncIterator[ServerSentEvent]:
    """Send the status of the service once at the beginning, then every event with its number as id. If events were
    lost, send the status again.

    If the request has the header `Last-Event-ID`, the events after that number are sent before new events. A comment
    every 15 s keeps the connection alive.
    """
    known = EVENT_NUMBER.fullmatch(last_event_id or "")
    seen = int(known[0]) if known else app_state.event_log.last_number
    yield _status(app_state)
    loop, news = asyncio.get_running_loop(), asyncio.Event()
    with app_state.event_log.call_on_event(lambda: loop.call_soon_threadsafe(news.set)):
        while not app_state.event_log.closed:
            lost, happened = app_state.event_log.since(seen)
            if lost:
                yield _status(app_state)
            for event in happened:
                seen = event.number
                yield _sent(event)
            if not happened:
                await news.wait()
            news.clear()


def _status(app_state: AppState) -> ServerSentEvent:
    return ServerSentEvent(event="status", data=status_now(app_state), retry=RECONNECT_AFTER_MS)


def _sent(event: Event) -> ServerSentEvent:
    return ServerSentEvent(id=str(event.number), event=event.kind, data={"text": event.text, "data": event.data})
