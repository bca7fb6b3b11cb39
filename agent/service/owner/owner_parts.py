"""Components of the owner of the machine; each can be replaced."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from datetime import datetime
from pathlib import Path

from agent.execution.device_assembly import Devices, closing_clock
from agent.execution.rig import Rig
from agent.execution.run_lock import Ownership
from agent.runs.reconcile import reconcile
from agent.runs.reconcile_result import Reconciliation
from agent.runs.resume.abandon import abandon
from agent.runs.resume.resume import resume
from agent.runs.session import RunResult, carry_out
from agent.runs.unfinished_run import unfinished_run
from agent.service.owner.health import Health
from agent.service.owner.questions import Questions, ServiceOperator
from agent.service.owner.unattended import Circumstances
from agent.service.state.controller_reading import ControllerReading, read_controller, unreachable
from agent.service.state.event_log import EventLog
from agent.service.state.journal_state import JournalState
from agent.service.state.live_view import LiveView
from agent.service.state.reports import ReportQueue
from agent.service.state.status_board import StatusBoard
from agent.settings.schema import ClockSettings, Settings
from drivers.clock import Clock, RealClock
from drivers.errors import VolcalError
from drivers.roles import MachineStatus
from twin.units import S_PER_MIN

CONSOLE = "console-operator"
"""Driver that asks questions on the console. The service has no console, so it asks the questions at its endpoints
instead.
"""


@dataclass(frozen=True)
class MachineAccess:
    """Access to the machine through `devices`, which creates the clock and the rig."""

    devices: Devices = field(default_factory=Devices)

    def machine_status(self, settings: Settings, base: Path) -> MachineStatus:
        """Connect to the machine, read its status and disconnect. Nothing moves."""
        with self._opened_rig(settings, base) as rig:
            return rig.machine.status()

    def reconcile(self, settings: Settings, base: Path) -> Reconciliation:
        """Compare the compensation in the controller with the journal. If an active table has not yet been confirmed by
        measurements, reactivate the table that was active before it.

        Nothing moves.
        """
        with self._opened_rig(settings, base) as rig:
            return reconcile(rig, settings.state_directory)

    def read(
        self, settings: Settings, base: Path, must_compare: Callable[[int, int | None], bool]
    ) -> ControllerReading:
        """Ask every device whether it answers, and the store for its compensation; see `read_controller`."""
        try:
            with closing_clock(self.devices.make_clock(settings.clock)) as clock:
                return read_controller(self.devices.assemble(settings, clock, base), settings, must_compare)
        except VolcalError as error:
            return unreachable(settings, error.message)

    def give_up(self, settings: Settings, base: Path, reason: str) -> Reconciliation:
        """Do the same as `reconcile`, and end the run that can still be resumed. The result has the run as `unfinished`
        only if it could not be ended."""
        with self._opened_rig(settings, base) as rig:
            found = abandon(rig, settings.state_directory, reason)
        return replace(found, unfinished=unfinished_run(settings.state_directory))

    @contextmanager
    def _opened_rig(self, settings: Settings, base: Path) -> Iterator[Rig]:
        with closing_clock(self.devices.make_clock(settings.clock)) as clock:
            rig = self.devices.assemble(settings, clock, base)
            rig.open()
            try:
                yield rig
            finally:
                rig.close()

    def devices_for_run(self, clock_settings: ClockSettings, questions: Questions, *, attended: bool) -> Devices:
        """Return the devices of one run: its clock and its rig.

        If the settings let the operator answer at the console, the questions of the run are shown at the endpoints
        instead. The clock is created by this call. Raise ConfigurationError if it cannot be created.
        """
        clock = self.devices.make_clock(clock_settings)

        def assembled(settings: Settings, clock: Clock, base: Path) -> Rig:
            rig = self.devices.assemble(settings, clock, base)
            if settings.devices[settings.roles.operator].driver != CONSOLE:
                return rig
            within = settings.service.answer_timeout_minutes
            return replace(rig, operator=ServiceOperator(questions, clock, within, attended))

        return Devices(assembled, lambda _: clock)


def current_circumstances() -> Circumstances:
    """Return the local time, and the time since this computer was switched on according to the monotonic clock of
    Linux."""
    return Circumstances(datetime.now(), RealClock().now() / S_PER_MIN)


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
