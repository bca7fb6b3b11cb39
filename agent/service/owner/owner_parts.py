"""Components of the owner of the machine; each can be replaced."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path

from agent.execution.run_lock import Ownership
from agent.runs.resume.resume import resume
from agent.runs.session import RunResult, carry_out
from agent.service.owner.health import Health
from agent.service.owner.machine_access import MachineAccess
from agent.service.owner.unattended import Circumstances
from agent.service.state.event_log import EventLog
from agent.service.state.journal_state import JournalState
from agent.service.state.live_view import LiveView
from agent.service.state.reports import ReportQueue
from agent.service.state.status_board import StatusBoard
from drivers.clock import RealClock
from twin.units import S_PER_MIN


def current_circumstances() -> Circumstances:
    """Return the local time, and the time since this computer was switched on according to the monotonic clock of
    Linux."""
    return Circumstances(datetime.now().astimezone(), RealClock().now() / S_PER_MIN)


@dataclass(frozen=True)
class OwnerParts:
    """Components of the owner of the machine.

    `config` is the path of the settings file, which is needed for messages and to resolve relative paths. `carry_out`
    and `resume` are functions with the signatures of `agent.runs.session.carry_out` and
    `agent.runs.resume.resume.resume`.
    """

    config: Path
    event_log: EventLog
    board: StatusBoard
    health: Health
    ownership: Ownership
    journal_state: JournalState
    reports: ReportQueue
    live_view: LiveView = field(default_factory=LiveView)
    machine: MachineAccess = field(default_factory=MachineAccess)
    carry_out: Callable[..., RunResult] = carry_out
    resume: Callable[..., RunResult] = resume
    circumstances: Callable[[], Circumstances] = current_circumstances
