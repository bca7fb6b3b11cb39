"""Start-up of the service. It takes the lock on the machine, creates the owner of the machine, opens the endpoints, and
runs the main loop until the service is stopped."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import structlog
from fastapi import FastAPI

from agent.execution.run_lock import Ownership, ownership
from agent.model_files import load_machine
from agent.service.control import Control
from agent.service.daemon.endpoints import further_endpoints, http_extensions, open_endpoints
from agent.service.daemon.main_loop import MainLoop, queued_signals
from agent.service.daemon.sd_notify import Notifier
from agent.service.http.app import create_app
from agent.service.http.app_state import AppState
from agent.service.http.endpoint import HttpEndpoint
from agent.service.owner.health import Health
from agent.service.owner.idle_reader import idle_reading
from agent.service.owner.owner import Owner
from agent.service.owner.owner_parts import OwnerParts, current_circumstances
from agent.service.owner.process_heap import share_one_heap
from agent.service.owner.unattended import Circumstances
from agent.service.state.archive import Archive
from agent.service.state.event_log import EventLog
from agent.service.state.journal_state import JournalState
from agent.service.state.live_view import LiveView
from agent.service.state.reports import ReportQueue
from agent.service.state.status_board import StatusBoard
from agent.service.token import make_token, read_token, token_path
from agent.settings.load import load_settings
from agent.settings.schema import Settings
from drivers.clock import RealClock
from twin.units import S_PER_MIN

log = structlog.get_logger()
REPORT_TIMEOUT_S = 15.0
"""Longest time in s to wait for a report in progress when the service stops. Rendering a report takes about 5 s."""


def serve(config: Path, circumstances: Callable[[], Circumstances] = current_circumstances) -> None:
    """Run the service until SIGTERM or SIGINT.

    `circumstances` is a function that returns the local time and the time since this computer was switched on. Both
    determine whether a run may start without consent. Raise Busy if another process owns the machine, and
    ConfigurationError if the settings are invalid.
    """
    share_one_heap()
    config = config.resolve()
    settings = load_settings(config)
    directory = settings.state_directory
    with queued_signals() as signals, ownership(directory, f"the service (process {os.getpid()})") as owned:
        make_token(settings)
        parts = _owner_parts(settings, config, owned, circumstances)
        owner = Owner(settings, parts)
        token = read_token(token_path(settings))
        app_state = AppState(
            owner,
            parts.event_log,
            Archive(directory, parts.reports.path, lambda: owner.running_id),
            parts.live_view,
            lambda: owner.settings,
            config,
            token,
        )

        def make_app(_: Control) -> FastAPI:
            names = (*settings.service.host_names, settings.service.reached_at)
            return create_app(app_state, names, http_extensions(settings))

        http = HttpEndpoint(settings.service, directory, make_app)
        endpoints = [http, *further_endpoints(settings)]
        with open_endpoints(endpoints, owner):
            log.info("serving", url=http.url, machine=settings.machine.name, state_directory=str(directory))
            with idle_reading(owner):
                MainLoop(owner, parts.health, Notifier(), signals, config, endpoints).run()
            parts.event_log.close()
        if not parts.reports.close(REPORT_TIMEOUT_S):
            log.warning("a report was not finished; it is rendered on request")


def _owner_parts(
    settings: Settings, config: Path, owned: Ownership, circumstances: Callable[[], Circumstances]
) -> OwnerParts:
    service, event_log = settings.service, EventLog()
    computing_s = S_PER_MIN * service.computation_timeout_minutes
    return OwnerParts(
        config=config,
        event_log=event_log,
        board=StatusBoard(load_machine(settings.machine).name, event_log),
        health=Health(RealClock().now, hang_timeout_s=service.hang_timeout_s, computing_s=computing_s),
        ownership=owned,
        journal_state=JournalState(settings.state_directory),
        reports=ReportQueue(settings.state_directory),
        live_view=LiveView(),
        circumstances=circumstances,
    )
