"""Path of a program as LinuxCNC's own interpreter executes it: `rs274 -g` prints the calls of its canonical machine.

It shares nothing with `gcode`. Positions are axis positions in mm.
"""

from __future__ import annotations

import math
import os
import re
import shutil
import subprocess
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from twin.arrays import Array

RS274 = shutil.which("rs274")
_CALL = re.compile(r"^\s*\d+ N(\S*)\s+([A-Z_0-9]+)\((.*)\)\s*$")
_NUMBER = re.compile(r"-?\d+\.?\d*(?:e-?\d+)?")
_PLANES = {"CANON_PLANE_XY": (0, 1, 2), "CANON_PLANE_XZ": (2, 0, 1), "CANON_PLANE_YZ": (1, 2, 0)}
_ARC_STEP = 0.01
_ARC_SAGITTA_MM = 1e-4
_SAME_POINT_MM = 0.008
_REFERENCE_PARAMETERS = {"G28": 5161, "G30": 5181}
_STATES = {
    "SET_FEED_MODE": "mode",
    "START_SPINDLE_CLOCKWISE": "spindle",
    "START_SPINDLE_COUNTERCLOCKWISE": "spindle",
    "STOP_SPINDLE_TURNING": "spindle",
    "MIST_ON": "mist",
    "MIST_OFF": "mist",
    "FLOOD_ON": "flood",
    "FLOOD_OFF": "flood",
}


class ProgramRefused(ValueError):
    """Refusal of a program by rs274. `line` is the text of the refused line, as rs274 prints it."""

    def __init__(self, message: str, line: str) -> None:
        super().__init__(message)
        self.line = line


@dataclass(frozen=True)
class ExecutedMove:
    """One move. `number` is the N word of its block, or of the last block before it that has one; -1 before the first.

    `points` (n, 3) are dense points of the move, both ends included; those of a rapid move are its ends. `state` is
    what the machine does besides: feed in mm/min or mm per turn, feed mode, spindle and coolant.
    """

    number: int
    feed: bool
    points: Array
    state: tuple[float | str, ...]


@dataclass
class Executed:
    """Moves that were executed. `inch` is True if a part of them was printed in inches, with a resolution of 2.5 µm."""

    moves: list[ExecutedMove] = field(default_factory=list)
    inch: bool = False

    @property
    def feeds(self) -> list[Array]:
        """Points (n, 3) of each move with feed."""
        return [move.points for move in self.moves if move.feed]

    @property
    def rapids(self) -> list[Array]:
        """End (3,) of each rapid move."""
        return [move.points[-1] for move in self.moves if not move.feed]


def execute(
    program: Path,
    folder: Path,
    *,
    tools_mm: Mapping[int, Sequence[float]] | None = None,
    references_mm: Mapping[str, Sequence[float]] | None = None,
) -> Executed:
    """Execute a program from its own folder. Its tools have the length 0 unless they are given, and the reference
    points of G28 and G30 are 0. The tool table and the parameter file are written to `folder`.

    Raises ProgramRefused if rs274 refuses the program.
    """
    assert RS274 is not None
    tools, parameters = folder / "tool.tbl", folder / "rs274.var"
    # rs274 reads both files in inches.
    lengths = dict.fromkeys(range(1, 100), (0.0, 0.0, 0.0)) if tools_mm is None else tools_mm
    tools.write_text("".join(f"T{number} P{number} {_in_inches(xyz)} D0.1\n" for number, xyz in lengths.items()))
    values = {
        _REFERENCE_PARAMETERS[name] + axis: value
        for name, xyz in (references_mm or {}).items()
        for axis, value in enumerate(xyz)
    }
    parameters.write_text("".join(f"{key}\t{value / 25.4:.9f}\n" for key, value in sorted(values.items())))
    done = subprocess.run(  # noqa: S603
        [RS274, "-t", str(tools), "-v", str(parameters), "-g", program.name],
        cwd=program.parent,
        # rs274 maps a file in the home directory into memory, which several processes at once would damage.
        env={**os.environ, "HOME": str(folder)},
        stdin=subprocess.DEVNULL,
        capture_output=True,
        timeout=600.0,
        check=False,
    )
    text = done.stdout.decode(errors="replace")
    if done.returncode:
        said = done.stderr.decode(errors="replace").strip().splitlines() or [""]
        raise ProgramRefused(f"{program.name}: {text[-200:]} {' '.join(said)[-300:]}", said[-1])
    return read_calls(text)


def _in_inches(xyz: Sequence[float]) -> str:
    return " ".join(f"{letter}{value / 25.4:.9f}" for letter, value in zip("XYZ", xyz, strict=True))


def read_calls(text: str) -> Executed:
    """Read the calls of the canonical machine. The offsets are those of the calls before a move."""
    machine = _Machine()
    for line in text.splitlines():
        found = _CALL.match(line)
        if found is not None:
            if found[1].isdecimal():
                machine.number = int(found[1])
            machine.call(found[2], found[3])
    return machine.executed


class _Machine:
    def __init__(self) -> None:
        self.executed = Executed()
        self.unit = 1.0
        self.offsets = {"G5X": np.zeros(3), "G92": np.zeros(3), "TOOL": np.zeros(3)}
        self.position = np.zeros(3)
        self.plane = (0, 1, 2)
        self.number = -1
        self.state: dict[str, float | str] = {"feed": 0.0, "mode": "", "spindle": "", "mist": "", "flood": ""}

    def call(self, name: str, arguments: str) -> None:
        if name == "USE_LENGTH_UNITS":
            self.unit = 25.4 if "INCHES" in arguments else 1.0
        elif name == "SELECT_PLANE":
            self.plane = _PLANES[arguments]
        elif name == "SET_XY_ROTATION":
            assert float(arguments) == 0.0
        elif name == "SET_FEED_RATE":
            self.state["feed"] = self.unit * float(arguments)
        elif name in _STATES:
            self.state[_STATES[name]] = f"{name} {arguments}"
        else:
            self.move(name, [float(number) for number in _NUMBER.findall(arguments)])

    def move(self, name: str, numbers: list[float]) -> None:
        if name == "SET_G5X_OFFSET":
            self.offsets["G5X"] = self.unit * np.array(numbers[1:4])
        elif name == "SET_G92_OFFSET":
            self.offsets["G92"] = self.unit * np.array(numbers[:3])
        elif name == "USE_TOOL_LENGTH_OFFSET":
            self.offsets["TOOL"] = self.unit * np.array(numbers[:3])
        elif name in ("STRAIGHT_TRAVERSE", "STRAIGHT_FEED"):
            assert not any(numbers[3:]), "rotary axes"
            self.straight(name == "STRAIGHT_FEED", self.zero + self.unit * np.array(numbers[:3]))
        elif name == "ARC_FEED":
            self.arc(numbers)
        elif name in ("STRAIGHT_PROBE", "RIGID_TAP"):
            raise ValueError(f"{name} cannot be compared")

    @property
    def zero(self) -> Array:
        return self.offsets["G5X"] + self.offsets["G92"] + self.offsets["TOOL"]

    def straight(self, feed: bool, end: Array) -> None:
        steps = max(1, math.ceil(float(np.linalg.norm(end - self.position)) / 5.0)) if feed else 1
        share = np.linspace(0.0, 1.0, steps + 1)[:, None]
        points = self.position + share * (end - self.position)
        points[-1] = end
        self.add(feed, points)

    def add(self, feed: bool, points: Array) -> None:
        self.executed.inch |= self.unit != 1.0
        self.executed.moves.append(ExecutedMove(self.number, feed, points, tuple(self.state.values())))
        self.position = points[-1]

    def arc(self, numbers: list[float]) -> None:
        first_end, second_end, first_centre, second_centre, turns, height = numbers[:6]
        a, b, normal = self.plane
        end = self.zero.copy()
        end[a] += self.unit * first_end
        end[b] += self.unit * second_end
        end[normal] += self.unit * height
        centre = np.array([self.zero[a] + self.unit * first_centre, self.zero[b] + self.unit * second_centre])
        begin = self.position[[a, b]] - centre
        last = end[[a, b]] - centre
        angle = math.atan2(begin[0] * last[1] - begin[1] * last[0], float(begin @ last))
        turn = math.copysign(math.tau, turns)
        # Start and end of a full circle differ by the rounding of what is printed.
        sweep = angle if angle * turn > 0.0 and abs(angle) * np.linalg.norm(begin) > _SAME_POINT_MM else angle + turn
        sweep += turn * (abs(turns) - 1)
        largest = max(float(np.linalg.norm(begin)), float(np.linalg.norm(last)), 1e-3)
        # A chord of the angle θ is at most r θ² / 8 from its arc.
        step = min(_ARC_STEP, math.sqrt(8.0 * _ARC_SAGITTA_MM / largest))
        share = np.linspace(0.0, 1.0, 2 + math.ceil(abs(sweep) / step))
        radius = np.linalg.norm(begin) + share * (np.linalg.norm(last) - np.linalg.norm(begin))
        around = math.atan2(begin[1], begin[0]) + share * sweep
        points = np.empty((len(share), 3))
        points[:, a] = centre[0] + radius * np.cos(around)
        points[:, b] = centre[1] + radius * np.sin(around)
        points[:, normal] = self.position[normal] + share * (end[normal] - self.position[normal])
        points[-1] = end
        self.add(True, points)


def farthest(points: Array, moves: list[Array]) -> float:
    """Return the largest distance in mm of `points` (n, 3) from the polylines of `moves`."""
    starts, ways = [], []
    for move in moves:
        way = np.diff(move, axis=0)
        count = np.maximum(np.ceil(np.linalg.norm(way, axis=1) / 0.1).astype(int), 1)
        part = np.repeat(way / count[:, None], count, axis=0)
        number = np.arange(len(part)) - np.repeat(np.cumsum(count) - count, count)
        starts.append(np.repeat(move[:-1], count, axis=0) + number[:, None] * part)
        ways.append(part)
    start, way = np.concatenate(starts), np.concatenate(ways)
    _, near = cKDTree(start + 0.5 * way).query(points, k=min(24, len(start)))
    near = near.reshape(len(points), -1)
    offset = points[:, None, :] - start[near]
    size = np.maximum((way * way).sum(axis=1), 1e-300)
    share = np.clip((offset * way[near]).sum(axis=2) / size[near], 0.0, 1.0)
    apart = offset - share[:, :, None] * way[near]
    return float(np.sqrt((apart * apart).sum(axis=2)).min(axis=1).max())
