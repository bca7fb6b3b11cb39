"""State in which the finished steps of a run have left the machine: its position, the directions of approach, and the
active compensation."""

from __future__ import annotations

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
from drivers.roles import Miss, TableImage, Touch

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
    `pose` is the step of the last finished turn of the mount. `datum_mm` is the last ball centre found in this pose
    with the active table, and `datum_key` is the key of the journal record of this ball. `contents` maps each table
    bank of the controller to the CRC-32 of its table. `staged` is the last step that wrote a table into a bank.
    """

    at_mm: Point | None = None
    axes: tuple[list[AxisMove], list[AxisMove], list[AxisMove]] = field(default_factory=lambda: ([], [], []))
    moved: bool = False
    last_motion: LastMotion = field(default_factory=LastMotion)
    pose: OrientTo | None = None
    datum_mm: Point | None = None
    datum_key: str = ""
    active_bank: int | None = None
    contents: dict[int, int | None] = field(default_factory=dict)
    staged: StageTable | None = None

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
                self.pose, self.datum_mm = step, None
            case AskOperator():
                self.pose = self.datum_mm = None
            case Record():
                self._add_record(step)
            case ReadActiveBank() if isinstance(result, int):
                self.active_bank = result
            case ReadTable() if isinstance(result, TableImage):
                self.contents[step.bank] = table_digest(result)
            case StageTable():
                self.contents[step.bank], self.staged = table_digest(step.table), step
            case ActivateBank():
                self.active_bank, self.datum_mm = step.bank, None

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
            self.datum_mm, self.datum_key = (x, y, z), step.key
