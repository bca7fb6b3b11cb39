"""Mechanical actions on a machine that make its volumetric error smaller, chosen from an estimate by their gain.

Two kinds of actions move the tool point by a field that is known exactly up to a rigid motion of the whole workspace: a
changed scale of an axis, and a guide that is turned, with all that it carries, on what carries it. Of two axes that are
not square, the one farther from the bed is turned: the other one would take it along. The third axis is parallel to the
axis of this turn and keeps its direction. Shims that bend a rail are not proposed: they also tilt what it carries.

The amounts are those that leave the smallest expected mean square of the error field after the best-fitting rigid
motion is removed. Actions are added greedily, and all amounts are fitted anew with each of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from itertools import combinations

import numpy as np

from twin.arrays import Array
from twin.errors import DataError
from twin.identification.predicted import field_degrees, unresolved_variance
from twin.machine.error_model import ErrorModel
from twin.machine.grid_quadrature import GridQuadrature
from twin.machine.kinematic_chain import AXES
from twin.machine.rigid_motion import rigid_fields
from twin.machine.volumetric import evaluation_grid
from twin.workpiece.machine_field import MachineField, MachineKnowledge

MOST_ACTIONS = 5
COVERAGE = 0.95
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

    A `SCALE` action lengthens the motion of `axis` by `amount`, as a ratio. A `SQUARENESS` action turns the guide of
    `axis` by `amount`, in rad, so that the motion of the tool relative to the workpiece towards the positive direction
    of `axis` turns towards that of `towards`. `expanded` is the expanded uncertainty (k = 2) of the amount, and
    `travel_mm` the travel of `axis`.
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
    candidates = _candidates(estimate.model)
    forms = _ErrorForms.of(estimate, tool_offset, candidates)
    chosen: list[int] = []
    states = [forms.state([])]
    while len(chosen) < most:
        left = [number for number in range(len(candidates)) if number not in chosen]
        certain = [number for number in left if forms.are_certain([*chosen, number])]
        if not certain:
            break
        chosen.append(min(certain, key=lambda number: forms.remaining([*chosen, number])))
        states.append(forms.state(chosen))
    amounts, expanded = forms.amounts(chosen)
    return ActionPlan(
        tuple(
            replace(candidates[number], amount=float(amount), expanded=float(bound))
            for number, amount, bound in zip(chosen, amounts, expanded, strict=True)
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


def _candidates(model: ErrorModel) -> list[MechanicalAction]:
    """Return all actions with the amount 1. Of two square axes, the one farther from the bed is turned; of axes on
    different sides of the bed, the one that moves the tool."""
    low, high = np.array(model.ranges_mm).T
    travel_mm = dict(zip(AXES, (high - low).tolist(), strict=True))
    from_bed = [*model.chain.workpiece_side, *reversed(model.chain.tool_side)]
    found = [MechanicalAction(ActionKind.SCALE, name, name, 1.0, 0.0, travel_mm[name]) for name in AXES]
    for towards, turned in combinations(from_bed, 2):
        found.append(MechanicalAction(ActionKind.SQUARENESS, turned, towards, 1.0, 0.0, travel_mm[turned]))
    return found


@dataclass(frozen=True, eq=False)
class _ErrorForms:
    """Mean squares in mm² of an error field after the best-fitting rigid motion is removed.

    The field is the sum of the expected field, of what a draw of the P parameters and misfit coefficients differs from
    their expected values (`drawn`, shape (P, draws)), and of the actions. `form` (P + 1 + K, P + 1 + K) contains the
    mean products of the P columns, the expected field and the K fields of the actions with the amount 1. `beside_mm2`
    is the mean square of the misfit that no mode shows.
    """

    form: Array
    drawn: Array
    beside_mm2: float

    @classmethod
    def of(cls, estimate: MachineKnowledge, tool_offset: Array, actions: Sequence[MechanicalAction]) -> _ErrorForms:
        sums = GridQuadrature.for_points(evaluation_grid(estimate.model.ranges_mm), field_degrees(estimate))
        nodes = sums.nodes
        field = MachineField.at(estimate, nodes, tool_offset)
        fields = [field.expected, *(action_field(one, nodes).reshape(-1) for one in actions)]
        roots = np.sqrt(sums.weights / sums.count).repeat(3)[:, None]
        motions = np.linalg.qr(roots * rigid_fields(nodes, nodes.mean(axis=0), _LEVER_MM).reshape(nodes.size, 6))[0]
        columns = roots * np.column_stack((field.columns, *fields))
        shared = motions.T @ columns
        values, vectors = np.linalg.eigh(field.covariance)
        half = np.random.default_rng(_SEED).standard_normal((len(values), _DRAWS // 2))
        drawn = (vectors * np.sqrt(np.maximum(values, 0.0))) @ np.concatenate((half, -half), axis=1)
        beside_mm2 = 3.0 * unresolved_variance(estimate)
        return cls(np.asarray(columns.T @ columns - shared.T @ shared), np.asarray(drawn), beside_mm2)

    def amounts(self, chosen: Sequence[int]) -> tuple[Array, Array]:
        """Return the amounts (k,) of the `chosen` actions that leave the smallest expected mean square, and their
        expanded uncertainties (k,)."""
        fit, size = self._fit(chosen), len(self.drawn)
        return -fit[:, size], np.asarray(_COVERAGE_FACTOR * (fit[:, :size] @ self.drawn).std(axis=1))

    def are_certain(self, chosen: Sequence[int]) -> bool:
        """Return True if all amounts exceed their expanded uncertainties."""
        amounts, expanded = self.amounts(chosen)
        return bool((np.abs(amounts) > expanded).all())

    def remaining(self, chosen: Sequence[int]) -> float:
        """Return the mean square in mm² of the expected field that the best amounts leave."""
        size = len(self.drawn)
        return float(self.form[size, size] - self.form[size, self._rows(chosen)] @ self._fit(chosen)[:, size])

    def state(self, chosen: Sequence[int]) -> VolumetricState:
        """Return the volumetric error with the best amounts of the `chosen` actions."""
        size, rows = len(self.drawn), self._rows(chosen)
        used = [*range(size + 1), *rows]
        moved = np.concatenate(([1.0], self.amounts(chosen)[0]))[:, None].repeat(self.drawn.shape[1], axis=1)
        fields = np.concatenate((self.drawn, moved))
        squares = np.maximum(np.sum(fields * (self.form[np.ix_(used, used)] @ fields), axis=0), 0.0)
        low, high = np.quantile(squares, [0.5 * (1.0 - COVERAGE), 0.5 * (1.0 + COVERAGE)])
        found = (squares.mean() + self.beside_mm2, low, high + self.beside_mm2)
        return VolumetricState(*(float(np.sqrt(one)) for one in found))

    def _fit(self, chosen: Sequence[int]) -> Array:
        """Return the amounts (k, P + 1 + K) of the chosen fields of which each field contains most."""
        rows = self._rows(chosen)
        return np.asarray(np.linalg.solve(self.form[np.ix_(rows, rows)], self.form[rows]))

    def _rows(self, chosen: Sequence[int]) -> list[int]:
        return [len(self.drawn) + 1 + number for number in chosen]
