"""Fields by which mechanical actions on a machine move the tool point.

- A changed scale, and a guide that is turned with all that it carries, on what carries it. Of two axes that are not
  square, the one farther from the bed is turned: the other one would take it along. The third axis is parallel to the
  axis of this turn and keeps its direction.
- Shims that straighten a guide. The rail bends as a beam does over its supports (a natural cubic spline through the
  shims), and the carriage follows it with its first and last shoe: it moves by their mean and tilts by their
  difference. Both depend on the `Guide`, so only guides that are known are straightened.
- Levelling, which turns the carriage nearest to the bed about its direction of travel by an angle that grows along the
  travel. It turns about the middle of its shoes, or, if the guide is not known, about the middle of the workspace: a
  turn about another line differs from this one by a squareness.

Each field is stated up to a rigid motion of the whole workspace, in mm per unit of each amount of the action.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from enum import StrEnum
from itertools import combinations

import numpy as np
from scipy.interpolate import CubicSpline

from twin.arrays import Array
from twin.machine.error_model import ErrorModel
from twin.machine.kinematic_chain import AXES, Chain
from twin.machine.mounting import Guide, Mounting

SHIMS = 3
"""Places at which a guide is shimmed between its ends, evenly spaced."""
_LEVELLED = ("X", "Y")


class ActionKind(StrEnum):
    """Kind of a mechanical action."""

    SCALE = "scale"
    SQUARENESS = "squareness"
    STRAIGHTNESS = "straightness"
    LEVEL = "level"


@dataclass(frozen=True)
class Shim:
    """Thickness in mm by which a guide is shimmed at `at_mm`, the axis position at which the middle of the shoes is
    there, with the expanded uncertainty (k = 2) of its difference to the shims at both ends of the guide. The ends lie
    half the distance of the shoes beyond the travel."""

    at_mm: float
    amount_mm: float
    expanded_mm: float


@dataclass(frozen=True)
class RaisedFoot:
    """Foot that is to be raised, by `height_mm`."""

    name: str
    height_mm: float


@dataclass(frozen=True)
class MechanicalAction:
    """Action on one joint of a machine.

    - A `SCALE` action lengthens the motion of `axis` by `amount`, as a ratio.
    - A `SQUARENESS` action turns the guide of `axis` by `amount`, in rad, so that the motion of the tool relative to
      the workpiece towards the positive direction of `axis` turns towards that of `towards`.
    - A `STRAIGHTNESS` action moves the guide of `axis` by its `shims` in the direction of `towards`, those at both ends
      included. None is negative: all of them may be thicker by the same amount, which is a rigid motion. `amount` is
      the largest difference to those at the ends, in mm.
    - A `LEVEL` action turns what the guide of `axis` carries about the positive direction of `axis`: from
      -`amount` / 2, in rad, at the lower end of the travel to `amount` / 2 at the upper end. `feet` are to be raised
      for this, if the feet of the bed are known.

    `expanded` is the expanded uncertainty (k = 2) of the amount, and `travel_mm` the travel of `axis`, from the axis
    position `low_mm`.
    """

    kind: ActionKind
    axis: str
    towards: str
    amount: float
    expanded: float
    travel_mm: float
    low_mm: float = 0.0
    shims: tuple[Shim, ...] = ()
    feet: tuple[RaisedFoot, ...] = ()

    @property
    def over_travel_mm(self) -> float:
        """Displacement in mm that a scale or a turned guide makes over the travel of its axis."""
        return self.amount * self.travel_mm


@dataclass(frozen=True)
class Candidate:
    """Action that can be chosen: its kind, its axis and the direction `towards`. `places_mm` (k,) are the places of its
    shims; `guide` is None if it is not known or does not matter."""

    kind: ActionKind
    axis: str
    towards: str
    model: ErrorModel
    guide: Guide | None = None
    places_mm: tuple[float, ...] = field(default=())

    @property
    def size(self) -> int:
        """Number of amounts."""
        return max(len(self.places_mm), 1)

    def columns(self, axis_positions: Array, tool_offset: Array) -> Array:
        """Return the displacements (n, 3, k) in mm of the tool point at axis positions (n, 3) by each of its k amounts
        when it is 1."""
        if self.kind is ActionKind.STRAIGHTNESS:
            return self._shimmed(axis_positions, tool_offset)
        found = np.zeros((*axis_positions.shape, 1))
        axis = AXES.index(self.axis)
        if self.kind is ActionKind.LEVEL:
            low, high = self.model.ranges_mm[axis]
            roll = (axis_positions[:, axis, None] - 0.5 * (low + high)) / (high - low) * np.eye(3)[axis]
            found[:, :, 0] = _side(self.model.chain, self.axis) * np.cross(
                roll, self._lever(axis_positions, tool_offset)
            )
        else:
            found[:, AXES.index(self.towards), 0] = axis_positions[:, axis]
        return found

    def action(self, amounts: Array, expanded: Array, mounting: Mounting) -> MechanicalAction:
        """Return the action with its amounts (k,) and their expanded uncertainties (k,)."""
        low, high = self.model.ranges_mm[AXES.index(self.axis)]
        largest = int(np.argmax(np.abs(amounts)))
        amount, bound = float(amounts[largest]), float(expanded[largest])
        shims = self._shims(amounts, expanded) if self.kind is ActionKind.STRAIGHTNESS else ()
        feet = self._raised_feet(amount, mounting) if self.kind is ActionKind.LEVEL and mounting.feet else ()
        return MechanicalAction(self.kind, self.axis, self.towards, amount, bound, high - low, low, shims, feet)

    def _shims(self, amounts: Array, expanded: Array) -> tuple[Shim, ...]:
        """Return the shims of a guide from end to end. The thinnest one is zero."""
        assert self.guide is not None  # noqa: S101  a guide that is not known is no candidate
        places = _supports(self.model.ranges_mm[AXES.index(self.axis)], self.guide.shoes_mm)
        heights, bounds = np.pad(amounts, 1), np.pad(expanded, 1)
        heights = heights - heights.min()
        return tuple(Shim(*map(float, one)) for one in zip(places, heights, bounds, strict=True))

    def _raised_feet(self, amount: float, mounting: Mounting) -> tuple[RaisedFoot, ...]:
        # The height of a twisted bed is t x y: about X it turns by t x, about Y by -t y. A table on the bed stands at
        # the negative axis position.
        low, high = self.model.ranges_mm[AXES.index(self.axis)]
        sign = _side(self.model.chain, self.axis) * (1.0 if self.axis == "X" else -1.0)
        heights = mounting.heights_mm(sign * amount / (high - low))
        return tuple(RaisedFoot(foot.name, height) for foot, height in zip(mounting.feet, heights, strict=True))

    def _shimmed(self, axis_positions: Array, tool_offset: Array) -> Array:
        assert self.guide is not None  # noqa: S101  a guide that is not known is no candidate
        axis, shoes_mm = AXES.index(self.axis), self.guide.shoes_mm
        side = _side(self.model.chain, self.axis)
        spline = _rail(self.model.ranges_mm[axis], shoes_mm)
        at = axis_positions[:, axis]
        # The shoe that is ahead on the guide; a table moves against the displayed position.
        ahead, behind = spline(at + 0.5 * side * shoes_mm), spline(at - 0.5 * side * shoes_mm)
        across = np.eye(3)[AXES.index(self.towards)]
        turned = np.cross(np.cross(np.eye(3)[axis], across), self._lever(axis_positions, tool_offset))
        moved = 0.5 * (ahead + behind)[:, None, :] * across[:, None]
        return np.asarray(side * (moved + turned[:, :, None] * ((ahead - behind) / shoes_mm)[:, None, :]))

    def _lever(self, axis_positions: Array, tool_offset: Array) -> Array:
        """Return the vectors (n, 3) in mm from the middle of the shoes to the tool point."""
        carried = [AXES.index(name) in _between(self.model.chain, self.axis) for name in AXES]
        moved = np.where(carried, axis_positions, 0.0)
        if self.guide is not None:
            return np.asarray(moved + tool_offset - np.array(self.guide.centre_mm))
        return np.asarray(moved - np.where(carried, np.mean(self.model.ranges_mm, axis=1), 0.0))


def candidates(model: ErrorModel, mounting: Mounting) -> tuple[Candidate, ...]:
    """Return all actions that are possible on a machine."""
    return (
        *(Candidate(ActionKind.SCALE, name, name, model) for name in AXES),
        *_turned_guides(model),
        *_straightened_guides(model, mounting),
        *_levelled_guides(model, mounting),
    )


def _turned_guides(model: ErrorModel) -> Iterator[Candidate]:
    """Yield the actions on squareness. Of two axes, the one farther from the bed is turned; of axes on different sides
    of the bed, the one that moves the tool."""
    from_bed = [*model.chain.workpiece_side, *reversed(model.chain.tool_side)]
    for towards, turned in combinations(from_bed, 2):
        yield Candidate(ActionKind.SQUARENESS, turned, towards, model)


def _straightened_guides(model: ErrorModel, mounting: Mounting) -> Iterator[Candidate]:
    for axis, (low, high) in zip(AXES, model.ranges_mm, strict=True):
        guide = mounting.guides.get(axis)
        if guide is not None:
            places = tuple(_supports((low, high), guide.shoes_mm)[1:-1].tolist())
            for towards in AXES:
                if towards != axis:
                    yield Candidate(ActionKind.STRAIGHTNESS, axis, towards, model, guide, places)


def _levelled_guides(model: ErrorModel, mounting: Mounting) -> Iterator[Candidate]:
    nearest = (*model.chain.tool_side[-1:], *model.chain.workpiece_side[:1])
    for axis in nearest:
        if axis in _LEVELLED:
            yield Candidate(ActionKind.LEVEL, axis, axis, model, mounting.guides.get(axis))


def _rail(travel_mm: tuple[float, float], shoes_mm: float) -> CubicSpline:
    """Return the shape of a rail by each of its shims: the splines through 1 at this shim, and through 0 at the other
    ones and at both ends."""
    return CubicSpline(_supports(travel_mm, shoes_mm), np.eye(SHIMS + 2)[:, 1:-1], bc_type="natural")


def _supports(travel_mm: tuple[float, float], shoes_mm: float) -> Array:
    """Return the places of the shims of a rail and of its ends, as axis positions in mm of the middle of the shoes."""
    low, high = travel_mm
    return np.linspace(low - 0.5 * shoes_mm, high + 0.5 * shoes_mm, SHIMS + 2)


def _side(chain: Chain, axis: str) -> float:
    """Return 1 for an axis that moves the tool, and -1 for one that moves the workpiece."""
    return 1.0 if axis in chain.tool_side else -1.0


def _between(chain: Chain, axis: str) -> tuple[int, ...]:
    """Return the numbers of the axes whose motion moves the tool point relative to the carriage of `axis`."""
    if axis in chain.tool_side:
        names: tuple[str, ...] = chain.tool_side[: chain.tool_side.index(axis)]
    else:
        names = (*chain.tool_side, *chain.workpiece_side[: chain.workpiece_side.index(axis) + 1])
    return tuple(AXES.index(name) for name in names)
