"""One owner of a simulated machine in this process. Its runs stop at a turnstile, so that requests are made at chosen
moments. The owner can be killed: nothing of its run has an effect any more, and a new owner begins on the same state
directory."""

from __future__ import annotations

import dataclasses
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path
from typing import Any

from agent.errors import Interrupted
from agent.execution.device_assembly import Devices
from agent.execution.encoding import table_digest
from agent.execution.journal import RunJournal
from agent.execution.rig import Rig
from agent.execution.run_lock import Ownership, ownership
from agent.execution.run_state import Announcement
from agent.planning.job import Job
from agent.runs.planned_run import Kind
from agent.runs.resume.resume import resume
from agent.runs.run_context import RunHooks
from agent.runs.session import RunResult, carry_out
from agent.service.control import Alarm
from agent.service.owner.health import Health
from agent.service.owner.owner import Owner
from agent.service.owner.owner_parts import CONSOLE, MachineAccess, OwnerParts
from agent.service.owner.unattended import Circumstances
from agent.service.state.event_log import EventLog
from agent.service.state.journal_state import JournalState
from agent.service.state.reports import ReportQueue
from agent.service.state.status_board import StatusBoard
from agent.settings.schema import Settings
from campaigns.aborts.case import FORMER_BANK, FORMER_TABLE
from campaigns.resume.case import KillableClock, Killed, prepare_case
from drivers.clock import Clock, VirtualClock
from drivers.errors import LinkLost, StoreError
from drivers.roles import Miss, Touch, Vector
from simulators.backend import SimulatedMachineDevice
from simulators.world.world import World

PATIENCE_S = 900.0
SETTLE_S = 60.0
"""Machine time in s after which every motion has ended that was left to the controller."""
AT_NIGHT = Circumstances(datetime(2026, 11, 21, 2, 0), 600.0)


class Turnstile:
    """Turnstile at which the thread of a run waits until the driver, the thread that makes the requests, lets it pass.

    `most_inside` is the largest number of runs that were in progress at the same time.
    """

    def __init__(self) -> None:
        self._driver = threading.get_ident()
        self._condition = threading.Condition()
        self._left = 0
        self._stops_at_states = False
        self._parked = False
        self._begun = 0
        self._inside = 0
        self.most_inside = 0

    @contextmanager
    def run(self) -> Iterator[None]:
        """Count a run in progress during the `with` block, and stop it before its first action."""
        with self._condition:
            self._begun += 1
            self._inside += 1
            self._left = 0  # the run before may have ended before it had passed as often as it might
            self.most_inside = max(self.most_inside, self._inside)
            self._condition.notify_all()
        try:
            self.pass_through()
            yield
        finally:
            with self._condition:
                self._inside -= 1
                self._condition.notify_all()

    def pass_through(self, *, at_state: bool = False) -> None:
        """Wait until the driver lets the run pass. The driver itself never waits."""
        if threading.get_ident() == self._driver:
            return
        with self._condition:
            if at_state and self._stops_at_states:
                self._left = 0
            if self._left == 0:
                self._parked = True
                self._condition.notify_all()
                self._wait_for(lambda: self._left > 0)
                self._parked = False
            self._left -= 1

    def await_run(self, number: int) -> None:
        """Wait until the run with this number, counted from 1, has begun and stands at the turnstile."""
        with self._condition:
            self._wait_for(lambda: self._begun >= number and (self._standing or self._inside == 0))

    def let_pass(self, times: int, *, stops_at_states: bool) -> bool:
        """Let the run pass so many times, or only until its next state if `stops_at_states` is True. Return True if a
        run is still in progress then."""
        with self._condition:
            self._left, self._stops_at_states = times, stops_at_states
            self._condition.notify_all()
            self._wait_for(lambda: self._standing or self._inside == 0)
            return self._inside > 0

    @property
    def _standing(self) -> bool:
        return self._parked and self._left == 0

    def _wait_for(self, happened: Any) -> None:
        if not self._condition.wait_for(happened, PATIENCE_S):
            raise RuntimeError("the run neither stands at the turnstile nor has it ended")


class OwnerProcess:
    """Process of one owner. Once it is `killed`, every access of its run to the machine, the clock or the journal
    raises Killed, so that the run has no effect any more."""

    def __init__(self) -> None:
        self.killed = False

    def check(self) -> None:
        if self.killed:
            raise Killed


class KillableJournalState(JournalState):
    """State of the journal for an owner that may be killed. A killed owner records no alarm."""

    process: OwnerProcess

    def __init__(self, directory: Path, process: OwnerProcess) -> None:
        super().__init__(directory)
        object.__setattr__(self, "process", process)

    def record_alarm(self, run_id: str, alarm: Alarm) -> None:
        if not self.process.killed:
            super().record_alarm(run_id, alarm)


class JournalGuard:
    """Guard of all run journals of this program: the run of a killed owner writes nothing."""

    def __init__(self) -> None:
        self._of_thread: dict[int, OwnerProcess] = {}
        self._execute = RunJournal._execute

    @contextmanager
    def installed(self) -> Iterator[None]:
        """Guard the journals during the `with` block."""
        execute, of_thread = self._execute, self._of_thread

        def guarded(journal: RunJournal, statement: str, values: Sequence[object] = ()) -> Any:
            process = of_thread.get(threading.get_ident())
            if process is not None:
                process.check()
            return execute(journal, statement, values)

        RunJournal._execute = guarded  # type: ignore[method-assign, assignment]
        try:
            yield
        finally:
            RunJournal._execute = execute  # type: ignore[method-assign]

    @contextmanager
    def run_of(self, process: OwnerProcess) -> Iterator[None]:
        """Note that this thread carries out a run of `process` during the `with` block. A killed run ends it with an
        error that its owner does not log as a defect."""
        self._of_thread[threading.get_ident()] = process
        try:
            yield
        except Killed:
            raise Interrupted("the process was killed") from None
        finally:
            del self._of_thread[threading.get_ident()]


class TurnstileClock(VirtualClock):
    """Virtual clock that begins at the present time of the world and advances it; its waits pass the turnstile.

    The world does not follow the clock of the run, which does not count holds and which, in a resumed run, continues
    from the interrupted one.
    """

    def __init__(self, world: World, turnstile: Turnstile, process: OwnerProcess) -> None:
        super().__init__()
        self._now = world.now
        self._turnstile, self._process = turnstile, process
        self.subscribe(world.advance_to)

    def sleep(self, duration_s: float) -> None:
        self._turnstile.pass_through()
        self._process.check()
        super().sleep(duration_s)


class CuttableLink:
    """Link to the machine. While `cut` is True, every command fails, also one that is being carried out."""

    def __init__(self) -> None:
        self.cut = False

    def check(self) -> None:
        if self.cut:
            raise LinkLost("the link to the machine is cut", hint="connect it again")


class LinkedDevice:
    """Simulated machine behind a link. It notes touches that begin after an abort and are carried out all the same.
    While the scene `refuses_activation`, the controller activates no bank. A killed `process` gets no answer."""

    def __init__(self, device: SimulatedMachineDevice, scene: RequestScene, process: OwnerProcess) -> None:
        self._device, self._scene, self._process = device, scene, process

    def __getattr__(self, name: str) -> Any:
        found = getattr(self._device, name)
        if not callable(found):
            return found

        def linked(*positional: Any, **named: Any) -> Any:
            self._process.check()
            self._scene.link.check()
            result = found(*positional, **named)
            self._scene.link.check()
            return result

        return linked

    def activate(self, bank: int) -> None:
        self._process.check()
        self._scene.link.check()
        if self._scene.refuses_activation:
            raise StoreError(f"the controller does not activate bank {bank}: busy")
        self._device.activate(bank)
        self._scene.link.check()

    def touch_towards(self, target_mm: Vector, *, feed_mm_per_s: float) -> Touch | Miss:
        self._process.check()
        late = self._scene.aborted
        self._scene.link.check()
        touched = self._device.touch_towards(target_mm, feed_mm_per_s=feed_mm_per_s)
        if late:
            self._scene.touches_after_abort += 1
        self._scene.link.check()
        return touched


class RequestScene:
    """Machine, link, state directory and the present owner of the machine. `aborted` is True from the abort of a run
    until the next one begins."""

    def __init__(self, directory: Path, owned: Ownership, journals: JournalGuard) -> None:
        settings, machine = prepare_case(directory)
        document = settings.model_dump()
        document["devices"]["person"] = {"driver": CONSOLE}
        document["roles"]["operator"] = "person"
        document["state_directory"] = directory / "state"
        document["machine"] = _without_deflection(settings.machine, directory)
        self.settings = Settings.model_validate(document)
        document["stations"]["standing_at"] = None
        self.settings_that_ask = Settings.model_validate(document)
        self.world: World = machine.world
        self.world.controller.write_bank(FORMER_BANK, FORMER_TABLE)
        self.world.controller.activate(FORMER_BANK)
        self.link, self.turnstile = CuttableLink(), Turnstile()
        self.aborted = self.refuses_activation = False
        self.touches_after_abort = 0
        self._directory, self._owned = directory, owned
        self._journals, self._process = journals, OwnerProcess()
        self.event_log = EventLog()
        self.reports = ReportQueue(self.state_directory, lambda *_: {})
        self.owner = self._new_owner(self.settings)

    @property
    def state_directory(self) -> Path:
        return self.settings.state_directory

    @property
    def table(self) -> tuple[int, int]:
        """Active bank of the controller and the CRC-32 of its table, 0 if there is none."""
        controller = self.world.controller
        bank = controller.active_bank
        return bank, table_digest(controller.banks[bank]) if bank in controller.banks else 0

    @property
    def position_mm(self) -> list[float]:
        return [float(axis) for axis in self.world.controller.displayed_position()]

    @property
    def probe_deflected(self) -> bool:
        """True if the tip stands on a ball, as it does after a touch that the controller ended without the agent."""
        return self.world.controller.probe_deflected

    def restart(self) -> None:
        """Replace the owner by a new one on the same state directory, as a restart of the service does."""
        self.event_log, self._process = EventLog(), OwnerProcess()
        self.owner = self._new_owner(self.owner.settings)

    def kill(self) -> None:
        """Kill the owner, and start a new one once the motion that it left to the controller has ended."""
        self._process.killed = True
        while self.turnstile.let_pass(10_000, stops_at_states=False):
            pass
        if not self.owner.wait(PATIENCE_S):
            raise RuntimeError("the killed run did not end")
        self.world.advance_to(self.world.now + SETTLE_S)
        self.restart()

    def _new_owner(self, settings: Settings) -> Owner:
        state, process = self.state_directory, self._process
        parts = OwnerParts(
            config=self._directory / "volcal.toml",
            event_log=self.event_log,
            board=StatusBoard("case-study", self.event_log),
            health=Health(VirtualClock().now, hang_timeout_s=30.0, computing_s=900.0),
            ownership=self._owned,
            journal_state=KillableJournalState(state, process),
            reports=self.reports,
            machine=MachineAccess(
                Devices(self._rig_of(process), lambda _: TurnstileClock(self.world, self.turnstile, process))
            ),
            carry_out=self._carry_out,
            resume=self._resume,
            circumstances=lambda: AT_NIGHT,
        )
        return Owner(settings, parts)

    def _rig_of(self, process: OwnerProcess) -> Callable[[Settings, Clock, Path], Rig]:
        def assembled(_: Settings, clock: Clock, __: Path) -> Rig:
            simulated = SimulatedMachineDevice(self.world, KillableClock(clock, self.world, None))
            device: Any = LinkedDevice(simulated, self, process)
            return Rig({"twin": device}, device, device, {1: device}, device, device, device, clock)

        return assembled

    def _carry_out(
        self, job: Job, kind: Kind, base: Path, hooks: RunHooks, *, run_id: str, asked: dict[str, object]
    ) -> RunResult:
        with self._journals.run_of(self._process), self.turnstile.run():
            return carry_out(job, kind, base, self._stopping(hooks), run_id=run_id, asked=asked)

    def _resume(self, state_directory: Path, hooks: RunHooks, *, asked: dict[str, object]) -> RunResult:
        with self._journals.run_of(self._process), self.turnstile.run():
            return resume(state_directory, self._stopping(hooks), asked=asked)

    def _stopping(self, hooks: RunHooks) -> RunHooks:
        """Return hooks with which a run stands at the turnstile also after each announcement of a state."""

        def announce(announcement: Announcement) -> None:
            hooks.announce(announcement)
            if announcement.kind == "state":
                self.turnstile.pass_through(at_state=True)

        return dataclasses.replace(hooks, announce=announce, write_files=False)


def _without_deflection(machine: Path, directory: Path) -> Path:
    """Write a copy of a machine file without its table of deflections, whose reading takes most of the time of a
    refused start, and return its path."""
    text, _ = machine.read_text(encoding="utf-8").split("[deflection]")
    copy = directory / "machine.toml"
    copy.write_text(text, encoding="utf-8")
    return copy


@contextmanager
def scene_in(directory: Path) -> Iterator[RequestScene]:
    """Yield a new scene in an empty directory. At the end of the `with` block, its run is aborted and ended."""
    journals = JournalGuard()
    with ownership(directory / "state", "the service (process 1)") as owned, journals.installed():
        scene = RequestScene(directory, owned, journals)
        try:
            yield scene
        finally:
            scene.link.cut = scene.refuses_activation = False
            scene.owner.abort("end of the trial")
            while scene.turnstile.let_pass(10_000, stops_at_states=False):
                pass
            ended = scene.owner.wait(PATIENCE_S)
            if not (ended and scene.reports.close(PATIENCE_S)):
                raise RuntimeError("the run or the reports did not end")
