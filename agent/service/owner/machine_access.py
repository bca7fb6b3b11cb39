"""Access to the machine: short connections between runs, and the devices of a run. The questions that a run asks the
operator are shown at the endpoints."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

from agent.execution.device_assembly import Devices, closing_clock
from agent.execution.rig import Rig
from agent.runs.reconcile import reconcile
from agent.runs.reconcile_result import Reconciliation
from agent.service.owner.questions import Questions, ServiceOperator
from agent.settings.schema import ClockSettings, Settings
from drivers.clock import Clock
from drivers.roles import MachineStatus

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
