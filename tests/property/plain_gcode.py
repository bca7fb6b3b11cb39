"""Independent G-code interpreter, written from RS-274/NGC (NISTIR 6556) and the manuals of LinuxCNC and Grbl.

It shares nothing with `gcode`: words are read character by character, arcs are complex numbers
rotated about their centre, and the result is the dense path of commanded axis positions.
"""

from __future__ import annotations

import cmath
import itertools
import math
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial import cKDTree

WORK = {54: "G54", 55: "G55", 56: "G56", 57: "G57", 58: "G58", 59: "G59", 59.1: "G59.1"}
PLANES = {17: (0, 1, 2), 18: (2, 0, 1), 19: (1, 2, 0)}


@dataclass
class Stroke:
    """Path of one block. `points` (n, 3): axis positions, both ends included. `minutes`: duration of a block
    with G93.
    """

    number: int | None
    feed: bool
    points: np.ndarray
    minutes: float | None
    block: str


@dataclass
class PlainController:
    """Controller state. Axis positions in mm."""

    position: np.ndarray
    work: dict[str, tuple] = field(default_factory=lambda: {"G54": (0.0, 0.0, 0.0)})
    tools: dict[int, tuple] = field(default_factory=dict)
    references: dict[int, tuple] = field(default_factory=dict)
    arc_step: float = 0.01
    strokes: list[Stroke] = field(default_factory=list)

    def __post_init__(self):
        self.position = np.array(self.position, dtype=float)
        self.g92 = np.zeros(3)
        self.saved = np.zeros(3)
        self.tool = np.zeros(3)
        self.inch, self.incremental, self.absolute_centres = False, False, False
        self.plane = 17
        self.system: float = 54
        self.motion: int | None = None
        self.feed_mode: float = 94
        self.in_spindle: float | None = None
        self.called: float | None = None
        self.others: list[str] = []

    def run(self, text: str) -> list[Stroke]:
        for line in text.splitlines():
            self.block(line)
        return self.strokes

    def zero(self) -> np.ndarray:
        return np.array(self.work[WORK[self.system]]) + self.g92 + self.tool

    def block(self, line: str) -> None:
        words = letters_and_numbers(line)
        codes = [number for letter, number in words if letter == "G"]
        word = {letter: number for letter, number in words if letter not in "GM"}
        number = int(word["N"]) if "N" in word else None
        self.others += [f"{letter}{value:g}" for letter, value in words if letter in "MST"]
        self.called = word.get("T", self.called)
        if ("M", 6.0) in words:
            self.in_spindle = self.called
        for code in codes:
            self.set_mode(code)
        unit = 25.4 if self.inch else 1.0
        if 43 in codes:
            tool = word.get("H", self.in_spindle)
            assert tool is not None, "G43 without H and without a tool in the spindle"
            self.tool = np.array(self.tools[int(tool)], dtype=float)
        named = {axis: word[letter] * unit for axis, letter in enumerate("XYZ") if letter in word}
        if 43.1 in codes:
            for axis, value in named.items():
                self.tool[axis] = value
            return
        if 4 in codes:
            return
        if self.datum(codes, named):
            return
        target = self.target(named, machine=53 in codes)
        if 28 in codes or 30 in codes:
            self.reference(28 if 28 in codes else 30, named, target, number, line)
        elif named or (self.motion in (2, 3) and set("IJKR") & set(word)):
            points = self.arc(word, target, unit) if self.motion in (2, 3) else np.array([self.position, target])
            minutes = 1.0 / word["F"] if self.feed_mode == 93 and self.motion != 0 else None
            self.go(points, number, self.motion != 0, minutes, line)

    def set_mode(self, code: float) -> None:
        if code in (0, 1, 2, 3, 80):
            self.motion = None if code == 80 else int(code)
        elif code in (17, 18, 19):
            self.plane = int(code)
        elif code in (20, 21):
            self.inch = code == 20
        elif code in (90, 91):
            self.incremental = code == 91
        elif code in (90.1, 91.1):
            self.absolute_centres = code == 90.1
        elif code in (93, 94, 95):
            self.feed_mode = code
        elif code in WORK:
            self.system = code
        elif code == 49:
            self.tool = np.zeros(3)

    def datum(self, codes: list[float], named: dict[int, float]) -> bool:
        if 92 in codes:
            for axis, value in named.items():
                self.g92[axis] += self.position[axis] - self.zero()[axis] - value
            self.saved = self.g92.copy()
        elif 92.1 in codes:
            self.g92, self.saved = np.zeros(3), np.zeros(3)
        elif 92.2 in codes:
            self.g92 = np.zeros(3)
        elif 92.3 in codes:
            self.g92 = self.saved.copy()
        else:
            return False
        return True

    def target(self, named: dict[int, float], machine: bool) -> np.ndarray:
        target = self.position.copy()
        for axis, value in named.items():
            if machine:
                target[axis] = value
            elif self.incremental:
                target[axis] += value
            else:
                target[axis] = value + self.zero()[axis]
        return target

    def reference(self, code: int, named: dict, through: np.ndarray, number: int | None, line: str) -> None:
        if named:
            self.go(np.array([self.position, through]), number, False, None, line)
        end = self.position.copy()
        for axis in named or range(3):
            end[axis] = self.references[code][axis]
        self.go(np.array([self.position, end]), number, False, None, line)

    def go(self, points: np.ndarray, number: int | None, feed: bool, minutes: float | None, line: str) -> None:
        self.strokes.append(Stroke(number, feed, points, minutes, line))
        self.position = points[-1].copy()

    def arc(self, word: dict[str, float], target: np.ndarray, unit: float) -> np.ndarray:
        a, b, c = PLANES[self.plane]
        first = complex(self.position[a], self.position[b])
        last = complex(target[a], target[b])
        if "R" in word:
            middle = self.middle_by_radius(first, last, word["R"] * unit)
        else:
            offset = complex(word.get("IJK"[a], 0.0) * unit, word.get("IJK"[b], 0.0) * unit)
            middle = complex(self.zero()[a], self.zero()[b]) + offset if self.absolute_centres else first + offset
        turn = cmath.phase((last - middle) / (first - middle))
        if self.motion == 2 and turn > -1e-7:
            turn -= 2.0 * math.pi
        if self.motion == 3 and turn < 1e-7:
            turn += 2.0 * math.pi
        turn += math.copysign(2.0 * math.pi * (word.get("P", 1.0) - 1.0), turn)
        count = max(8, math.ceil(abs(turn) / self.arc_step))
        share = np.linspace(0.0, 1.0, count + 1)
        stretch = 1.0 + share * (abs(last - middle) / abs(first - middle) - 1.0)
        ring = middle + (first - middle) * stretch * np.exp(1j * turn * share)
        points = np.empty((count + 1, 3))
        points[:, a], points[:, b] = ring.real, ring.imag
        points[:, c] = self.position[c] + share * (target[c] - self.position[c])
        points[-1] = target
        return points

    def middle_by_radius(self, first: complex, last: complex, radius: float) -> complex:
        """Return the one of the two centres for which the arc in the requested direction is the smaller one (R > 0)."""
        half = abs(last - first) / 2.0
        up = 1j * (last - first) / abs(last - first) * math.sqrt(max(radius**2 - half**2, 0.0))
        for middle in ((first + last) / 2.0 + up, (first + last) / 2.0 - up):
            turn = cmath.phase((last - middle) / (first - middle))
            turn = turn % (2.0 * math.pi) if self.motion == 3 else (-turn) % (2.0 * math.pi)
            if (turn <= math.pi + 1e-9) == (radius > 0.0):
                return middle
        raise AssertionError("neither centre fits")


def letters_and_numbers(line: str) -> list[tuple[str, float]]:
    words, depth, place, text = [], 0, 0, line.upper()
    while place < len(text):
        sign = text[place]
        place += 1
        if sign == "(":
            depth += 1
        elif sign == ")":
            depth -= 1
        elif sign == ";" and not depth:
            break
        elif sign.isalpha() and not depth:
            start = place
            while place < len(text) and text[place] in "+-.0123456789 ":
                place += 1
            words.append((sign, float(text[start:place].replace(" ", ""))))
    return words


def ends(strokes: list[Stroke]) -> dict[int | None, np.ndarray]:
    """Return the axis positions after the block of each N number; blocks without a number belong to the
    previous one.
    """
    found: dict[int | None, np.ndarray] = {}
    number = None
    for stroke in strokes:
        number = stroke.number if stroke.number is not None else number
        found[number] = stroke.points[-1]
    return found


def path(strokes: list[Stroke], feed_only: bool = False) -> np.ndarray:
    """Return all points (n, 3) in their order."""
    return np.concatenate([stroke.points for stroke in strokes if stroke.feed or not feed_only])


def far(points: np.ndarray, polyline: np.ndarray) -> float:
    """Return the largest distance of `points` (n, 3) from a polyline (m, 3).

    The polyline is cut into pieces of at most a millimetre, and only the pieces with the nearest midpoints are tried;
    another piece could only be closer.
    """
    fine = dense(polyline, 1.0)
    fine = fine[
        np.append(True, np.any(np.diff(fine, axis=0), axis=1))
    ]  # a stationary position would displace all other samples
    start, way = fine[:-1], np.diff(fine, axis=0)
    _, near = cKDTree(start + 0.5 * way).query(points, k=min(6, len(start)))
    near = near.reshape(len(points), -1)
    size = np.maximum((way * way).sum(axis=1), 1e-300)
    offset = points[:, None, :] - start[near]
    share = np.clip((offset * way[near]).sum(axis=2) / size[near], 0.0, 1.0)
    apart = offset - share[:, :, None] * way[near]
    return float(np.sqrt((apart * apart).sum(axis=2)).min(axis=1).max())


def dense(points: np.ndarray, step: float) -> np.ndarray:
    """Return points (n, 3) on a polyline, at most `step` apart."""
    pieces = [points[:1]]
    for first, last in itertools.pairwise(points):
        count = max(1, math.ceil(float(np.linalg.norm(last - first)) / step))
        pieces.append(first + np.linspace(0.0, 1.0, count + 1)[1:, None] * (last - first))
    return np.concatenate(pieces)
