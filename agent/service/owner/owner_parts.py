"""What the owner of the machine works with; each part can be another one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path

from agent.execution.run_lock import Ownership
from agent.runs.resume.resume import ResumeRequest, resume
from agent.runs.session import Request, RunResult, carry_out
from agent.service.owner.health import Health
from agent.service.owner.request_translation import Devices
from agent.service.owner.unattended import Circumstances
from agent.service.state.event_log import Bulletin
from agent.service.state.journal_state import JournalState
from agent.service.state.live_view import Scenes
from agent.service.state.reports import Reports
from agent.service.state.status_board import Board
from drivers.clock import RealClock
from twin.units import S_PER_MIN


def here_and_now() -> Circumstances:
    """The monotonic clock of Linux begins when the computer is switched on."""
    return Circumstances(datetime.now().astimezone(), RealClock().now() / S_PER_MIN)


@dataclass(frozen=True)
class Household:
    """What the owner works with. `config`: the settings file, for messages and for relative paths."""

    config: Path
    bulletin: Bulletin
    board: Board
    health: Health
    ownership: Ownership
    journal_state: JournalState
    reports: Reports
    scenes: Scenes = field(default_factory=Scenes)
    devices: Devices = field(default_factory=Devices)
    carry_out: Callable[[Request], RunResult] = carry_out
    go_on: Callable[[ResumeRequest], RunResult] = resume
    circumstances: Callable[[], Circumstances] = here_and_now
