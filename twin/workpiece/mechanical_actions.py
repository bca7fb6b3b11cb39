"""Mechanical actions on a machine that make its volumetric error smaller, chosen from an estimate by their gain.

Two kinds of actions move the tool point by a field that is known exactly up to a rigid motion of the whole workspace,
whatever the kinematic chain: a changed scale of an axis, and a guide that is turned at the joint to its neighbour, by
which the squareness of two axes changes. Shims that bend a rail are not proposed: they also tilt what the rail carries.

The amounts are those that leave the smallest expected mean square of the error field after the best-fitting rigid
motion is removed. Actions are added greedily, and all amounts are fitted anew with each of them.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from itertools import combinations

import numpy as np

from twin.arrays import Array
from twin.errors import DataError
from twin.identification.predicted import unresolved_variance
from twin.machine.error_model import Ranges
from twin.machine.grid_quadrature import GridQuadrature
from twin.machine.kinematic_chain import AXES
from twin.machine.rigid_motion import rigid_fields
from twin.machine.volumetric import evaluation_grid
from twin.workpiece.machine_field import MachineField, MachineKnowledge

MOST_ACTIONS = 5
COVERAGE = 0.95
_DEGREES = (9, 7, 7)  # of the errors along X, Y and Z, up to which sums over the grid are exact
_DRAWS = 1000
_SEED = 17
_LEVER_MM = 1000.0  # scale on which rotations and translations are compared
_COVERAGE_FACTOR = 2.0


class ActionKind(StrEnum):
    """Kind of a mechanical action."""

    SCALE = "scale"
    SQUARENESS = "squareness"


@dataclass(frozen=True)
class MechanicalAction:
    """Action on one joint of a machine.

    A `SCALE` action lengthens the motion of `axis` by `amount`, as a ratio. A `SQUARENESS` action turns the motion of
    `axis` towards the positive direction of the axis `towards` by `amount`, in rad. `expanded` is the expanded
    uncertainty (k = 2) of the amount, and `travel_mm` the travel of `axis`.
    """

    kind: ActionKind
    axis: str
    towards: str
    amount: float
    expanded: float
    travel_mm: float

    @property
    def over_travel_mm(self) -> float:
        """Displacement in mm that the action makes over the travel of its axis."""
        return self.amount * self.travel_mm


@dataclass(frozen=True)
class VolumetricState:
    """Volumetric error in mm, with the best-fitting rigid motion removed: the root of the expected mean square, and the
    ends of the interval that contains the error with a probability of 95 %.

    No ball centre shows errors that are too short for the misfit modes: the upper end counts them in full, the lower
    end does not (`twin.uncertainty.volumetric_limits`).
    """

    expected_mm: float
    low_mm: float
    high_mm: float


@dataclass(frozen=True)
class ActionPlan:
    """Actions in the order of their gain, with the amounts that belong to all of them together.

    `states` are the volumetric errors before the first action and after the first one, the first two and so on, each
    with the amounts that are best for these actions alone.
    """

    actions: tuple[MechanicalAction, ...]
    states: tuple[VolumetricState, ...]


def plan_actions(estimate: MachineKnowledge, tool_offset: Array, most: int = MOST_ACTIONS) -> ActionPlan:
    """Return at most `most` actions on the machine of `estimate`, for a tool with the offset `tool_offset` (3,) in mm.

    An action is proposed only if its amount is larger than its expanded uncertainty. Raises DataError if `most` is not
    at least 1.
    """
    if most < 1:
        raise DataError(f"at least one action must be allowed, not {most}")
    ranges = estimate.model.ranges_mm
    grid = _WeightedGrid.over(ranges)
    drawn, expected, beside_mm2 = _aligned_draws(estimate, grid, tool_offset)
    low, high = np.array(ranges).T
    candidates = _candidates(high - low)
    fields = np.stack([grid.aligned(action_field(one, grid.positions)) for one in candidates], axis=1)
    chosen: list[int] = []
    states = [_state(drawn, beside_mm2)]
    while len(chosen) < most:
        left = [number for number in range(len(candidates)) if number not in chosen]
        if not left:
            break
        best = min(left, key=lambda number: _remaining(fields[:, [*chosen, number]], expected))
        amounts, expanded = _amounts(fields[:, [*chosen, best]], expected, drawn)
        if not (np.abs(amounts) > expanded).all():
            break
        chosen.append(best)
        moved = fields[:, chosen] @ amounts
        states.append(_state(drawn + moved[:, None], beside_mm2))
    if not chosen:
        return ActionPlan((), tuple(states))
    amounts, expanded = _amounts(fields[:, chosen], expected, drawn)
    return ActionPlan(
        tuple(
            MechanicalAction(one.kind, one.axis, one.towards, float(amount), float(bound), one.travel_mm)
            for one, amount, bound in zip((candidates[number] for number in chosen), amounts, expanded, strict=True)
        ),
        tuple(states),
    )


def action_field(action: MechanicalAction, axis_positions: Array) -> Array:
    """Return the displacements (n, 3) in mm of the tool point that `action` makes at axis positions (n, 3), up to a
    rigid motion of the whole workspace."""
    axis, towards = AXES.index(action.axis), AXES.index(action.towards)
    found = np.zeros_like(axis_positions)
    found[:, towards] = action.amount * axis_positions[:, axis]
    return found


def _candidates(travel_mm: Array) -> list[MechanicalAction]:
    """Return all actions with the amount 1. Of two square axes, turning the one or the other is the same up to a rigid
    motion: the shorter one is turned."""
    found = [
        MechanicalAction(ActionKind.SCALE, name, name, 1.0, 0.0, float(travel_mm[axis]))
        for axis, name in enumerate(AXES)
    ]
    for pair in combinations(range(3), 2):
        shorter, longer = sorted(pair, key=lambda axis: float(travel_mm[axis]))
        turned = MechanicalAction(
            ActionKind.SQUARENESS, AXES[shorter], AXES[longer], 1.0, 0.0, float(travel_mm[shorter])
        )
        found.append(turned)
    return found


@dataclass(frozen=True, eq=False)
class _WeightedGrid:
    """Nodes (n, 3) in mm of the grid over which a volumetric error is taken, with the roots (3n,) of their weights,
    whose squares have the sum 3, and an orthonormal basis (3n, 6) of the weighted rigid motions."""

    positions: Array
    roots: Array
    motions: Array

    @classmethod
    def over(cls, ranges_mm: Ranges) -> _WeightedGrid:
        sums = GridQuadrature.for_points(evaluation_grid(ranges_mm), _DEGREES)
        nodes = sums.nodes
        roots = np.sqrt(sums.weights / sums.count).repeat(3)
        motions = rigid_fields(nodes, nodes.mean(axis=0), _LEVER_MM).reshape(nodes.size, 6)
        return cls(nodes, roots, np.asarray(np.linalg.qr(roots[:, None] * motions)[0]))

    def aligned(self, fields: Array) -> Array:
        """Return fields (3n,), (n, 3) or (3n, m), weighted and without their best-fitting rigid motion, as (3n,) or
        (3n, m). The sum of the squares of one is its mean square."""
        flat = self.roots[:, None] * fields.reshape(self.positions.size, -1)
        left = flat - self.motions @ (self.motions.T @ flat)
        return np.asarray(left[:, 0] if left.shape[1] == 1 else left)


def _aligned_draws(estimate: MachineKnowledge, grid: _WeightedGrid, tool_offset: Array) -> tuple[Array, Array, float]:
    """Return drawn error fields (3n, draws) and the expected one (3n,) in mm without rigid motion, and the mean square
    in mm² of the unresolved misfit."""
    field = MachineField.at(estimate, grid.positions, tool_offset)
    values, vectors = np.linalg.eigh(field.covariance)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    half = np.random.default_rng(_SEED).standard_normal((root.shape[1], _DRAWS // 2))
    spread = grid.aligned(field.columns @ (root @ np.concatenate((half, -half), axis=1)))
    expected = grid.aligned(field.expected)
    return np.asarray(expected[:, None] + spread), expected, 3.0 * unresolved_variance(estimate)


def _amounts(fields: Array, expected: Array, drawn: Array) -> tuple[Array, Array]:
    """Return the best amounts (k,) of k fields (3n, k), and their expanded uncertainty (k,)."""
    fit = -np.linalg.pinv(fields)
    return np.asarray(fit @ expected), np.asarray(_COVERAGE_FACTOR * (fit @ drawn).std(axis=1))


def _remaining(fields: Array, expected: Array) -> float:
    """Return the sum of squares of the expected field that the best amounts of `fields` leave."""
    left = expected - fields @ (np.linalg.pinv(fields) @ expected)
    return float(left @ left)


def _state(drawn: Array, beside_mm2: float) -> VolumetricState:
    squares = np.sum(drawn**2, axis=0)
    low, high = np.quantile(squares, [0.5 * (1.0 - COVERAGE), 0.5 * (1.0 + COVERAGE)])
    return VolumetricState(*(float(np.sqrt(one)) for one in (squares.mean() + beside_mm2, low, high + beside_mm2)))
