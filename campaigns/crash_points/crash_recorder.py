"""Crash points of one run: copies of the process in which the run ends at once, and volcal is started again."""

from __future__ import annotations

import os
import shutil
import sqlite3
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from agent.execution import steps as s
from agent.execution.engine import Action
from agent.execution.journal_reader import JournalReader
from agent.execution.journal_schema import FILE_NAME
from agent.execution.rig import Rig
from agent.settings.schema import Settings
from campaigns.aborts.forked_copies import Forks
from campaigns.faults.fault_injector import FaultInjector
from campaigns.faults.fault_kinds import KILLED, KINDS
from campaigns.faults.judgement import EndedRun
from campaigns.faults.night_record import NightRecord
from campaigns.faults.nights import CHILD_TIMEOUT_S, judge_night, received_record
from campaigns.faults.planned_night import Morning, PlannedNight
from drivers.clock import Clock

STATE = Path("state")
"""State directory. The path is relative, so that a copy of the process uses a copy of it in its working directory."""
COMMANDS = ("move_to", "touch_towards", "orient_to", "stage", "activate", "reset")
MOVING = ("move_to", "touch_towards", "orient_to")
BEFORE_COMMIT, AFTER_COMMIT = "before a commit", "after a commit"
BEFORE_COMMAND, IN_MOTION, AFTER_COMMAND = "before a command", "in a motion", "after a command"
POINTS = (BEFORE_COMMIT, AFTER_COMMIT, BEFORE_COMMAND, IN_MOTION, AFTER_COMMAND)
MEASURING = ("measure/", "verify/", "probe/")
MORNINGS: tuple[tuple[Morning, ...], ...] = (
    ("resume", "restart"),
    ("restart, then resume", "restart"),
    ("give up",),
    ("restart",),
)
MORNING_SHARES = (0.5, 0.3, 0.1, 0.1)
SHORTEST_S, LONGEST_S = 0.01, 60.0


def journal_reader() -> JournalReader:
    """Return a reader of the journal in the working directory. Its connection stays open until the process ends."""
    return JournalReader(sqlite3.connect(STATE / FILE_NAME, isolation_level=None))


@dataclass(frozen=True)
class PointSelection:
    """Random selection of the crash points of one worker.

    One point in `every` is selected while the run measures, and one in `every_other` otherwise. `share` of `shares`
    workers takes its part of them.
    """

    seed: int
    every: int
    every_other: int
    share: int
    shares: int

    def selects(self, ordinal: int, key: str) -> bool:
        """Return True if the point with this number, in the step `key`, is selected."""
        rng = np.random.default_rng([self.seed, ordinal, 1])
        every = self.every if key.startswith(MEASURING) else self.every_other
        return int(rng.integers(every)) == 0 and int(rng.integers(self.shares)) == self.share


@dataclass
class CrashRecorder:
    """Object that forks a copy of the process at each selected point of a run.

    In the copy the run ends there: nothing of it is executed any more, and no file that it has open is flushed or
    closed. What a killed process leaves is what the operating system holds of its files, so the copy continues with a
    copy of the state directory. If `aborted_at` is not empty, a person aborts the run at the first step whose key
    begins with it. `counted` is the number of all points by kind, and `records` are the results.
    """

    injector: FaultInjector
    selection: PointSelection
    aborted_at: str = ""
    forks: Forks = field(default_factory=lambda: Forks(CHILD_TIMEOUT_S))
    counted: dict[str, int] = field(default_factory=lambda: dict.fromkeys(POINTS, 0))
    records: list[tuple[str, NightRecord]] = field(default_factory=list)
    key: str = ""
    over: bool = False

    def rig(self, clock: Clock, settings: Settings) -> Rig:
        """Return the rig of the run, with points around its commands; in a copy that of the run that is started
        again."""
        rig = self.injector.rig(clock, settings)
        if not self.over:
            self.injector.scene.machine.alter(**{name: self._watched(name) for name in COMMANDS})
        return rig

    def answers(self, actions: Mapping[type, Action]) -> Mapping[type, Action]:
        """Return the actions wrapped so that the step of a point is known."""
        return {kind: self._noted(action) for kind, action in self.injector.answers(actions).items()}

    def _noted(self, action: Action) -> Action:
        def perform(step: s.Step) -> Any:
            self.key = step.key
            if self.aborted_at and step.key.startswith(self.aborted_at) and not self.over:
                self.aborted_at = ""
                self.injector.kinds.append("abort")
                KINDS["abort"].apply(self.injector.scene, np.random.default_rng(0))
            return action(step)

        return perform

    def _watched(self, name: str) -> Callable[..., Any]:
        def call(real: Callable[..., Any], *values: Any, **named: Any) -> Any:
            self.notify(BEFORE_COMMAND)
            if name in MOVING:
                self._arrange_in_motion()
            result = real(*values, **named)
            self.notify(AFTER_COMMAND)
            return result

        return call

    def _arrange_in_motion(self) -> None:
        """Arrange the point in the middle of the motion that begins with the next wait."""
        scene = self.injector.scene
        clock, world = scene.clock, scene.world

        def begun(now_s: float, _: float) -> None:
            clock.watch = None
            ends = (world.controller.motion_ends_s, world.workpiece.mount.settled_s)
            end_s = max((instant for instant in ends if instant is not None), default=now_s)
            if end_s > now_s:
                clock.at(0.5 * (now_s + end_s), lambda: self.notify(IN_MOTION))

        if not self.over:
            clock.watch = begun

    def notify(self, point: str) -> None:
        """Let the process be killed here in a copy, if this point is selected."""
        if self.over:
            return
        ordinal = sum(self.counted.values())
        self.counted[point] += 1
        if not self.selection.selects(ordinal, self.key):
            return
        rng = np.random.default_rng([self.selection.seed, ordinal])
        mornings = MORNINGS[int(rng.choice(len(MORNINGS), p=MORNING_SHARES))]
        night = PlannedNight(self.selection.seed, ordinal, KILLED, 1.0, f"{point}: {self.key}", mornings=mornings)
        result = self.forks.fork()
        if result is not None:
            now_s = self.injector.scene.clock.now()
            self.records.append((point, received_record(night, result, now_s)))
            return
        self.over = True
        settle_s = float(np.exp(rng.uniform(np.log(SHORTEST_S), np.log(LONGEST_S))))
        copied = Path.cwd() / f"copy-{ordinal}"
        try:
            self.injector.end_run()
            shutil.copytree(STATE, copied / STATE)
            os.chdir(copied)
            run = EndedRun(self.injector, None, None, Path(), killed=True, settle_s=settle_s)
            document = asdict(judge_night(night, run, self.rig))
        except BaseException as error:  # noqa: BLE001  a copy must never continue as its parent
            document = {"failures": [f"could not be judged: {error!r}"]}
        shutil.rmtree(copied, ignore_errors=True)
        self.forks.send_and_exit(document)


@contextmanager
def watched_commits(notify: Callable[[str], None]) -> Iterator[None]:
    """Call `notify` before and after each commit of every database that is opened in the `with` block."""
    real = sqlite3.connect

    class WatchedConnection(sqlite3.Connection):
        """Connection in the mode in which each statement outside of a transaction is committed at once."""

        def execute(self, sql: str, *values: Any) -> sqlite3.Cursor:
            verb = sql.lstrip()[:6].upper()
            if verb != "COMMIT" and (self.in_transaction or verb not in ("INSERT", "UPDATE", "DELETE")):
                return super().execute(sql, *values)
            notify(BEFORE_COMMIT)
            cursor = super().execute(sql, *values)
            notify(AFTER_COMMIT)
            return cursor

    def connect(*values: Any, **options: Any) -> sqlite3.Connection:
        opened: sqlite3.Connection = real(*values, **options, factory=WatchedConnection)
        return opened

    sqlite3.connect = connect  # type: ignore[assignment]
    try:
        yield
    finally:
        sqlite3.connect = real
