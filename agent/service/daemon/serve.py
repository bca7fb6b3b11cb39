"""The life of the service: lock, owner, doors, then signals and systemd until somebody wants it to end."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import structlog
from fastapi import FastAPI

from agent.execution.run_lock import Ownership, ownership
from agent.model_files import load_machine
from agent.service.control import Control
from agent.service.daemon.endpoints import opened
from agent.service.daemon.extensions import further_doors, http_extensions
from agent.service.daemon.main_loop import Life, heard_signals
from agent.service.daemon.sd_notify import Notifier
from agent.service.http.app import create_app
from agent.service.http.app_state import Site
from agent.service.http.endpoint import HttpDoor
from agent.service.owner.health import Health
from agent.service.owner.owner import Owner
from agent.service.owner.owner_parts import OwnerParts, here_and_now
from agent.service.owner.unattended import Circumstances
from agent.service.state.archive import Archive
from agent.service.state.event_log import EventLog
from agent.service.state.journal_state import JournalState
from agent.service.state.live_view import Scenes
from agent.service.state.reports import Reports
from agent.service.state.status_board import StatusBoard
from agent.service.token import make_token, read_token, token_path
from agent.settings.load import load_settings
from agent.settings.schema import Settings
from drivers.clock import RealClock
from twin.units import S_PER_MIN

log = structlog.get_logger()
REPORT_WITHIN_S = 15.0
"""A report takes some five seconds; who stops the service does not wait for more than this."""


def serve(config: Path, circumstances: Callable[[], Circumstances] = here_and_now) -> None:
    """Until SIGTERM or SIGINT. Busy where somebody else owns the machine; ConfigurationError for bad settings.
    `circumstances`: hour and warm-up by which starts without consent are permitted."""
    config = config.resolve()
    settings = load_settings(config)
    directory = settings.state_directory
    with heard_signals() as signals, ownership(directory, f"the service (process {os.getpid()})") as owned:
        make_token(settings)
        parts = _owner_parts(settings, config, owned, circumstances)
        owner = Owner(settings, parts)
        token = read_token(token_path(settings))
        site = Site(
            owner,
            parts.event_log,
            Archive(directory, parts.reports.path),
            parts.scenes,
            lambda: owner.settings,
            config,
            token,
        )

        def make_app(_: Control) -> FastAPI:
            names = (*settings.service.host_names, settings.service.reached_at)
            return create_app(site, names, http_extensions(settings))

        http = HttpDoor(settings.service, directory, make_app)
        with opened([http, *further_doors(settings)], owner):
            log.info("serving", url=http.url, machine=settings.machine.name, state_directory=str(directory))
            Life(owner, parts.health, Notifier(), signals, config).live()
            parts.event_log.close()
        if not parts.reports.close(REPORT_WITHIN_S):
            log.warning("a report was left unmade; it is made when somebody asks for it")


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
        reports=Reports(settings.state_directory),
        scenes=Scenes(),
        circumstances=circumstances,
    )
