"""Kills of the service at its commits and its writes to the controller, and of the simulated machine at each command
for a table; how each is judged."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.random import Generator

from agent.execution.states import RunState
from campaigns.crash_points.service_scene import WEIGHT, Document, ServiceScene

SERVICE, MACHINE = "service", "machine"
CALIBRATION, RESTORATION, RECOVERY = "calibration", "restoration", "recovery"
NO_COLLISION, COMPLETE = "no collision", "active table complete"
PROVED, JOURNALED = "former table or a proved one", "acknowledged means journaled"
STATED, RESUMED = "stated end", "resumed to the end"
S_PER_MIN = 60.0
INVARIANTS = (NO_COLLISION, COMPLETE, PROVED, JOURNALED, STATED, RESUMED)
FARTHEST = 6000
"""Largest weight of the points between two kills in a calibration; a whole one has some 20,000."""
RECOVERY_SHARE = 0.2
"""Share of the starts after a kill that are killed, too."""
RECOVERY_POINTS = 8
SHARES = (0.25, 0.45, 0.27, 0.03)
"""Shares of the kills of the service in calibrations and restorations, and of the machine in restorations and
calibrations."""


@dataclass
class ProcessKill:
    """One kill: the victim, the point at which it died, what was going on, and what was wrong afterwards, by
    invariant."""

    victim: str
    point: str
    doing: str
    wrong: dict[str, str] = field(default_factory=dict)


def judge_machine(scene: ServiceScene) -> Iterator[tuple[str, str]]:
    """Yield what is wrong with the machine and the journal at any moment."""
    truth, lost = scene.simulator.truth, scene.lost()
    if truth.collisions:
        yield NO_COLLISION, ", ".join(truth.collisions)
    if truth.active and not truth.table[1]:
        yield COMPLETE, f"bank {truth.active} is active and empty"
    if lost:
        yield JOURNALED, lost


def judge_end(scene: ServiceScene, status: Document) -> Iterator[tuple[str, str]]:
    """Yield what is wrong with the statement about the run that was interrupted."""
    row = scene.last_run()
    if row is None or scene.is_acknowledged(row):
        return
    ended_badly = row.ended is None or row.state in ("faulted", "aborted")
    if ended_badly and not (status["state"] in ("faulted", "aborted") and status["alarms"] and status["verdict"]):
        yield STATED, f"run {row.run_id} was interrupted, and the status is {status['state']} without a cause"


def judge_table(scene: ServiceScene, status: Document) -> Iterator[tuple[str, str]]:
    """Yield what is wrong with the active table once the end of a run has been acknowledged."""
    scene.note_proved()
    table = scene.simulator.truth.table
    if status["state"] != RunState.IDLE.value:
        yield STATED, f"{status['state']} after a reset"
    if table not in scene.proved or status["unproved"] is not None:
        yield PROVED, f"table {table} is active and was not proved; proved are {sorted(scene.proved)}"


class Kills:
    """Kills in one scene. `records` are the kills so far; after `ends_s` of the monotonic clock there are no more."""

    def __init__(self, scene: ServiceScene, rng: Generator) -> None:
        self.scene, self.records = scene, list[ProcessKill]()
        self.ends_s = math.inf
        self._rng = rng

    def _goes_on(self, target: int) -> bool:
        return len(self.records) < target and time.monotonic() < self.ends_s


class ServiceKills(Kills):
    """Kills of the service while it calibrates, restores tables, and starts again."""

    def __init__(self, scene: ServiceScene, rng: Generator) -> None:
        super().__init__(scene, rng)
        self.resumed = self.given_up = self.accepted = 0

    def calibrations(self, kills: int) -> None:
        """Calibrate until so many kills have been made, and end the last calibration without a kill."""
        scene, target = self.scene, len(self.records) + kills
        first = True
        while first or self._goes_on(target):
            if not first:
                self._restore_undisturbed()
            first = False
            self._calibrate(lambda: self._distance() if self._goes_on(target) else 0)
        scene.death.arm(0)

    def restorations(self, kills: int) -> None:
        """Restore the tables of the first calibration in turn, killed at the first point, the second one and so on."""
        target, point = len(self.records) + kills, 1
        while self._goes_on(target):
            asked = self.scene.other_table()
            self.scene.death.arm(WEIGHT * (point - 1) + 1)
            answer = self.scene.post("/api/tables/restore", asked)
            if answer is not None and answer.status_code != 202:
                raise RuntimeError(f"the restoration was refused: {answer.text}")
            if answer is not None and self.scene.at_rest() is not None:
                point = 1  # the run has ended before it came to this point
                continue
            point += 1
            self._recover(RESTORATION)
        self.scene.death.arm(0)

    def _distance(self) -> int:
        return int(FARTHEST ** float(self._rng.uniform(0.3, 1.0)))

    def _calibrate(self, distance: Callable[[], int]) -> None:
        scene = self.scene
        scene.death.arm(distance())
        begin: Callable[[], bool] = self._start
        while True:
            died = not begin()
            status = None if died else scene.at_rest()
            if status is not None:
                break
            kill = self._recover(CALIBRATION)
            begin = self._next_request(kill)
            scene.death.arm(distance())
        scene.note_proved()
        self.accepted += scene.simulator.truth.table in scene.proved and status["state"] == RunState.COMPLETE.value
        if status["state"] != RunState.COMPLETE.value or not status["verdict"]:
            kill = ProcessKill(SERVICE, "none", CALIBRATION) if not self.records else self.records[-1]
            kill.wrong[RESUMED] = f"nothing disturbed the run, and it ended {status['state']}: {status['alarms']}"
            scene.post("/api/reset")

    def _start(self) -> bool:
        if self.records:  # the probe may touch a ball, and the controller be in fault
            self.scene.simulator.bring_home()
        answer = self.scene.post("/api/start", {"kind": "calibrate", "consent": True})
        if answer is not None and answer.status_code != 202:
            raise RuntimeError(f"the calibration was not started: {answer.text}")
        return answer is not None

    def _next_request(self, kill: ProcessKill) -> Callable[[], bool]:
        """Return the request with which the machine goes on after a kill: the run is resumed if it can be."""
        status = self.scene.status()
        may = [] if status is None else status["may"]
        if "resume_run" not in may:
            return self._start
        beside = self._rng.random() < 0.3
        if self._rng.random() < 0.1:
            self.given_up += 1
            self._give_up(kill, beside=beside)
            return self._start
        self.resumed += 1
        return lambda: self._resume(kill, beside=beside)

    def _resume(self, kill: ProcessKill, *, beside: bool) -> bool:
        """Resume the run, by a request or by the command beside the service. Return False if the service has died."""
        scene = self.scene
        if beside:
            code, said = scene.command("resume")
            refused = said if code and not scene.dead else ""
        else:
            answer = scene.post("/api/resume-run", {"source": "page"})
            refused = "" if answer is None or answer.status_code == 202 else answer.text
        if refused:
            kill.wrong[RESUMED] = f"the run could not be resumed: {refused}"
            self._give_up(kill, beside=False)
            return self._start()
        return scene.status() is not None

    def _give_up(self, kill: ProcessKill, *, beside: bool) -> None:
        scene = self.scene
        scene.death.arm(0)
        if beside:
            code, said = scene.command("resume", "--give-up")
            refused = said if code else ""
        else:
            answer = scene.post("/api/give-up-run")
            refused = "" if answer is not None and answer.status_code == 200 else str(answer and answer.text)
        status, row = scene.status(), scene.last_run()
        if refused or row is None or row.ended is None or status is None or status["unfinished"] is not None:
            kill.wrong[STATED] = f"the run could not be given up: {refused or (row, status and status['unfinished'])}"

    def _restore_undisturbed(self) -> None:
        scene = self.scene
        scene.death.arm(0)
        answer = scene.post("/api/tables/restore", scene.other_table("backup"))
        if answer is None or answer.status_code != 202 or scene.at_rest() is None:
            raise RuntimeError(f"the restoration between two calibrations failed: {answer and answer.text}")
        scene.note_proved()

    def _recover(self, doing: str) -> ProcessKill:
        """Start the service again after a kill, acknowledge the end of the run, and judge both. Return the kill."""
        scene = self.scene
        while True:
            scene.require_killed()
            if self._rng.random() < 0.5:
                scene.simulator.let_time_pass()
            kill = ProcessKill(SERVICE, scene.death.died_at, doing, dict(judge_machine(scene)))
            self.records.append(kill)
            again = doing != RECOVERY and self._rng.random() < RECOVERY_SHARE
            scene.death.arm(WEIGHT * int(self._rng.integers(RECOVERY_POINTS)) + 1 if again else 0)
            doing = RECOVERY
            if not scene.serve():
                continue
            status = scene.status()
            if status is None:
                continue
            kill.wrong |= dict(judge_end(scene, status))
            if scene.post("/api/reset") is None:
                continue
            scene.death.arm(0)
            status = scene.status()
            if status is not None:
                kill.wrong |= dict(judge_table(scene, status)) | dict(judge_machine(scene))
                return kill


class MachineKills(Kills):
    """Kills of the simulated machine at each command for a table, while the service goes on. After every other kill
    the machine has lost its activation, as a controller that starts without compensation."""

    def __init__(self, scene: ServiceScene, rng: Generator) -> None:
        super().__init__(scene, rng)
        self.resumed = self.left_to_a_person = 0

    def restorations(self, kills: int) -> None:
        """Restore the tables of the first calibration in turn, with the machine killed at the first point, and so
        on."""
        target, point = len(self.records) + kills, 1
        while self._goes_on(target):
            self.scene.simulator.death.arm(point)
            self._restore()
            if not self.scene.simulator.ended:
                point = 1
                continue
            point += 1
            self._recover(RESTORATION, loses=len(self.records) % 2 == 1)

    def calibrations(self, kills: int) -> None:
        """Calibrate, with the machine killed at a random command for the table; the run is resumed or given up."""
        scene, target = self.scene, len(self.records) + kills
        while self._goes_on(target):
            scene.simulator.death.arm(0)
            self._restore("backup")
            scene.simulator.death.arm(1 + int(self._rng.integers(30)))
            answer = scene.post("/api/start", {"kind": "calibrate", "consent": True})
            if answer is None or answer.status_code != 202:
                raise RuntimeError(f"the calibration was not started: {answer and answer.text}")
            scene.at_rest()
            if not scene.simulator.ended:
                scene.note_proved()
                continue
            kill = self._recover(CALIBRATION, loses=False)
            status = scene.status()
            if status is not None and "resume_run" in status["may"] and self._rng.random() < 0.7:
                self.resumed += 1
                scene.post("/api/resume-run", {"source": "page"})
                ended = scene.at_rest()
                scene.note_proved()
                if ended is None or ended["state"] != RunState.COMPLETE.value:
                    kill.wrong[RESUMED] = f"the resumed run ended {ended and (ended['state'], ended['alarms'])}"
                    scene.post("/api/reset")
            else:
                scene.post("/api/give-up-run")

    def _restore(self, role: str | None = None) -> Document:
        scene = self.scene
        answer = scene.post("/api/tables/restore", scene.other_table(role))
        if answer is None or answer.status_code != 202:
            raise RuntimeError(f"the restoration was refused: {answer and answer.text}")
        status = scene.at_rest()
        if status is None:
            raise RuntimeError("the service has died")
        scene.note_proved()
        return status

    def _recover(self, doing: str, *, loses: bool) -> ProcessKill:
        """Start the machine again, acknowledge the end of the run, and judge both."""
        scene = self.scene
        simulator = scene.simulator
        kill = ProcessKill(MACHINE, simulator.death.died_at, doing)
        self.records.append(kill)
        status = scene.status()
        if status is not None:
            kill.wrong |= dict(judge_end(scene, status))
        simulator.death.arm(0)
        if loses:
            simulator.lose_activation()
        simulator.start()
        answer, status = scene.post("/api/reset"), scene.status()
        if answer is None or status is None:
            raise RuntimeError("the service has died")
        kill.wrong |= dict(judge_machine(scene))
        if loses and simulator.truth.active == 0:
            kill.wrong |= dict(self._left(status))
        else:
            kill.wrong |= dict(judge_table(scene, status))
        return kill

    def _left(self, status: Document) -> Iterator[tuple[str, str]]:
        """Act as the person does whom volcal tells that the machine applies no compensation any more."""
        self.left_to_a_person += 1
        told = " ".join(f"{alarm['text']} {alarm['hint']}" for alarm in status["alarms"])
        if "bank" not in told:
            yield PROVED, f"no compensation acts after the loss of power, and nobody is told: {told}"
        restored = self._restore("backup")
        table = self.scene.simulator.truth.table
        if restored["state"] != RunState.COMPLETE.value or table not in self.scene.proved:
            yield PROVED, f"the restoration after the loss ended {restored['state']} with table {table}"


@dataclass
class ProcessKills:
    """Results of the kills of real processes: the kills, and how many runs were resumed, given up or accepted."""

    kills: list[ProcessKill]
    resumed: int
    given_up: int
    accepted: int
    left_to_a_person: int


def play_processes(
    directory: Path, seed: int, kills: int, minutes: float, notice: Callable[[ProcessKill], None]
) -> ProcessKills:
    """Kill the service and the machine at so many points, or for so many minutes, in the empty `directory`. `notice`
    gets each kill after which something was wrong."""
    ends_s = time.monotonic()
    scene, rng = ServiceScene(directory), np.random.default_rng(seed)
    try:
        if not scene.serve():
            raise RuntimeError("the service did not start")
        service, machine = ServiceKills(scene, rng), MachineKills(scene, rng)
        parts = (service.calibrations, service.restorations, machine.restorations, machine.calibrations)
        for part, share in zip(parts, SHARES, strict=True):
            known = len(service.records), len(machine.records)
            ends_s += share * minutes * S_PER_MIN
            service.ends_s = machine.ends_s = ends_s
            try:
                part(max(1, round(share * kills)))
            finally:
                for kill in (*service.records[known[0] :], *machine.records[known[1] :]):
                    if kill.wrong:
                        notice(kill)
    finally:
        scene.close()
    records = [*service.records, *machine.records]
    resumed = service.resumed + machine.resumed
    return ProcessKills(records, resumed, service.given_up, service.accepted, machine.left_to_a_person)


def violations(records: list[ProcessKill]) -> Mapping[str, int]:
    """Return the number of kills that violate each invariant."""
    return {name: sum(name in kill.wrong for kill in records) for name in INVARIANTS}
