"""Trial in which one run is interrupted at each instant of each step, resumed, and compared with the uninterrupted run.

The uninterrupted run continues to its end. At each of several instants of each of its steps (`MOMENTS`, from before the
step until its result is durable), the process is forked and the state directory is copied. In the copy the run is
killed. Then the run is resumed, with the machine in the state in which the kill left it. Every figure of every copy
must equal the figure of the uninterrupted run, every touch must be recorded exactly once, and the compensation table
must be the same.

    python -m campaigns.resume [--every 1] [--moments before,begun,midway,done,durable]

The output ends with one line of JSON. The exit code is 0 only if there is no difference.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import sys
import traceback
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from time import perf_counter
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # must be set before numpy is imported

from agent.execution.journal_reader import open_journal
from agent.execution.steps import Step
from benchmarks.places import memory_directory
from campaigns.resume.case import (
    MOMENTS,
    STATE,
    Killed,
    KillSwitch,
    ResumeMachine,
    cache_preflight,
    patch_journal,
    prepare_case,
    signature,
)


@dataclass
class InterruptionRecorder:
    """Recorder that forks a copy of the run at each selected instant of a step, and kills the run in this copy at that
    instant.

    The recorder keeps a list of these instants. Each copy writes its result to a file in the directory `results`.
    """

    machine: ResumeMachine
    every: int
    moments: Sequence[str]
    results: Path
    kill_switch: KillSwitch = field(init=False)
    steps: int = 0
    points: list[tuple[str, str]] = field(default_factory=list)
    only: str = ""
    in_copy: bool = False

    def __post_init__(self) -> None:
        self.kill_switch = KillSwitch(self.notify)

    def notify(self, moment: str, step: Step) -> None:
        self.kill_switch.check()
        if self.in_copy:
            if self.kill_switch.midway:  # a step without a wait has no middle: it is done
                self.kill_switch.kill()
            return
        self.steps += moment == "durable"
        if moment not in self.moments or (step.key != self.only if self.only else self.steps % self.every):
            return
        number = len(self.points)
        self.points.append((moment, step.key))
        child = os.fork()
        if child:
            os.waitpid(child, 0)
            return
        self.in_copy = True
        copied = Path.cwd() / f"copy-{number}"
        copied.mkdir()
        shutil.copytree(STATE, copied / STATE)
        os.chdir(copied)
        if moment == "midway":
            self.kill_switch.midway = True
        else:
            self.kill_switch.kill()

    def conclude(self) -> None:
        """Resume the killed run in this forked copy of the process, and write the result to a file."""
        try:
            ended = self.machine.resume()
            if ended.error is not None:
                raise ended.error
            result = signature(self.machine) | {"again": repeated_measurements()}
        except BaseException:  # noqa: BLE001  the copy reports any failure
            result = {"error": traceback.format_exc()}
        number = len(self.points) - 1
        (self.results / f"{number}.json").write_text(json.dumps(result))
        shutil.rmtree(Path.cwd(), ignore_errors=True)


def repeated_measurements() -> list[Any]:
    """Return all measurement keys that occur more than once in the journal, among the touches with a result and among
    the balls.
    """
    with open_journal(STATE) as reader:
        [run] = reader.runs()
        keys = [[row.key for row in rows] for rows in (reader.touches(run.run), reader.balls(run.run))]
    return [key for counted in map(Counter, keys) for key, count in counted.items() if count > 1]


def compare_interrupted(every: int, moments: Sequence[str], only: str = "") -> dict[str, Any]:
    began = perf_counter()
    with _working_directory() as directory:
        settings, machine = prepare_case(directory)
        cache_preflight()
        breaks = InterruptionRecorder(machine, every, moments, directory, only=only)
        restore = patch_journal(breaks.kill_switch)
        try:
            ended = machine.run(settings, breaks.kill_switch)
        except Killed:
            ended = None
        finally:
            restore()
        if breaks.in_copy:
            breaks.conclude()
            os._exit(0)
        assert ended is not None
        if ended.error is not None:
            raise ended.error
        through = json.loads(json.dumps(signature(machine)))
        differing = [found for found in _differences(breaks, through) if found]
        return {
            "state": ended.outcome.state.value,
            "steps": breaks.steps,
            "breaks": len(breaks.points),
            "touches": len(through["touches"]),
            "balls": len(through["balls"]),
            "differing": len(differing),
            "first": differing[:5],
            "seconds": round(perf_counter() - began, 1),
        }


def _differences(breaks: InterruptionRecorder, through: dict[str, Any]) -> Iterator[str]:
    for number, (moment, key) in enumerate(breaks.points):
        path = breaks.results / f"{number}.json"
        found = json.loads(path.read_text()) if path.exists() else {"error": "no result"}
        wrong = [name for name, value in through.items() if found.get(name) != value]
        wrong += found.get("again", [])
        yield f"{moment} {key}: {found.get('error') or wrong}" if wrong else ""


@contextmanager
def _working_directory() -> Iterator[Path]:
    former = Path.cwd()
    with memory_directory("resume") as root:
        os.chdir(root)
        try:
            yield Path(root)
        finally:
            os.chdir(former)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--every", type=int, default=1, help="interrupt at each K-th step")
    parser.add_argument("--moments", default=",".join(MOMENTS), help="instants of a step at which to interrupt")
    parser.add_argument("--only", default="", metavar="KEY", help="interrupt only at this step")
    given = parser.parse_args()
    result = compare_interrupted(given.every, given.moments.split(","), given.only)
    print(json.dumps(result))
    sys.exit(1 if result["differing"] or result["state"] != "complete" else 0)
