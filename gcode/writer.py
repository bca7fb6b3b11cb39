"""Writer of the corrected program. It collects moves over many lines, corrects them in batches, and passes on the text
of the corrected lines.

The writer tracks the position of the controller, computed from the rounded numbers that were written. Rounding errors
therefore do not accumulate, even if the words are incremental.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

import numpy as np

from gcode.arcs import Arc
from gcode.chord_tolerance import TableCurvature
from gcode.codes import AXIS_LETTERS
from gcode.correction_summary import CorrectionSummary
from gcode.lines import LineFormatter, MoveBlock
from gcode.modal import MM_PER_INCH, Frame
from gcode.move_batch import CorrectedPoints, Indices, MovePaths, correct_points, round_to_words
from gcode.setup import CorrectionOptions, Triple
from gcode.words import Block
from twin.compensation.table import CompensationTable
from twin.errors import DataError

# Numbers of lines and of points that are processed at once: many, so that the calls of numpy cost little, and bounded,
# so that the memory does not grow with the program.
_BATCH_LINES = 4096
_PART_POINTS = 16384
# The points of one move are kept in memory together, 24 bytes each.
_MOST_PIECES = 200_000
# Some 2 GB of text. A short program with loops or long arcs could fill the disk.
_MOST_POINTS = 50_000_000
# A nanometre: above the floating-point noise of added offsets, far below any tolerance.
_OUTSIDE_MM = 1e-6
_AXIS_BITS = np.array([1, 2, 4])


class ProgramWriter:
    """Writer that converts moves to corrected lines and passes all lines of the program in their order to the function
    `emit`.

    `position` is the axis position of the controller in mm after all lines written so far, or NaN if it is unknown.
    `newline` is the line end of the written lines.
    """

    def __init__(
        self,
        table: CompensationTable,
        options: CorrectionOptions,
        start: Triple,
        unit_mm: float,
        emit: Callable[[str], object],
    ) -> None:
        self.table = table
        self.options = options
        self.counts = CorrectionSummary()
        self.newline = "\n"
        self._emit = emit
        self._held = options.outside == "refuse"
        # Clamped points leave the table, where the slope of the correction jumps to zero at the border.
        self._bending = TableCurvature.of(table, beyond=not self._held)
        self._limit_mm = _without_rounding(options)
        self._items: list[str | MoveBlock] = []
        self._ends: list[Triple] = []
        self._frames: list[Frame] = []
        self._arcs: dict[int, Arc] = {}
        self.resume_at(start, list(start), unit_mm)

    def resume_at(self, programmed: Triple, position: list[float], unit_mm: float) -> None:
        """Set the state from which the writer continues.

        `programmed` is the axis position according to the program in mm. `position` is the actual axis position of the
        controller in mm. `unit_mm` is the length of the program's unit in mm.
        """
        self._programmed = programmed
        self.position = position
        self.unit_mm = unit_mm
        self.decimals = self.options.decimals + (unit_mm == MM_PER_INCH)
        self._pen = LineFormatter(self.decimals)

    def write_unchanged(self, text: str) -> None:
        """Add a line to the output without changing it."""
        self._items.append(text)
        if len(self._items) >= _BATCH_LINES:
            self._write_batch()

    def move(self, move: MoveBlock, end: Triple, frame: Frame, arc: Arc | None) -> None:
        """Collect a move to the uncorrected axis position `end` in mm. The move is written later, with words relative
        to `frame`, which gives the zero point of the controller and the distance mode.
        """
        if arc is not None:
            self._arcs[len(self._ends)] = arc
        self._items.append(move)
        self._ends.append(end)
        self._frames.append(frame)
        if len(self._items) >= _BATCH_LINES:
            self._write_batch()

    def flush(self) -> None:
        """Write all collected lines, which brings `position` up to date. The next move is written with its G code (G0
        or G1), even if this code is already in effect.
        """
        self._write_batch()
        self._pen.forget()

    def corrected_point(self, point: Triple, block: Block) -> Triple:
        """Return the corrected axis position of `point` in mm. The point is not included in the counts of the summary.

        If the point is outside the volume of the table and such points are not permitted, a FormatError that names
        `block` is raised.
        """
        points = np.array([point])
        found = correct_points(self.table, points, held=self._held)
        if self._held and found.beyond_mm[0] > _OUTSIDE_MM:
            block.refuse(self._where_outside(points[0]), _OUTSIDE_HINT)
        x, y, z = found.points[0].tolist()
        return x, y, z

    def _write_batch(self) -> None:
        texts = self._moves()
        lines: list[str] = []
        for item in self._items:
            if isinstance(item, str):
                lines.append(item)
            else:
                lines.extend(next(texts))
            if len(lines) >= _BATCH_LINES:
                self._put(lines)
        self._put(lines)
        self._items.clear()
        if self._ends:
            self._programmed = self._ends[-1]
        self._ends, self._frames, self._arcs = [], [], {}

    def _put(self, lines: list[str]) -> None:
        if lines:
            self.counts.written_lines += len(lines)
            lines.append("")
            self._emit(self.newline.join(lines))
            lines.clear()

    def _moves(self) -> Iterator[list[str]]:
        """Yield for each collected move the list of its lines; the points are computed in batches of some thousand."""
        if not self._ends:
            return
        moves = [item for item in self._items if not isinstance(item, str)]
        ends = np.array(self._ends)
        paths = MovePaths(np.concatenate((np.array([self._programmed]), ends[:-1])), ends, self._arcs)
        dividable = np.array([self.options.divide_rapids or move.code != "G0" for move in moves])
        pieces = paths.pieces(self._bending, dividable, self._limit_mm)
        self._check_pieces(moves, pieces)
        first = 0
        # A part consists of whole moves, because the lines of a move are formatted together.
        part = np.cumsum(pieces) // _PART_POINTS
        for after in [*(np.flatnonzero(np.diff(part)) + 1).tolist(), len(moves)]:
            yield from self._part(moves, paths, first, pieces[first:after])
            first = after

    def _part(self, moves: list[MoveBlock], paths: MovePaths, first: int, pieces: Indices) -> Iterator[list[str]]:
        points, rows, last = paths.points(first, pieces)
        found = correct_points(self.table, points, held=self._held)
        self._check_volume(moves, rows, points, found)
        frames = self._frames[first : first + len(pieces)]
        words = round_to_words(found.points, frames, rows - first, self.position, self.unit_mm, self.decimals)
        self.position = words.position[-1].tolist()
        axes = words.changed @ _AXIS_BITS
        # The last line of a move keeps every word of the program, even if the value does not change: a line with axis
        # words stays a move.
        axes[last] |= np.array([move.mask for move in moves[first : first + len(pieces)]])
        values, bits = words.values.tolist(), axes.tolist()
        pen, at = self._pen, 0
        for move, count in zip(moves[first : first + len(pieces)], pieces.tolist(), strict=True):
            if count == 1:
                yield [pen.line(move, values[at], bits[at])]
            else:
                yield list(pen.lines(move, values[at : at + count], bits[at : at + count]))
            at += count

    def _check_pieces(self, moves: list[MoveBlock], pieces: Indices) -> None:
        """Refuse moves that must not be divided, need too many pieces, or make the program too long. Update the
        counts."""
        for row in np.flatnonzero(pieces > 1).tolist():
            move = moves[row]
            if move.whole:
                hint = "Put that word into its own block, or allow a larger chord error"
                raise move.source.refusal(f"this move has to be divided, and {move.whole}", hint)
            if pieces[row] > _MOST_PIECES:
                message = f"the chord error requires {int(pieces[row])} pieces"
                raise move.source.refusal(message, "Allow a larger chord error")
        too_long = self.counts.points + np.cumsum(pieces) > _MOST_POINTS
        if too_long.any():
            message = f"the corrected program would have more than {_MOST_POINTS} points"
            hint = "Allow a larger chord error, or divide the program; a loop around this line may be endless"
            raise moves[int(np.argmax(too_long))].source.refusal(message, hint)
        self.counts.moves += len(moves)
        self.counts.divided += int((pieces > 1).sum())
        self.counts.arcs += len(self._arcs)

    def _check_volume(self, moves: list[MoveBlock], rows: Indices, points: np.ndarray, found: CorrectedPoints) -> None:
        """Refuse points outside the table unless they are allowed; update the counts."""
        counts = self.counts
        outside = found.beyond_mm > _OUTSIDE_MM
        if outside.any():
            if self.options.outside == "refuse":
                row = rows[np.argmax(outside)]
                move, index = moves[int(row)], int(np.argmax(np.where(rows == row, found.beyond_mm, -np.inf)))
                raise move.source.refusal(self._where_outside(points[index]), _OUTSIDE_HINT)
            counts.outside += int(outside.sum())
            counts.outside_mm = max(counts.outside_mm, float(found.beyond_mm.max()))
        counts.points += len(points)
        counts.held += int((found.held_mm > 0.0).sum())
        counts.held_mm = max(counts.held_mm, float(found.held_mm.max()))
        counts.extrapolated += found.extrapolated
        counts.largest_correction_mm = max(counts.largest_correction_mm, found.largest_mm)

    def _where_outside(self, point: np.ndarray) -> str:
        beyond = [max(nodes[0] - at, at - nodes[-1]) for at, nodes in zip(point, self.table.nodes, strict=True)]
        axis = int(np.argmax(beyond))
        reach = f"{self.table.nodes[axis][0]:g} to {self.table.nodes[axis][-1]:g} mm"
        return f"{AXIS_LETTERS[axis]} is at machine position {point[axis]:.3f} mm, but the table covers {reach}"


_OUTSIDE_HINT = (
    "Check the work offsets, tool lengths and units; `--outside clamp` uses the correction at the table's border"
)


def _without_rounding(options: CorrectionOptions) -> float:
    """Return the permissible chord error minus the rounding error of words.

    Raises DataError if nothing remains.
    """
    # A program may switch between mm and inches, which have one decimal more: the coarser step counts.
    step = max(10.0**-options.decimals, MM_PER_INCH * 0.1 ** (options.decimals + 1))
    # Half a step along each axis: half the diagonal of a cube.
    rounding: float = 0.5 * math.sqrt(3.0) * step
    if rounding >= options.max_chord_error_mm:
        largest = f"{1e3 * rounding:.3g} µm"
        message = f"words of {options.decimals} decimals round by up to {largest}, which uses up the whole chord error"
        raise DataError(message, hint="Write more decimals, or allow a larger chord error")
    return options.max_chord_error_mm - rounding
