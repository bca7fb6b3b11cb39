"""State in which the finished steps of a run have left the machine: its position, the directions of approach, and the
active compensation."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from agent.execution.encoding import table_digest
from agent.execution.steps import (
    ActivateBank,
    AskOperator,
    MoveTo,
    OrientTo,
    Point,
    ReadActiveBank,
    ReadPosition,
    ReadTable,
    Record,
    StageTable,
    Step,
    TouchTowards,
)
from agent.execution.tip_trace import LastMotion
from drivers.roles import Miss, PlacementRequest, TableImage, Touch

LONG_MM = 1.0
"""Travel of one axis that certainly takes up its play, so that earlier motion no longer has an effect."""
CLEAR_MM = 1.0
"""Longest distance, from the start of a touch, that the return repeats; this part ends short of the surface."""


@dataclass(frozen=True)
class AxisMove:
    """Motion of one axis from `start_mm` to `end_mm` in the step with the key `key`."""

    key: str
    start_mm: float
    end_mm: float

    @property
    def sign(self) -> float:
        return 1.0 if self.end_mm > self.start_mm else -1.0

    @property
    def beside_mm(self) -> float:
        """Coordinate in mm from which the axis can approach `end_mm` again in the direction of this motion.

        It lies on the path of the motion, at most 2 mm before the end.
        """
        return self.end_mm - self.sign * min(2.0 * LONG_MM, abs(self.end_mm - self.start_mm))


@dataclass
class StepTrace:
    """State of the machine and of the compensation after the steps that a run has finished so far.

    `at_mm` contains the axis positions in mm; it is None until they are read. `axes` contains, for each axis, its last
    motions, which determine the side on which the play of the axis is taken up. `moved` is True after the first motion.
    `pose` is the step of the last finished turn of the mount. `found` contains the ball centres found in this pose with
    the active table, each with the key of its journal record, in the order of measurement. `placed` is True if a
    person has placed the artefact by hand in its present position. `contents` maps each table
    bank of the controller to the CRC-32 of its table. `staged` is the last step that wrote a table into a bank.
    """

    at_mm: Point | None = None
    axes: tuple[list[AxisMove], list[AxisMove], list[AxisMove]] = field(default_factory=lambda: ([], [], []))
    moved: bool = False
    last_motion: LastMotion = field(default_factory=LastMotion)
    pose: OrientTo | None = None
    found: list[tuple[str, Point]] = field(default_factory=list)
    placed: bool = False
    active_bank: int | None = None
    contents: dict[int, int | None] = field(default_factory=dict)
    staged: StageTable | None = None

    @property
    def datums(self) -> list[tuple[str, Point]]:
        """Balls that show whether the artefact has moved: the ball found last and the one farthest from it.

        Two balls also show a rotation about one of them. There is one if no other ball was found, none if no ball was.
        """
        if not self.found:
            return []
        last = self.found[-1]
        farthest = max(self.found, key=lambda one: math.dist(one[1], last[1]))
        return [last] if math.dist(farthest[1], last[1]) < LONG_MM else [last, farthest]

    def add(self, step: Step, result: object) -> None:
        """Update this state with a finished step of the run and the result of the step."""
        match step:
            case MoveTo():
                self.last_motion.begin(step.target_mm, touch=False)
                self.last_motion.end(step.target_mm)
                self._add_motion(step.key, step.target_mm)
            case TouchTowards():
                self._add_touch(step, result)
            case ReadPosition() if self.at_mm is None and isinstance(result, tuple):
                self.at_mm = result
                self.last_motion.set_position(result)
            case OrientTo():
                self.pose, self.found = step, []
            case AskOperator():
                self.pose, self.found = None, []
                self.placed = isinstance(step.request, PlacementRequest)
            case Record():
                self._add_record(step)
            case ReadActiveBank() if isinstance(result, int):
                self.active_bank = result
            case ReadTable() if isinstance(result, TableImage):
                self.contents[step.bank] = table_digest(result)
            case StageTable():
                self.contents[step.bank], self.staged = table_digest(step.table), step
            case ActivateBank():
                self.active_bank, self.found = step.bank, []

    def forget_placement(self) -> None:
        """Forget the balls and the position of the tip at which the artefact was found to be moved. The probe was then
        withdrawn, and the next reading of the position is the present one."""
        self.found, self.at_mm = [], None
        for moves in self.axes:
            moves.clear()

    def _add_motion(self, key: str, end: Point) -> None:
        start = self.at_mm
        self.at_mm, self.moved = end, True
        if start is None:
            return
        for moves, before, after in zip(self.axes, start, end, strict=True):
            if before == after:
                continue
            if abs(after - before) >= LONG_MM:
                moves.clear()
            moves.append(AxisMove(key, before, after))

    def _add_touch(self, step: TouchTowards, result: object) -> None:
        """Add a touch as a motion that ends short of the surface, where the next step can begin just as well."""
        if self.at_mm is None or not isinstance(result, (Touch, Miss)):
            return
        self.last_motion.begin(step.target_mm, touch=True)
        self.last_motion.end(result.position_mm)
        start = np.array(self.at_mm)
        motion = np.array(result.position_mm) - start
        length = float(np.linalg.norm(motion))
        share = min(0.5, CLEAR_MM / length) if length > 0.0 else 0.0
        # An axis that the touch does not move keeps its exact coordinate.
        still = np.array(step.target_mm) == start
        x, y, z = np.where(still, start, start + share * motion).tolist()
        self._add_motion(step.key, (x, y, z))

    def _add_record(self, step: Record) -> None:
        centre = step.payload.get("centre_mm")
        if centre is not None:
            x, y, z = (float(value) for value in centre)
            self.found.append((step.key, (x, y, z)))
