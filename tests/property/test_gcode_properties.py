"""Corrected part programs run by an independent interpreter: properties of every program and every table."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from plain_gcode import PlainController, dense, ends, far, path
from scipy.interpolate import RegularGridInterpolator

from gcode.correction import correct_program
from gcode.setup import CorrectionOptions, PartSetup
from twin.compensation.table import CompensationTable
from twin.machine.anchor import Anchor

NODES = (np.array([0.0, 90.0, 200.0, 350.0, 500.0]), np.array([0.0, 130.0, 300.0]), np.array([0.0, 70.0, 150.0, 250.0]))
WORK = {"G54": (60.0, 50.0, 40.0), "G55": (61.5, 48.25, 43.0), "G59.1": (70.0, 60.0, 50.0)}
TOOLS = {1: (0.0, 0.0, 12.5), 2: (1.0, -2.0, 30.0)}
REFERENCES = {"G28": (20.0, 10.0, 200.0), "G30": (30.0, 20.0, 180.0)}
START = (100.0, 100.0, 100.0)
STEP = 1e-4
STEP_INCH = 1e-5 * 25.4
TO_START = "G21 G90 G0 X40 Y50 Z60\n"  # START in the coordinates of G54: the axes are then at the corrected position

seeds = st.integers(0, 2**32 - 1)


def table_of(seed: int | None, size_mm: float = 0.03) -> CompensationTable:
    """Return a rough table with independent node values; None: all zero."""
    shape = tuple(len(nodes) for nodes in NODES)
    values = np.zeros((*shape, 3))
    if seed is not None:
        values = size_mm * np.random.default_rng(seed).uniform(-1.0, 1.0, values.shape)
    return CompensationTable(*NODES, values, np.zeros(3), Anchor(np.zeros(3)), np.zeros(shape, dtype=bool))


def added(table: CompensationTable, points: np.ndarray) -> np.ndarray:
    """Return the points with the correction added, by scipy's trilinear interpolation."""
    return points + RegularGridInterpolator(table.nodes, table.corrections)(points)


def corrected(text: str, table: CompensationTable, chord_mm: float = 0.005) -> str:
    setup = PartSetup(WORK, REFERENCES, TOOLS, START)
    parts: list[str] = []
    correct_program(text.splitlines(True), table, setup, CorrectionOptions(chord_mm), parts.append)
    return "".join(parts)


def controller() -> PlainController:
    references = {int(name[1:]): point for name, point in REFERENCES.items()}
    return PlainController(np.array(START), work=dict(WORK), tools=dict(TOOLS), references=references)


KINDS = ["line", "line", "line", "arc", "mode", "system", "tool", "datum", "machine", "reference"]
MODES = ["G90", "G91", "G20", "G21", "G17", "G18", "G19", "G90.1", "G91.1"]
PLANE_AXES = {"G17": (0, 1, 2), "G18": (2, 0, 1), "G19": (1, 2, 0)}
REACH = np.array([495.0, 295.0, 245.0])


class Author:
    """Author of random programs: writes blocks towards drawn axis positions and computes the words for them."""

    def __init__(self, draw: st.DrawFn) -> None:
        self.draw = draw
        self.here = np.array(START)
        self.unit, self.absolute, self.absolute_centres, self.plane = 1.0, True, False, "G17"
        self.work, self.tool, self.g92 = np.array(WORK["G54"]), np.zeros(3), np.zeros(3)

    def zero(self) -> np.ndarray:
        return self.work + self.tool + self.g92

    def word(self, axis: int, value: float, base: float, decimals: int = 3) -> str:
        """Return the word that moves an axis to `value`, relative to `base`, and record the position given by
        the word.
        """
        text = f"{(value - base) / self.unit:.{decimals}f}"
        self.here[axis] = base + float(text) * self.unit
        return "XYZ"[axis] + text

    def words(self, axes: list[int], goal: tuple, decimals: int = 3) -> str:
        bases = self.zero() if self.absolute else self.here.copy()
        return " ".join(self.word(axis, goal[axis], bases[axis], decimals) for axis in axes)

    def line(self, axes: list[int], goal: tuple) -> str:
        return f"{self.draw(st.sampled_from(['G0', 'G1']))} {self.words(axes, goal)}"

    def mode(self, _axes: list[int], _goal: tuple) -> str:
        mode = self.draw(st.sampled_from(MODES))
        self.absolute = {"G90": True, "G91": False}.get(mode, self.absolute)
        self.unit = {"G20": 25.4, "G21": 1.0}.get(mode, self.unit)
        self.absolute_centres = {"G90.1": True, "G91.1": False}.get(mode, self.absolute_centres)
        self.plane = mode if mode in PLANE_AXES else self.plane
        return mode

    def tool_length(self, _axes: list[int], _goal: tuple) -> str:
        number = self.draw(st.sampled_from([0, 1, 2]))
        self.tool = np.array(TOOLS.get(number, (0.0, 0.0, 0.0)))
        return f"G43 H{number}" if number else "G49"

    def system(self, _axes: list[int], _goal: tuple) -> str:
        name = self.draw(st.sampled_from(sorted(WORK)))
        self.work = np.array(WORK[name])
        return name

    def datum(self, axes: list[int], goal: tuple) -> str:
        names = [round(value / 100.0, 3) for value in goal]
        for axis in axes:
            self.g92[axis] += self.here[axis] - self.zero()[axis] - names[axis] * self.unit
        return "G92 " + " ".join(f"{'XYZ'[axis]}{names[axis]:.3f}" for axis in axes)

    def reference(self, axes: list[int], goal: tuple) -> str:
        code = self.draw(st.sampled_from(["G28", "G30"]))
        text = f"{code} {self.words(axes, goal)}"
        self.here[axes] = np.array(REFERENCES[code])[axes]
        return text

    def machine(self, axes: list[int], goal: tuple) -> str:
        if not self.absolute:
            return self.line(axes, goal)
        return "G53 G0 " + " ".join(self.word(axis, goal[axis], 0.0) for axis in axes)

    def arc(self, axes: list[int], goal: tuple) -> str:
        """Write a circle or part of one inside the table, possibly a helix; a line if there is not enough room."""
        a, b, c = PLANE_AXES[self.plane]
        size = float(np.minimum(self.here - 5.0, REACH - self.here)[[a, b]].min()) / 2.5
        if size < 1.0:
            return self.line(axes, goal)
        angle, turn = self.draw(st.floats(-3.1, 3.1)), self.draw(st.sampled_from([0.0, 0.4, 1.9, 3.0, -0.8, -2.5]))
        here = complex(self.here[a], self.here[b])
        middle = here + size * complex(math.cos(angle), math.sin(angle))
        base = self.zero() if self.absolute_centres else self.here
        text = f"{self.draw(st.sampled_from(['G2', 'G3']))} {'IJK'[a]}{(middle.real - base[a]) / self.unit:.8f}"
        text += f" {'IJK'[b]}{(middle.imag - base[b]) / self.unit:.8f} F300 "
        end = middle + (here - middle) * complex(math.cos(turn), math.sin(turn))
        ends = {a: end.real, b: end.imag, c: goal[c]}
        named = ([a, b] if turn else []) + ([c] if c in axes else [])
        return text + self.words(named, (ends[0], ends[1], ends[2]), decimals=8)


@st.composite
def programs(draw: st.DrawFn) -> str:
    """Generate numbered blocks of every kind in any order; positions stay within the table."""
    author, lines = Author(draw), []
    kinds = {
        **{kind: getattr(author, kind) for kind in ("line", "arc", "mode", "system", "datum", "machine", "reference")},
        "tool": author.tool_length,
    }
    for number in range(10, 10 * draw(st.integers(3, 14)), 10):
        goal = draw(st.tuples(st.floats(40, 460), st.floats(40, 260), st.floats(40, 210)))
        axes = sorted(draw(st.sets(st.integers(0, 2), min_size=1)))
        lines.append(f"N{number} {kinds[draw(st.sampled_from(KINDS))](axes, goal)}")
    return "\n".join(lines) + "\n"


@settings(max_examples=60, deadline=None)
@given(programs(), seeds)
def test_after_every_block_the_axes_stand_where_the_table_says(text, seed):
    """Check that errors do not accumulate: every corrected position is exact to half a step of the words.

    Reference points are excepted.
    """
    table = table_of(seed)
    meant, reached = controller(), controller()
    meant.run(text)
    reached.run(corrected(text, table))
    wanted, found = ends(meant.strokes), ends(reached.strokes)
    assert set(wanted) == set(found)
    at_reference = [False] * 3
    for stroke in meant.strokes:
        if " G28 " in stroke.block or " G30 " in stroke.block:
            at_reference = [named or letter in stroke.block for named, letter in zip(at_reference, "XYZ", strict=True)]
            difference = np.abs(found[stroke.number] - wanted[stroke.number])[at_reference]
            assert difference.max() < 1e-9
            continue
        at_reference = [False] * 3
        apart = found[stroke.number] - added(table, wanted[stroke.number][None])[0]
        assert np.abs(apart).max() < 0.51 * STEP_INCH, stroke.block


@settings(max_examples=25, deadline=None)
@given(programs())
def test_a_table_of_zeros_changes_no_path(text):
    chord = 0.005
    meant, reached = controller(), controller()
    meant.run(text)
    reached.run(corrected(text, table_of(None), chord))
    if meant.strokes:
        assert far(path(meant.strokes), path(reached.strokes)) <= chord + STEP_INCH
        assert far(path(reached.strokes), path(meant.strokes)) <= chord + STEP_INCH
    for wanted, found in zip(ends(meant.strokes).values(), ends(reached.strokes).values(), strict=True):
        assert found == pytest.approx(wanted, abs=STEP_INCH)


@settings(max_examples=40, deadline=None)
@given(programs(), seeds)
def test_the_short_way_for_plain_lines_writes_what_the_long_one_does(text, seed):
    """Compare with lower-case letters, which take the slow path."""
    table = table_of(seed)
    assert corrected(text.lower(), table).upper() == corrected(text, table)


lines = st.lists(st.tuples(st.floats(-40, 380), st.floats(-40, 200), st.floats(-30, 150)), min_size=2, max_size=6)


def straight(points: list[tuple], incremental: bool) -> str:
    text, here = f"{TO_START}G1 F500\n", np.array(START) - WORK["G54"]
    for number, point in enumerate(np.round(points, 3)):
        said = point - here if incremental else point
        text += f"N{number} {'G91' if incremental else 'G90'} X{said[0]:.3f} Y{said[1]:.3f} Z{said[2]:.3f}\n"
        here = point
    return text


@settings(max_examples=25, deadline=None)
@given(lines, seeds)
def test_incremental_words_say_what_absolute_ones_say(points, seed):
    table = table_of(seed)
    first = controller().run(corrected(straight(points, incremental=False), table))
    second = controller().run(corrected(straight(points, incremental=True), table))
    assert len(first) == len(second)
    assert path(second) == pytest.approx(path(first), abs=1.01 * STEP)


def cut(text: str) -> np.ndarray:
    """Return the commanded positions after the first move, which goes to the corrected start."""
    return path(controller().run(text)[1:])


def corrected_curve(text: str, table: CompensationTable) -> np.ndarray:
    """Return the corrected path after the first move, every 0.2 mm or so."""
    plain = controller()
    plain.arc_step = 0.002
    strokes = plain.run(text)[1:]
    return added(table, np.concatenate([dense(stroke.points, 0.2) for stroke in strokes]))


@settings(max_examples=20, deadline=None)
@given(lines, seeds, st.sampled_from([0.0005, 0.002, 0.01]))
@example([(0.0, 0.0, 0.0)] * 4, 0, 0.002)
def test_straight_pieces_stay_within_the_chord_error(points, seed, chord):
    """Compare with the densely sampled corrected curve in both directions; nodes of the table differ by up to 60 µm."""
    table = table_of(seed)
    text = straight(points, incremental=False)
    written = cut(corrected(text, table, chord))
    curve = corrected_curve(text, table)
    assert far(curve, written) <= chord
    assert far(dense(written, 0.3), curve) <= chord + 1e-5


@st.composite
def arcs(draw: st.DrawFn) -> tuple[str, str]:
    """Return the same arc or helix given by its centre and by its radius."""
    plane, code = draw(st.sampled_from([17, 18, 19])), draw(st.sampled_from([2, 3]))
    a, b, c = {17: (0, 1, 2), 18: (2, 0, 1), 19: (1, 2, 0)}[plane]
    radius, angle = draw(st.floats(2.0, 35.0)), draw(st.floats(-math.pi, math.pi))
    sweep = draw(st.floats(0.1, 6.1).filter(lambda value: abs(value - math.pi) > 0.05)) * (1 if code == 3 else -1)
    start = np.array(START) - WORK["G54"]
    middle = complex(start[a], start[b]) - radius * complex(math.cos(angle), math.sin(angle))
    end = middle + radius * complex(math.cos(angle + sweep), math.sin(angle + sweep))
    rise = draw(st.sampled_from([0.0, 12.0, -7.0]))
    words = f"G{plane} G{code} {'XYZ'[a]}{end.real:.9f} {'XYZ'[b]}{end.imag:.9f} {'XYZ'[c]}{start[c] + rise:.9f}"
    words = TO_START + words
    by_centre = f"{words} {'IJK'[a]}{middle.real - start[a]:.9f} {'IJK'[b]}{middle.imag - start[b]:.9f} F100\n"
    by_radius = f"{words} R{math.copysign(radius, math.pi - abs(sweep)):.9f} F100\n"
    return by_centre, by_radius


@settings(max_examples=25, deadline=None)
@given(arcs(), seeds, st.sampled_from([0.001, 0.005]))
def test_arcs_stay_within_the_chord_error_and_are_the_same_by_centre_and_radius(texts, seed, chord):
    table = table_of(seed)
    by_centre, by_radius = (cut(corrected(text, table, chord)) for text in texts)
    curve = corrected_curve(texts[0], table)
    assert far(curve, by_centre) <= chord + 2e-7
    assert far(dense(by_centre, 0.3), curve) <= chord + 1e-5
    assert by_radius.shape == by_centre.shape
    assert by_radius == pytest.approx(by_centre, abs=1.01 * STEP)


@settings(max_examples=20, deadline=None)
@given(lines, seeds, st.lists(st.floats(0.05, 20.0), min_size=6, max_size=6))
def test_inverse_time_is_shared_among_the_pieces(points, seed, feeds):
    text = "G21 G90 G93\n"
    for number, (point, feed) in enumerate(zip(points, feeds, strict=False)):
        text += f"N{number} G1 X{point[0]:.3f} Y{point[1]:.3f} Z{point[2]:.3f} F{feed:.4f}\n"
    minutes: dict[int, float] = {}
    number = 0
    for stroke in controller().run(corrected(text, table_of(seed), 0.002)):
        number = stroke.number if stroke.number is not None else number
        assert stroke.minutes is not None
        minutes[number] = minutes.get(number, 0.0) + stroke.minutes
    for number, feed in zip(range(len(points)), feeds, strict=False):
        assert minutes[number] == pytest.approx(1.0 / round(feed, 4), rel=1e-5)
