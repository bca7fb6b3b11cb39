"""An owner of a machine that is never there: what the run does, the test says."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path
from queue import SimpleQueue
from typing import Any

from structlog.testing import capture_logs

from agent.errors import Aborted, Interrupted
from agent.execution.device_assembly import Devices
from agent.execution.run_lock import ownership
from agent.execution.run_state import Announcement
from agent.execution.states import RunState
from agent.execution.supervisor import Supervisor
from agent.planning.job import Job
from agent.results.run_outcome import Outcome
from agent.runs.planned_run import Kind
from agent.runs.reconcile_result import CompensationState, ReconcileAction, Reconciliation
from agent.runs.run_context import RunHooks
from agent.runs.session import RunResult
from agent.service.owner.health import Health
from agent.service.owner.owner import Owner
from agent.service.owner.owner_parts import MachineAccess, OwnerParts
from agent.service.owner.unattended import Circumstances
from agent.service.state.controller_reading import ControllerReading
from agent.service.state.event_log import EventLog
from agent.service.state.idle_alarms import IdleAlarms
from agent.service.state.journal_state import JournalState
from agent.service.state.reports import ReportQueue
from agent.service.state.status_board import StatusBoard
from agent.settings.schema import Settings
from drivers.clock import VirtualClock
from drivers.errors import VolcalError
from drivers.roles import MachineStatus, MotionState, Permission

CONFIG = Path(__file__).resolve().parents[3] / "config"
ALL_GIVEN = dict.fromkeys(Permission, True)
READY_MACHINE = MachineStatus(MotionState.IDLE, ALL_GIVEN)
AT_NIGHT = Circumstances(datetime(2026, 11, 21, 2, 0), 600.0)
PATIENCE_S = 600.0


def settings_document(state: Path, **sections: Any) -> dict[str, Any]:
    roles = ("machine", "probe", "store", "thermometer", "mount")
    return {
        "machine": str(CONFIG / "machines" / "case-study.toml"),
        "artefact": str(CONFIG / "artefacts" / "ball-bar-1500.toml"),
        "state_directory": str(state),
        "devices": {"twin": {"driver": "simulated"}, "person": {"driver": "console-operator"}},
        "roles": {**dict.fromkeys(roles, "twin"), "operator": "person"},
        "stations": {"places_mm": [[700.0, 1000.0, 750.0], [3300.0, 1000.0, 750.0]], "standing_at": 1},
        **sections,
    }


@dataclasses.dataclass(frozen=True)
class AbsentMachine(MachineAccess):
    """`status`: what the machine says where it is asked; `away`: what it answers next when asked for its compensation;
    `asked`: whether it was reached; `found`: what the next comparisons find; `readings`: what the next readings
    between runs find."""

    status: MachineStatus = READY_MACHINE
    away: list[VolcalError] = dataclasses.field(default_factory=list)
    asked: list[str] = dataclasses.field(default_factory=list)
    found: list[Reconciliation] = dataclasses.field(default_factory=list)
    readings: list[ControllerReading] = dataclasses.field(default_factory=list)

    def machine_status(self, settings: Settings, base: Path) -> MachineStatus:
        return self.status

    def reconcile(self, settings: Settings, base: Path) -> Reconciliation:
        self.asked.append("away" if self.away else "reached")
        if self.away:
            raise self.away.pop()
        if self.found:
            return self.found.pop(0)
        return Reconciliation(CompensationState.UNKNOWN, ReconcileAction.NOTHING, 0)

    def read(
        self, settings: Settings, base: Path, must_compare: Callable[[int, int | None], bool]
    ) -> ControllerReading:
        self.asked.append("read")
        reading = self.readings.pop(0) if self.readings else ControllerReading((), problem="not asked")
        if reading.active_bank is not None and must_compare(reading.active_bank, reading.waiting_bank):
            return dataclasses.replace(reading, compared=self.reconcile(settings, base))
        return reading

    def give_up(self, settings: Settings, base: Path, reason: str) -> Reconciliation:
        self.asked.append(reason)
        return self.reconcile(settings, base)


@dataclasses.dataclass(frozen=True)
class Started:
    """Arguments with which a run was started."""

    job: Job
    kind: Kind
    hooks: RunHooks
    run_id: str
    asked: dict[str, object]


class Puppet:
    """Plays `carry_out`: follows orders, one at a time, on the run's own thread."""

    def __init__(self) -> None:
        self.orders: SimpleQueue[Any] = SimpleQueue()
        self.done: SimpleQueue[Any] = SimpleQueue()
        self.inside = 0
        self.most_inside = 0
        self.started: list[Started] = []
        self.supervisor: Supervisor | None = None
        self.clock = VirtualClock()

    def __call__(
        self, job: Job, kind: Kind, base: Path, hooks: RunHooks, *, run_id: str, asked: dict[str, object]
    ) -> RunResult:
        self.inside += 1
        self.most_inside = max(self.inside, self.most_inside)
        self.started.append(Started(job, kind, hooks, run_id, asked))
        self.supervisor = Supervisor(self.clock)
        hooks.attach(self.supervisor)
        self.done.put("begun")
        try:
            while True:
                order = self.orders.get(timeout=PATIENCE_S)
                if isinstance(order, BaseException):
                    raise order
                if isinstance(order, RunResult):
                    return order
                order(hooks)
                self.done.put("done")
        finally:
            self.inside -= 1

    def begun(self) -> None:
        assert self.done.get(timeout=PATIENCE_S) == "begun"

    def enter(self, state: RunState) -> None:
        self.orders.put(lambda hooks: hooks.announce(Announcement("state", state.value, {"state": state.value})))
        assert self.done.get(timeout=PATIENCE_S) == "done"

    def end(self, state: RunState, error: VolcalError | None = None) -> None:
        self.orders.put(RunResult(outcome(self.started[-1].run_id, state, error), error))

    def crash(self, error: BaseException) -> None:
        self.orders.put(error)

    @property
    def abort_wanted(self) -> str | None:
        assert self.supervisor is not None
        try:
            self.supervisor.check_stop_request()
        except (Aborted, Interrupted) as error:
            return error.message
        return None


def outcome(run_id: str, state: RunState, error: VolcalError | None) -> Outcome:
    return Outcome(
        state=state,
        run_id=run_id,
        position_set="S3",
        formulation="centres",
        balls=1,
        touches=5,
        machine_minutes=1.0,
        wall_seconds=1.0,
        predicted_minutes=1.0,
        table_bank=1,
        report=None,
        reason="" if error is None else str(error),
    )


@dataclasses.dataclass
class House:
    owner: Owner
    parts: OwnerParts
    puppet: Puppet
    machine: AbsentMachine

    @property
    def event_log(self) -> EventLog:
        return self.parts.event_log


@contextmanager
def house(
    state: Path,
    *,
    circumstances: Circumstances = AT_NIGHT,
    status: MachineStatus = READY_MACHINE,
    **sections: Any,
) -> Iterator[House]:
    settings = Settings.model_validate(settings_document(state, **sections))
    with capture_logs(), ownership(state, "the service (process 1)") as owned:
        event_log, puppet = EventLog(), Puppet()
        machine = AbsentMachine(Devices(make_clock=lambda _: VirtualClock()), status=status)
        parts = OwnerParts(
            config=state / "volcal.toml",
            event_log=event_log,
            board=StatusBoard("case-study", event_log, kept=IdleAlarms(state)),
            health=Health(VirtualClock().now, hang_timeout_s=30.0, computing_s=900.0),
            ownership=owned,
            journal_state=JournalState(state),
            reports=ReportQueue(state, lambda *_: {}),
            machine=machine,
            carry_out=puppet,
            circumstances=lambda: circumstances,
        )
        built = House(Owner(settings, parts), parts, puppet, machine)
        try:
            yield built
        finally:
            if built.owner.status().run_id is not None and puppet.inside:
                puppet.end(RunState.COMPLETE)
            assert built.owner.wait(PATIENCE_S)
            assert parts.reports.close(PATIENCE_S)
