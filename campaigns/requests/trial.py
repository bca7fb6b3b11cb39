"""Trial of one owner of the machine: requests at any moment of a run, each judged by what the status offered before."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from agent.execution.journal_reader import has_journal, open_journal
from agent.execution.journal_rows import RunRow
from agent.execution.states import RunState
from agent.runs.run_kinds import KINDS
from agent.runs.run_request import SOURCES, RunRequest
from agent.service.control import Status
from campaigns.requests.scene import PATIENCE_S, SETTLE_S, RequestScene, scene_in
from drivers.errors import LinkError, StoreError, VolcalError

S = RunState
Choose = Callable[[int], int]
"""Function that returns a number from 0 to below its argument."""

# Written by hand from the documents, not from the tables under test.
AT_REST = {S.IDLE, S.COMPLETE, S.REFUSED, S.ABORTED, S.FAULTED}
NEXT: dict[RunState, set[RunState]] = {
    S.IDLE: {S.PREFLIGHT, S.IDLE},
    S.COMPLETE: {S.PREFLIGHT, S.IDLE},
    S.REFUSED: {S.PREFLIGHT, S.IDLE},
    S.ABORTED: {S.IDLE},
    S.FAULTED: {S.IDLE},
    S.PREFLIGHT: {S.PREFLIGHT, S.RESUMING, S.MEASURING, S.STAGING, S.REFUSED, S.COMPLETE},
    S.RESUMING: {S.RESUMING, S.REFUSED, S.MEASURING, S.IDENTIFYING, S.STAGING, S.ACTIVATING, S.VERIFYING, S.RESTORING},
    S.MEASURING: {S.IDENTIFYING, S.RESTORING, S.HELD, S.REFUSED},
    S.HELD: {S.MEASURING, S.VERIFYING},
    S.IDENTIFYING: {S.STAGING, S.REFUSED, S.COMPLETE},
    S.STAGING: {S.ACTIVATING},
    S.ACTIVATING: {S.VERIFYING},
    S.VERIFYING: {S.COMPLETE, S.RESTORING, S.HELD},
    S.RESTORING: {S.COMPLETE},
    S.ABORTING: {S.ABORTED, S.FAULTED},
}
MOVES_ON = {S.ABORTING, S.ABORTED, S.FAULTED}
"""States that may follow each state of a run."""
SETTLING = {"restore_former", "give_up"}
STANDING_MM = 1e-6
LONGEST_PASS = 400
DEFLECTED = "the probe is deflected"
"""Words with which a touch, a move or the check of the probe is refused while the tip stands on a ball."""


@dataclass
class Count:
    """Counts of what happened: actions by name, accepted and refused requests by name, ends of runs by state, and the
    violations found."""

    steps: Counter[str] = field(default_factory=Counter)
    accepted: Counter[str] = field(default_factory=Counter)
    refusals: Counter[str] = field(default_factory=Counter)
    ends: Counter[str] = field(default_factory=Counter)
    states: Counter[str] = field(default_factory=Counter)
    violations: list[str] = field(default_factory=list)

    def add(self, other: Count) -> None:
        """Add the counts of another trial."""
        for name, its in vars(other).items():
            setattr(self, name, getattr(self, name) + its)


class RequestTrial:
    """Owner of a simulated machine, and the model with which each of its answers is compared."""

    def __init__(self, directory: Path, count: Count) -> None:
        self.count = count
        self._stack = ExitStack()
        self.scene: RequestScene = self._stack.enter_context(scene_in(directory))
        self._proved = {self.scene.table}
        self._runs = 0
        self._running = self._closed = self._answered = self._hindered = self._unattended = False
        self._began_deflected = False
        self._killed: set[str] = set()
        self._history: list[str] = []
        self._shown = S.IDLE
        self._listen()

    def close(self) -> None:
        self._stack.close()

    def perform(self, action: str, choose: Choose) -> None:
        """Carry out one of `ACTIONS` and compare everything with the model."""
        self.count.steps[action] += 1
        self._history.append(action)
        ACTIONS[action](self, choose)
        self.check()

    # ------------------------------------------------------------------ requests

    def start(self, choose: Choose) -> None:
        kind, source, consent = KINDS[choose(len(KINDS))], SOURCES[choose(len(SOURCES))], choose(4) > 0
        known = self.scene.owner.settings.stations.standing_at is not None
        request = RunRequest(kind=kind, source=source, consent=consent)
        may_be_refused = not known and not (consent and kind != "nightly")
        if self._begin("start", lambda: self.scene.owner.start(request), may_be_refused=may_be_refused):
            self._unattended = not consent  # a question that nobody answers ends it

    def restore_table(self, choose: Choose) -> None:
        tables = self.stored_tables()
        run_id, role = tables[choose(len(tables))]
        source = SOURCES[choose(len(SOURCES))]
        unknown = run_id == "unknown"
        self._begin(
            "restore_table", lambda: self.scene.owner.restore_table(run_id, role, source), may_be_refused=unknown
        )

    def resume_run(self, choose: Choose) -> None:
        source = SOURCES[choose(len(SOURCES))]
        self._begin("resume_run", lambda: self.scene.owner.resume_run(source), may_be_refused=False)

    def hold(self, _: Choose) -> None:
        status = self._status
        # a run that is held, also one that is about to continue, stays held
        self._ask("hold", self.scene.owner.hold, "hold" in status.may or status.state is RunState.HELD)

    def resume(self, _: Choose) -> None:
        self._ask("resume", self.scene.owner.resume, "resume" in self._status.may)

    def abort(self, _: Choose) -> None:
        if self._running:
            self.scene.aborted = True
        self._ask("abort", lambda: self.scene.owner.abort("pressed"), True)

    def reset(self, _: Choose) -> None:
        accepted = self._ask("reset", self.scene.owner.reset, not self._running)
        if accepted and self._status.state is not S.IDLE:
            self._violated(f"{self._status.state.value} after a reset")

    def answer(self, choose: Choose) -> None:
        question = self._status.question
        offset = choose(3) - 1
        number = 1 if question is None else question.number + offset
        allowed = "answer" in self._status.may and offset == 0 and not self._answered
        if self._ask("answer", lambda: self.scene.owner.answer(number, choose(5) > 0), allowed):
            self._answered = True

    def restore_former(self, _: Choose) -> None:
        self._settle("restore_former", self.scene.owner.restore_former)

    def give_up(self, _: Choose) -> None:
        given_up = self._status.unfinished  # an earlier run may be unfinished, too
        if self._settle("give_up", self.scene.owner.give_up) and self._status.unfinished == given_up is not None:
            self._violated("a run is unfinished although it was given up")

    def _settle(self, name: str, request: Callable[[], None]) -> bool:
        accepted = self._ask(name, request, name in self._status.may)
        if accepted and (self._status.unproved is not None or self.scene.table not in self._proved):
            self._violated(f"{name} was accepted, and table {self.scene.table} is active without a proof")
        return accepted

    def reload(self, choose: Choose) -> None:
        settings = (self.scene.settings, self.scene.settings_that_ask)[choose(2)]
        self._ask("reload", lambda: self.scene.owner.reload(settings), not self._running)

    def read_idle(self, _: Choose) -> None:
        before = self._frozen()
        self.scene.owner.read_idle()
        if self._frozen()[:2] != before[:2]:
            self._violated("a reading between runs changed the state")

    def end_service(self, _: Choose) -> None:
        """Close the service, which interrupts its run, or start it again if it was closed and its run has ended."""
        if self._closed and not self._running:
            self.scene.restart()
            self._closed = False
            self._listen()
            return
        ended = self.scene.owner.close(0.0)
        self._closed = True
        if ended is self._running:
            self._violated(f"close says that the run ended: {ended}")

    def kill(self, _: Choose) -> None:
        """Kill the process of the service, with the run in progress if there is one, and start it again."""
        run_id, killed = self._status.run_id, self._running
        self.scene.kill()
        self._running = self._closed = False
        self._listen()
        if not killed:
            return
        self.count.ends["killed"] += 1
        row = self._row_of(run_id)
        if row is not None and self._is_proved(row):
            self._proved.add(self.scene.table)
        if row is not None and row.ended is None:
            self._killed.add(row.run_id)

    # ------------------------------------------------------------------ time and faults

    def cut_or_connect(self, choose: Choose) -> None:
        self.scene.link.cut = choose(4) == 0
        self._hindered = self._hindered or self.scene.link.cut

    def refuse_or_permit(self, choose: Choose) -> None:
        """Let the controller refuse to activate a bank from now on, or activate it again."""
        self.scene.refuses_activation = choose(3) == 0
        self._hindered = self._hindered or self.scene.refuses_activation

    def go_on(self, choose: Choose) -> None:
        longest = (3, 40, LONGEST_PASS)[choose(3)]
        self._pass(1 + choose(longest), stops_at_states=False)

    def go_to_the_next_state(self, _: Choose) -> None:
        self._pass(20_000, stops_at_states=True)

    def _pass(self, times: int, *, stops_at_states: bool) -> None:
        if self._running and not self.scene.turnstile.let_pass(times, stops_at_states=stops_at_states):
            self._conclude()

    # ------------------------------------------------------------------ judgement

    @property
    def at_rest(self) -> bool:
        """True if no run is in progress."""
        return not self._running

    @property
    def closed(self) -> bool:
        """True if the service was ended and has not been started again."""
        return self._closed

    @property
    def may(self) -> frozenset[str]:
        """Requests that the status offers."""
        return self._status.may

    @property
    def state(self) -> RunState:
        return self._status.state

    @property
    def _status(self) -> Status:
        return self.scene.owner.status()

    def _begin(self, name: str, begin: Callable[[], str], *, may_be_refused: bool) -> bool:
        """Request a run. Return True if it was accepted."""
        offered = ("resume_run" if name == "resume_run" else "start") in self._status.may and not self._closed
        # A start first takes back an unproved table; the status shows what the last comparison has found.
        restored_first = self._status.unproved is not None and not self._running and not self._closed
        excused = may_be_refused or restored_first
        deflected = self.scene.probe_deflected  # before the run can move the axes
        if not self._ask(name, begin, offered, excused=excused):
            return False
        self._runs += 1
        self._running, self.scene.aborted = True, False
        self._began_deflected = deflected
        self._hindered = self.scene.link.cut or self.scene.refuses_activation
        self._answered = self._unattended = False
        if self.scene.table not in self._proved and name != "resume_run":  # which proves the table
            self._violated(f"{name} accepted while an unproved table is active")
        self.scene.turnstile.await_run(self._runs)
        return True

    def _ask(self, name: str, request: Callable[[], object], allowed: bool, *, excused: bool = False) -> bool:
        """Make a request. Return True if it was accepted; compare the answer with `allowed`."""
        before, may = self._frozen(), sorted(self._status.may)
        try:
            request()
        except VolcalError as error:
            self.count.refusals[name] += 1
            unreached = self.scene.link.cut and isinstance(error, LinkError)
            unpermitted = self.scene.refuses_activation and isinstance(error, StoreError) and name in SETTLING
            if allowed and not (excused or unreached or unpermitted):
                self._violated(f"{name} refused although it was offered: {error!r}, may {may}")
            if not str(error).strip():
                self._violated(f"{name} refused without a reason")
            if self._frozen() != before and not (excused and self.scene.table in self._proved):
                self._violated(f"{name} was refused ({error!r}) and changed {before} to {self._frozen()}")
            return False
        self.count.accepted[name] += 1
        if not (allowed or excused):
            self._violated(f"{name} accepted although it was not offered: state {before[0]}, may {may}")
        return True

    def _frozen(self) -> tuple[Any, ...]:
        """Return everything that no refusal may change: state and run shown, place of the axes, active table."""
        status = self._status
        return status.state, status.run_id, self.scene.position_mm, self.scene.table

    def _conclude(self) -> None:
        scene = self.scene
        if not scene.owner.wait(PATIENCE_S):
            self._violated("the owner did not release the machine after the end of the run")
        self._running = False
        status, place = self._status, scene.position_mm
        self.count.ends[status.state.value] += 1
        self._killed.discard(str(status.run_id))
        if status.verdict is None:
            self._violated(f"the end {status.state.value} is not stated")
        if status.state is S.COMPLETE and scene.table not in self._proved:
            self._prove(status)
        elif scene.table not in self._proved and not self._hindered:
            self._violated(f"table {scene.table} is active after {status.state.value} without a proof")
        if status.state in {S.ABORTED, S.FAULTED, S.REFUSED} and not status.alarms:
            self._violated(f"{status.state.value} without a cause")
        excused = self._hindered or self._closed or self._unattended or self._refused_to_press(status)
        if status.state is S.FAULTED and not excused:
            self._violated(f"{status.kind} faulted on a sound machine: {status.alarms[0].text}")
        scene.world.advance_to(scene.world.now + SETTLE_S)
        moved = max(abs(now - then) for now, then in zip(scene.position_mm, place, strict=True))
        if moved > STANDING_MM and not self._hindered:
            self._violated(f"the axes moved by {moved:g} mm after the end {status.state.value}")

    def _refused_to_press(self, status: Status) -> bool:
        """Return True if the run began with a deflected probe, which it rightly refuses to move, and ended for that."""
        return self._began_deflected and any(DEFLECTED in alarm.text for alarm in status.alarms)

    def _prove(self, status: Status) -> None:
        """Add the active table to the proved ones if the journal proves it."""
        row = self._journal_row(status)
        if row is not None and self._is_proved(row):
            self._proved.add(self.scene.table)
        else:
            bank, digest = self.scene.table
            self._violated(f"{status.kind} completed with table {bank}, {digest}, which was not proved")

    def _is_proved(self, row: RunRow) -> bool:
        """Return True if the run has activated the active table, and its restoration was asked for, or the journal has
        its acceptance and the touches of its verification."""
        with open_journal(self.scene.state_directory) as reader:
            staged = [(one.bank, one.crc32 or 0) for one in reader.tables(row.run) if one.role == "staged"]
            if self.scene.table not in staged:
                return False
            if row.kind == "restore":
                return reader.has_decision(row.run, ("table-restored",))
            verified = any(touch.key.startswith("verify/") for touch in reader.touches(row.run))
            return verified and reader.has_decision(row.run, ("accepted",))

    def check(self) -> None:
        """Compare status, events, journal and machine with each other."""
        status, scene = self._status, self.scene
        self.count.states[status.state.value] += 1
        if (status.state not in AT_REST) is not self._running or scene.owner.busy is not self._running:
            self._violated(f"state {status.state.value}, but a run is in progress: {self._running}")
        if scene.turnstile.most_inside > 1:
            self._violated("two runs at once")
        if scene.touches_after_abort:
            self._violated("touches after an abort")
            scene.touches_after_abort = 0
        if scene.world.collisions:
            self._violated(f"collisions {scene.world.collisions}")
            scene.world.collisions.clear()
        self._check_events()
        row = self._journal_row(status)
        if row is not None:
            self._check_journal(status, row)

    def _check_events(self) -> None:
        while not self._events.empty():
            event = self._events.get_nowait()
            if event.kind != "state":
                continue
            state = RunState(event.data["state"])
            ends = MOVES_ON if self._shown not in AT_REST else set()
            if state not in NEXT[self._shown] | ends:
                self._violated(f"{self._shown.value} was followed by {state.value}")
            self._shown = state
        if self._shown is not self._status.state:
            self._violated(f"shown {self._status.state.value}, announced {self._shown.value}")

    def _check_journal(self, status: Status, row: RunRow) -> None:
        journaled = RunState(row.state)
        if self._running:
            resumed = status.state is S.PREFLIGHT and row.run_id in self._killed  # its journal has no end
            agrees = journaled is status.state or journaled in AT_REST or resumed
        else:
            agrees = journaled is status.state and row.ended is not None
            if status.state is S.IDLE or (status.state is S.FAULTED and row.run_id in self._killed):
                agrees = True
        if not agrees:
            self._violated(f"the journal says {row.state} (ended {row.ended}), the status {status.state.value}")

    def _journal_row(self, status: Status) -> RunRow | None:
        """Run that is shown. It need not be the last one in the journal: a later run that ended before it had measured
        does not hide one that can be resumed."""
        return self._row_of(status.run_id)

    def _row_of(self, run_id: str | None) -> RunRow | None:
        if run_id is None or not has_journal(self.scene.state_directory):
            return None
        with open_journal(self.scene.state_directory) as reader:
            return reader.run(run_id)

    def stored_tables(self) -> list[tuple[str, str]]:
        """Run and role of each stored table, and one that does not exist."""
        if not has_journal(self.scene.state_directory):
            return [("unknown", "backup")]
        with open_journal(self.scene.state_directory) as reader:
            return [("unknown", "backup"), *((one.run_id, one.role) for one in reader.latest_tables(20))]

    def _listen(self) -> None:
        self._events = self._stack.enter_context(self.scene.event_log.subscribe())
        self._shown = self._status.state

    def _violated(self, text: str) -> None:
        self.count.violations.append(f"{text} [{' '.join(self._history[-12:])}]")


ACTIONS: dict[str, Callable[[RequestTrial, Choose], None]] = {
    "start": RequestTrial.start,
    "restore_table": RequestTrial.restore_table,
    "resume_run": RequestTrial.resume_run,
    "hold": RequestTrial.hold,
    "resume": RequestTrial.resume,
    "abort": RequestTrial.abort,
    "reset": RequestTrial.reset,
    "answer": RequestTrial.answer,
    "restore_former": RequestTrial.restore_former,
    "give_up": RequestTrial.give_up,
    "reload": RequestTrial.reload,
    "read_idle": RequestTrial.read_idle,
    "end_service": RequestTrial.end_service,
    "kill": RequestTrial.kill,
    "refuse_or_permit": RequestTrial.refuse_or_permit,
    "cut_or_connect": RequestTrial.cut_or_connect,
    "go_on": RequestTrial.go_on,
    "go_to_the_next_state": RequestTrial.go_to_the_next_state,
}
"""What may happen at any moment."""
REQUESTS = tuple(ACTIONS)[: tuple(ACTIONS).index("read_idle")]
"""Names of the requests, each of which can be accepted."""
