"""Path of a program as LinuxCNC's own interpreter executes it: `rs274 -g` prints the calls of its canonical machine.

It shares nothing with `gcode`. Positions are axis positions in mm.
"""

from __future__ import annotations

import math
import re
import shutil
import subprocess
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

RS274 = shutil.which("rs274")
_CALL = re.compile(r"^\s*\d+ N\S*\s+([A-Z_0-9]+)\((.*)\)\s*$")
_NUMBER = re.compile(r"-?\d+\.?\d*(?:e-?\d+)?")
_PLANES = {"CANON_PLANE_XY": (0, 1, 2), "CANON_PLANE_XZ": (2, 0, 1), "CANON_PLANE_YZ": (1, 2, 0)}
_ARC_STEP = 0.01


@dataclass
class Executed:
    """Moves that were executed. `feeds` contains one array (n, 3) of dense points for each move with feed, both ends
    included, and `rapids` the end of each rapid move. `inch` is True if a part of it was printed in inches, with a
    resolution of 2.5 µm.
    """

    feeds: list[np.ndarray] = field(default_factory=list)
    rapids: list[np.ndarray] = field(default_factory=list)
    inch: bool = False


def execute(program: Path, folder: Path) -> Executed:
    """Execute a program from its own folder, with tools of length 0. Raises ValueError if rs274 refuses it."""
    assert RS274 is not None
    tools, parameters = folder / "tool.tbl", folder / "rs274.var"
    tools.write_text("".join(f"T{number} P{number} Z0 D0.1\n" for number in range(1, 100)))
    parameters.unlink(missing_ok=True)
    done = subprocess.run(
        [RS274, "-t", str(tools), "-v", str(parameters), "-g", program.name],
        cwd=program.parent,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        timeout=600.0,
        check=False,
    )
    text = done.stdout.decode(errors="replace")
    if done.returncode:
        raise ValueError(f"{program.name}: {text[-200:]} {done.stderr.decode(errors='replace')[-300:]}")
    return read_calls(text)


def read_calls(text: str) -> Executed:
    """Read the calls of the canonical machine. The offsets are those of the calls before a move."""
    machine = _Machine()
    for line in text.splitlines():
        found = _CALL.match(line)
        if found is not None:
            machine.call(found[1], found[2])
    return machine.executed


class _Machine:
    def __init__(self) -> None:
        self.executed = Executed()
        self.unit = 1.0
        self.offsets = {"G5X": np.zeros(3), "G92": np.zeros(3), "TOOL": np.zeros(3)}
        self.position = np.zeros(3)
        self.plane = (0, 1, 2)

    def call(self, name: str, arguments: str) -> None:
        if name == "USE_LENGTH_UNITS":
            self.unit = 25.4 if "INCHES" in arguments else 1.0
        elif name == "SELECT_PLANE":
            self.plane = _PLANES[arguments]
        elif name == "SET_XY_ROTATION":
            assert float(arguments) == 0.0
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
    def zero(self) -> np.ndarray:
        return np.sum(list(self.offsets.values()), axis=0)

    def straight(self, feed: bool, end: np.ndarray) -> None:
        self.executed.inch |= self.unit != 1.0
        if feed:
            steps = max(1, math.ceil(float(np.linalg.norm(end - self.position)) / 5.0))
            share = np.linspace(0.0, 1.0, steps + 1)[:, None]
            self.executed.feeds.append(self.position + share * (end - self.position))
        else:
            self.executed.rapids.append(end)
        self.position = end

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
        sweep = angle if angle * turn > 0.0 and abs(angle) > 1e-7 else angle + turn
        sweep += turn * (abs(turns) - 1)
        share = np.linspace(0.0, 1.0, 2 + math.ceil(abs(sweep) / _ARC_STEP))
        radius = np.linalg.norm(begin) + share * (np.linalg.norm(last) - np.linalg.norm(begin))
        around = math.atan2(begin[1], begin[0]) + share * sweep
        points = np.empty((len(share), 3))
        points[:, a] = centre[0] + radius * np.cos(around)
        points[:, b] = centre[1] + radius * np.sin(around)
        points[:, normal] = self.position[normal] + share * (end[normal] - self.position[normal])
        points[-1] = end
        self.executed.feeds.append(points)
        self.executed.inch |= self.unit != 1.0
        self.position = end


def farthest(points: np.ndarray, moves: list[np.ndarray]) -> float:
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
