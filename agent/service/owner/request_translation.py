"""From what somebody asked for to what `agent.runs.session` carries out."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

from agent.errors import PlanRefused
from agent.execution.device_assembly import assemble, closed_after, make_clock
from agent.execution.rig import Rig
from agent.planning.job import Job, prepare_job
from agent.runs.consent import Consent
from agent.runs.kinds.kind import FullCalibration, Kind, Ready
from agent.runs.kinds.nightly import Night
from agent.runs.kinds.verify import Verification
from agent.runs.reconcile import reconcile
from agent.runs.reconcile_result import Reconciliation
from agent.service.control import StartRequest
from agent.service.owner.questions import Questions, ServiceOperator
from agent.settings.load import naming, with_overrides
from agent.settings.schema import ClockSettings, Settings
from drivers.clock import Clock
from drivers.errors import UserError
from drivers.roles import MachineStatus

CONSOLE = "console-operator"
"""Under a service nobody reads the console: its questions go to the doors."""


@dataclass(frozen=True)
class Devices:
    """How rigs and clocks are made; another pair for a machine that somebody holds already."""

    assemble: Callable[[Settings, Clock, Path], Rig] = assemble
    make_clock: Callable[[ClockSettings], Clock] = make_clock

    def machine_status(self, settings: Settings, base: Path) -> MachineStatus:
        """Open the machine, ask, close it again; nothing moves."""
        with self._opened(settings, base) as rig:
            return rig.machine.status()

    def reconciled(self, settings: Settings, base: Path) -> Reconciliation:
        """What the last run has left in the controller; an unproved table is taken back. Nothing moves."""
        with self._opened(settings, base) as rig:
            return reconcile(rig, settings.state_directory)

    @contextmanager
    def _opened(self, settings: Settings, base: Path) -> Iterator[Rig]:
        with closed_after(self.make_clock(settings.clock)) as clock:
            rig = self.assemble(settings, clock, base)
            rig.open()
            try:
                yield rig
            finally:
                rig.close()

    def asking(self, questions: Questions, *, attended: bool) -> Callable[[Settings, Clock, Path], Rig]:
        """The same rig, with the doors in place of the console."""

        def assembled(settings: Settings, clock: Clock, base: Path) -> Rig:
            rig = self.assemble(settings, clock, base)
            if settings.devices[settings.roles.operator].driver != CONSOLE:
                return rig
            within = settings.service.answer_timeout_minutes
            return replace(rig, operator=ServiceOperator(questions, clock, within, attended))

        return assembled


def job_of(request: StartRequest, settings: Settings, config: Path) -> Job:
    """UserError naming the settings file where the request does not fit the machine.

    Stations of a calibration are measured at; the one of a night is where the artefact stands, and the full calibration
    that the night may become is of all stations.
    """
    stations = request.stations if request.kind == "calibrate" else None
    chosen = with_overrides(settings, position_set=request.position_set, stations=stations)
    with naming(config):
        return prepare_job(chosen, config.parent)


def kind_of(request: StartRequest, settings: Settings, slot_minutes: float | None) -> Kind:
    """`slot_minutes` of machine time there are; None: as the settings say."""
    match request.kind:
        case "calibrate":
            consent = Consent.ASK if request.consent else Consent.REFUSED
            return FullCalibration(consent=consent)
        case "verify":
            return Verification(station=_one_station(request))
        case "nightly":
            slot = settings.nightly.slot_minutes if request.slot_minutes is None else request.slot_minutes
            slot = slot if slot_minutes is None else min(slot, slot_minutes)
            return Night(slot, request.full_allowed, _one_station(request))


def require_within(ready: Ready, slot_minutes: float | None) -> None:
    """Raise PlanRefused if the run takes longer than the time available."""
    needed = ready.preflight.machine_minutes
    if slot_minutes is not None and needed > slot_minutes:
        raise PlanRefused(
            f"the run takes {needed:.0f} min of machine time, there are {slot_minutes:.0f}",
            hint="give it a longer slot, fewer stations or a smaller position set",
        )


def _one_station(request: StartRequest) -> int | None:
    stations = request.stations or ()
    if len(stations) > 1:
        raise UserError(
            f"{request.kind} measures at one station, {len(stations)} were named", hint="name the one where it stands"
        )
    return stations[0] if stations else None
