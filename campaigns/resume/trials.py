"""A run broken off at each instant of each step, gone on with, and compared with the one that was never broken off.

One run goes through; at every instant a copy of the process and of its state directory is made, in which the run dies
there and is then gone on with on the machine as it was left. Every figure of every copy must be that of the run that
went through, every touch made once, and the table the same.

    python -m campaigns.resume [--every 1] [--moments before,begun,midway,done,durable]

ends with one JSON line, and with exit code 0 only where nothing differs.
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

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # said before numpy is first imported

from agent.execution.journal_reader import open_journal
from agent.execution.steps import Step
from benchmarks.places import memory_directory
from campaigns.resume.case import (
    MOMENTS,
    STATE,
    Fuse,
    Killed,
    Machine,
    cache_preflight,
    fused_journal,
    prepare,
    signature,
)


@dataclass
class Breaks:
    """Where copies broke off, and what became of them."""

    machine: Machine
    every: int
    moments: Sequence[str]
    results: Path
    fuse: Fuse = field(init=False)
    steps: int = 0
    points: list[tuple[str, str]] = field(default_factory=list)
    only: str = ""
    in_copy: bool = False

    def __post_init__(self) -> None:
        self.fuse = Fuse(self.tell)

    def tell(self, moment: str, step: Step) -> None:
        self.fuse.check()
        if self.in_copy:
            if self.fuse.midway:  # a step in which nothing has to be waited for has no middle: it is done
                self.fuse.burn()
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
            self.fuse.midway = True
        else:
            self.fuse.burn()

    def conclude(self) -> None:
        """In a copy: go on with the run that has died, and write down what came of it."""
        try:
            ended = self.machine.resume()
            if ended.error is not None:
                raise ended.error
            result = signature(self.machine) | {"again": measured_twice()}
        except BaseException:  # noqa: BLE001  whatever it was, the copy has to tell
            result = {"error": traceback.format_exc()}
        number = len(self.points) - 1
        (self.results / f"{number}.json").write_text(json.dumps(result))
        shutil.rmtree(Path.cwd(), ignore_errors=True)


def measured_twice() -> list[Any]:
    """Touches with a result, and balls, that the procedure has more than once."""
    with open_journal(STATE) as reader:
        [run] = reader.runs()
        keys = [[row.key for row in rows] for rows in (reader.touches(run.run), reader.balls(run.run))]
    return [key for counted in map(Counter, keys) for key, count in counted.items() if count > 1]


def compared(every: int, moments: Sequence[str], only: str = "") -> dict[str, Any]:
    began = perf_counter()
    with _working_directory() as directory:
        settings, machine = prepare(directory)
        cache_preflight()
        breaks = Breaks(machine, every, moments, directory, only=only)
        unfuse = fused_journal(breaks.fuse)
        try:
            ended = machine.run(settings, breaks.fuse)
        except Killed:
            ended = None
        finally:
            unfuse()
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


def _differences(breaks: Breaks, through: dict[str, Any]) -> Iterator[str]:
    for number, (moment, key) in enumerate(breaks.points):
        path = breaks.results / f"{number}.json"
        found = json.loads(path.read_text()) if path.exists() else {"error": "nothing came of it"}
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
    parser.add_argument("--every", type=int, default=1, help="once in so many steps")
    parser.add_argument("--moments", default=",".join(MOMENTS), help="which instants of a step")
    parser.add_argument("--only", default="", metavar="KEY", help="only at this step")
    given = parser.parse_args()
    result = compared(given.every, given.moments.split(","), given.only)
    print(json.dumps(result))
    sys.exit(1 if result["differing"] or result["state"] != "complete" else 0)
