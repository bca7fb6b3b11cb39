"""Start-up of the service. It takes the lock on the machine, creates the owner of the machine, opens the endpoints, and
runs the main loop until the service is stopped."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path

import structlog
from fastapi import FastAPI

from agent.execution.run_lock import Ownership, ownership
from agent.model_files import load_machine
from agent.service.access.access import Access
from agent.service.access.paired_clients import PairedClients
from agent.service.access.pairing_codes import PairingCodes
from agent.service.control import Alarm, Control
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
from agent.service.state.event_log import new_event_log
from agent.service.state.idle_alarms import IdleAlarms
from agent.service.state.journal_state import JournalState
from agent.service.state.live_view import LiveView
from agent.service.state.reports import ReportQueue
from agent.service.state.status_board import StatusBoard
from agent.service.token import make_token, read_token, token_path
from agent.settings.load import load_settings
from agent.settings.schema import Settings
from drivers.clock import RealClock
from drivers.errors import VolcalError
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
        access = Access(read_token(token_path(settings)), PairedClients(directory), PairingCodes(RealClock().now))
        app_state = AppState(
            owner,
            parts.event_log,
            Archive(directory, parts.reports.path, lambda: owner.running_id),
            parts.live_view,
            lambda: owner.settings,
            config,
            access,
        )

        def make_app(_: Control) -> FastAPI:
            names = (*settings.service.host_names, settings.service.reached_at)
            return create_app(app_state, names, http_extensions(settings))

        http = HttpEndpoint(settings.service, directory, make_app)
        wanted, left_out = [http, *further_endpoints(settings)], list[Alarm]()
        with open_endpoints(wanted, owner, left_out.append) as endpoints:
            log.info("serving", url=http.url, machine=settings.machine.name, state_directory=str(directory))
            with notifying(settings, parts, owner, app_state.archive), idle_reading(owner):
                for alarm in left_out:  # only now somebody is told
                    parts.board.idle_alarm(alarm)
                MainLoop(owner, parts.health, Notifier(), signals, config, endpoints).run()
            parts.event_log.close()
        if not parts.reports.close(REPORT_TIMEOUT_S):
            log.warning("a report was not finished; it is rendered on request")


@contextmanager
def notifying(settings: Settings, parts: OwnerParts, owner: Owner, archive: Archive) -> Iterator[None]:
    """Tell the receivers of the settings about the events of the service for the duration of the `with` block.

    Raise ConfigurationError if a file that the settings name cannot be used. If nobody is to be told, nothing is
    imported or started.
    """
    if not settings.notifications.channels:
        yield
        return
    from agent.notifications.channels import dispatcher_of  # noqa: PLC0415
    from agent.service.daemon.notices import CLOSE_TIMEOUT_S, ConcludedRun, NoticeMaker, NoticeWatch  # noqa: PLC0415

    def ended(run_id: str) -> ConcludedRun | None:
        try:
            return ConcludedRun(archive.run(run_id), parts.journal_state.end_number(run_id))
        except VolcalError as error:  # refused before the journal had it, or the journal cannot be read
            log.info("a run is told without its figures", run_id=run_id, reason=str(error))
            return None

    def note(text: str) -> None:
        parts.event_log.publish("note", text)

    chosen = settings.notifications
    dispatcher = dispatcher_of(chosen, settings.state_directory, parts.board.show_receiver, note)
    last = parts.journal_state.last_run_id()
    dispatcher.start()
    try:
        # The maker reads the state of the service: only after the subscription does it miss no change of it.
        with owner.subscribe() as events:
            watch = NoticeWatch(NoticeMaker(chosen, owner.status, ended), dispatcher)
            with watch.watching(events, None if last is None else ended(last)):
                yield
    finally:
        if not dispatcher.close(CLOSE_TIMEOUT_S):
            log.info("a notice is still being delivered; it is delivered again after the next start")


def _owner_parts(
    settings: Settings, config: Path, owned: Ownership, circumstances: Callable[[], Circumstances]
) -> OwnerParts:
    service = settings.service
    event_log = new_event_log(datetime.now(UTC))
    computing_s = S_PER_MIN * service.computation_timeout_minutes
    return OwnerParts(
        config=config,
        event_log=event_log,
        board=StatusBoard(load_machine(settings.machine).name, event_log, kept=IdleAlarms(settings.state_directory)),
        health=Health(RealClock().now, hang_timeout_s=service.hang_timeout_s, computing_s=computing_s),
        ownership=owned,
        journal_state=JournalState(settings.state_directory),
        reports=ReportQueue(settings.state_directory),
        live_view=LiveView(),
        circumstances=circumstances,
    )
