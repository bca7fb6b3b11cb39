"""Canned cycles G73, G81, G82, G83, G85, G86 and G89 as single moves, in the order of LinuxCNC.

The cycles work in the three main planes, with G90 and G91, G98 and G99, and repetitions (L). LinuxCNC reaches every
corner of a cycle exactly. The single moves are therefore separated by a dwell of 0, at which no controller blends two
moves, unless the program has chosen exact path (G61).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

from gcode.arcs import PLANE_AXES
from gcode.codes import AXIS_LETTERS, MOTIONS
from gcode.flattening.statements import BlockWord, Statement, block_text, number_text
from gcode.flattening.system_parameters import program_position
from gcode.modal import MM_PER_INCH, ModalState
from gcode.polar import POLAR, polar_end, require_polar_plane
from gcode.source import SourceLine

CYCLES = (730, 810, 820, 830, 850, 860, 890)
_PECKS = (730, 830)
_DWELLS = (820, 860, 890)
_REAMING, _BORING = 850, 890
_STOPS_SPINDLE = 860
_WITHOUT_CYCLE = (40, 100, 280, 281, 300, 301, 431, 530, 920, 921, 922, 923)
_CANCEL, _TO_START, _TO_R, _EXACT = 800, 980, 990, (610, 611)
_BLENDED = 640
_OWN_LETTERS = frozenset("XYZRLPQ@^")
_RETRACT_INCH = 0.01  # distance by which LinuxCNC backs off after a peck
_MOST_REPEATS = 10_000
_MOST_PECKS = 100_000


@dataclass(slots=True)
class CannedCycles:
    """State of the canned cycles.

    `active` is ten times the number of the cycle in effect, or 0. `sticky` contains the values of R, P, Q and the depth
    that hold until the cycle changes. `initial` is the coordinate of the tool along its axis before the first of
    successive cycles, to which G98 returns, and `frame` is the plane, the unit and the zero point to which these
    numbers belong. `to_r` is True with G99, False with G98, and None if it is not known which of them is in effect.
    `spindle` is M3 or M4 if the spindle turns.
    """

    active: int = 0
    sticky: dict[str, float] = field(default_factory=dict)
    initial: float | None = None
    frame: tuple[float, ...] = ()
    to_r: bool | None = None
    exact: bool = False
    spindle: str = ""

    def wants(self, statement: Statement) -> bool:
        """Update the state with the codes of a statement, and return True if it runs a cycle."""
        codes = statement.codes("G")
        for code in statement.codes("M"):
            if code in (30, 40, 50):
                self.spindle = "" if code == 50 else f"M{code // 10}"
        for code in codes:
            if code in (_TO_START, _TO_R):
                self.to_r = code == _TO_R
            elif code in (*_EXACT, _BLENDED):
                self.exact = code in _EXACT
            elif code in MOTIONS or code == _CANCEL:
                self.active, self.initial = 0, None
        named = [code for code in codes if code in CYCLES]
        if len(named) > 1:
            statement.source.refuse("two canned cycles in one block")
        if named and named[0] != self.active:
            self.active, self.sticky = named[0], {}
        # These codes use the axis words of the block for themselves, so a cycle in effect is not repeated in it.
        if not self.active or (not named and any(code in _WITHOUT_CYCLE for code in codes)):
            return False
        letters = {word.letter for word in statement.words}
        return bool(named) or not letters.isdisjoint("XYZ@^")

    @property
    def modes(self) -> tuple[bool | None, bool]:
        """The level to which cycles return, and exact path, which M70 saves and M72 restores."""
        return self.to_r, self.exact

    @modes.setter
    def modes(self, saved: tuple[bool | None, bool]) -> None:
        self.to_r, self.exact = saved

    def split(self, statement: Statement) -> tuple[list[BlockWord], tuple[BlockWord, ...]]:
        """Return the words that do not belong to the cycle, and those that do."""
        source, own, others = statement.source, {}, []
        if _BLENDED in statement.codes("G") and any(word.letter in "PQ" for word in statement.words):
            source.refuse("P and Q in a block with G64 and a canned cycle may belong to either", "Write two blocks")
        for word in statement.words:
            if word.letter in _OWN_LETTERS:
                if word.letter in own:
                    source.refuse(f"the word {word.letter} occurs twice")
                own[word.letter] = word
            elif word.letter in "IJK" or (word.letter == "G" and word.text in ("53", "93")):
                source.refuse(f"{word.letter}{word.text} in a canned cycle is not supported")
            elif word.letter != "G" or not statement_is_cycle(word):
                others.append(word)
        return others, tuple(own.values())

    def repeats(self, words: Sequence[BlockWord], source: SourceLine) -> int:
        """Return the number of repetitions, the value of the word L."""
        repeats = next((word.value for word in words if word.letter == "L"), 1.0)
        if not (repeats.is_integer() and 1.0 <= repeats <= _MOST_REPEATS):
            source.refuse(f"L is the number of repetitions, an integer from 1 to {_MOST_REPEATS}, not {repeats:g}")
        return int(repeats)

    def run(self, words: Sequence[BlockWord], repeats: int, source: SourceLine, modal: ModalState) -> Iterator[str]:
        """Yield the blocks of the cycle, which begins at the position in `modal` and is repeated `repeats` times."""
        given = {word.letter: word.value for word in words}
        if modal.inverse_time:
            source.refuse("a canned cycle with inverse-time feed (G93)")
        start = program_position(modal, source)
        first, second, normal = PLANE_AXES[modal.plane]
        self._remember(given, AXIS_LETTERS[normal], source)
        initial = self._initial_level(start[normal], normal, modal, source)
        path = _Path(list(start), modal.absolute, exact=self.exact)
        # With G91, R is relative to the initial level, and the depth is relative to R.
        level = self.sticky["R"] + (0.0 if modal.absolute else initial)
        bottom = self.sticky["depth"] + (0.0 if modal.absolute else level)
        if level < bottom:
            source.refuse("R of a canned cycle is below the bottom of the hole")
        clear = self._clearance(level, initial, source)
        # An initial level below R is left before any sideways move.
        if initial < level:
            yield from path.move("G0", {normal: level})
        step_mm = {axis: given.get(AXIS_LETTERS[axis], 0.0) for axis in (first, second)}
        for _ in range(repeats):
            hole = {axis: path.at[axis] + by for axis, by in step_mm.items()}
            if modal.absolute:
                hole = {axis: given.get(AXIS_LETTERS[axis], path.at[axis]) for axis in step_mm}
            # LinuxCNC moves sideways at the present level. If the hole before was left at an R that is lower than the
            # present one, it rises during the sideways move.
            yield from path.move("G0", {**hole, normal: path.at[normal] if path.at[normal] >= level else clear})
            yield from path.move("G0", {normal: level})
            yield from self._hole(path, normal, level, bottom, clear, modal.unit_mm, source)

    def _initial_level(self, present: float, normal: int, modal: ModalState, source: SourceLine) -> float:
        """Return the initial level, which is the present one for the first of successive cycles."""
        zero = modal.offset[normal] if modal.offset is not None else 0.0
        frame = (float(modal.plane), modal.unit_mm, zero)
        if self.initial is None:
            self.initial, self.frame = present, frame
        elif frame != self.frame:
            message = (
                "the plane, the unit or the zero point has changed during a canned cycle, whose levels would change"
            )
            source.refuse(message, "Write G80 before the change, and the cycle with all of its words after it")
        return self.initial

    def _clearance(self, level: float, initial: float, source: SourceLine) -> float:
        """Return the level to which the tool returns from a hole."""
        highest = max(level, initial)
        if self.to_r is None and highest != level:
            message = (
                "it is not known whether the cycle returns to the initial level or to R: controllers begin with either"
            )
            source.refuse(message, "Write G98 or G99 before the cycle, or give `retract` in the setup file")
        return level if self.to_r else highest

    def _remember(self, given: dict[str, float], depth: str, source: SourceLine) -> None:
        wanted = {"R": "R", "depth": depth}
        if self.active in _PECKS:
            wanted["Q"] = "Q"
        if self.active in _DWELLS:
            wanted["P"] = "P"
        for name, letter in wanted.items():
            if letter in given:
                self.sticky[name] = given[letter]
            elif name not in self.sticky:
                source.refuse(f"G{self.active // 10} needs the word {letter}")

    def _hole(
        self, path: _Path, normal: int, level: float, bottom: float, clear: float, unit_mm: float, source: SourceLine
    ) -> Iterator[str]:
        if self.active in _PECKS:
            peck = self.sticky["Q"]
            if not peck > 0.0 or (level - bottom) / peck > _MOST_PECKS:
                source.refuse(f"Q of a canned cycle is the depth of a peck, not {peck:g}")
            back = _RETRACT_INCH * MM_PER_INCH / unit_mm
            depth = level - peck
            while depth > bottom:
                yield from path.move("G1", {normal: depth})
                if self.active == 830:
                    yield from path.move("G0", {normal: level})
                yield from path.move("G0", {normal: depth + back})
                depth -= peck
        yield from path.move("G1", {normal: bottom})
        if self.active in _DWELLS:
            yield f"G4 P{number_text(self.sticky['P'])}"
        if self.active == _STOPS_SPINDLE:
            if not self.spindle:
                source.refuse("G86 needs a turning spindle, and no M3 or M4 comes before it")
            yield "M5"
        if self.active == _REAMING:
            yield from path.move("G1", {normal: level})
        yield from path.move("G1" if self.active == _BORING else "G0", {normal: clear})
        if self.active == _STOPS_SPINDLE:
            yield self.spindle


@dataclass(slots=True)
class _Path:
    """Single moves from the position `at`, in the coordinates of the program."""

    at: list[float]
    absolute: bool
    exact: bool

    def move(self, code: str, target: dict[int, float]) -> Iterator[str]:
        """Yield the block of a move, and the dwell after it; nothing if no axis moves."""
        words = []
        for axis in sorted(target):
            if target[axis] != self.at[axis]:
                value = target[axis] - (0.0 if self.absolute else self.at[axis])
                words.append(BlockWord.of(AXIS_LETTERS[axis], value))
                self.at[axis] = target[axis]
        if words:
            yield f"{code} {block_text(words)}"
            if not self.exact:
                yield "G4 P0"


def statement_is_cycle(word: BlockWord) -> bool:
    """Return True if a G word names a canned cycle, G98 or G99, which the single moves do not need."""
    return round(10.0 * word.value) in (*CYCLES, _TO_START, _TO_R)


def cartesian(words: tuple[BlockWord, ...], source: SourceLine, modal: ModalState) -> tuple[BlockWord, ...]:
    """Return the words of a cycle with X and Y instead of @ and ^. Words without these two are returned unchanged.

    `modal` is the state in which the cycle runs: the other codes of its block have been executed.
    """
    polar = {word.letter: word.value for word in words if word.letter in POLAR}
    if not polar:
        return words
    others = [word for word in words if word.letter not in POLAR]
    require_polar_plane([word.letter for word in others], modal.plane, source)
    x, y, _ = program_position(modal, source)
    end_x, end_y = polar_end(x, y, polar.get("@"), polar.get("^"), absolute=modal.absolute, source=source)
    # The end is known in absolute coordinates; with G91 the words are its difference from the present position.
    if not modal.absolute:
        end_x, end_y = end_x - x, end_y - y
    return (*others, BlockWord.of("X", end_x), BlockWord.of("Y", end_y))
