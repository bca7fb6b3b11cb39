"""Mechanical actions on a machine that make its volumetric error smaller, chosen from an estimate by their gain.

The actions and the fields by which they move the tool point are those of `twin.workpiece.action_fields`.

The amounts are those that leave the smallest expected mean square of the error field after the best-fitting rigid
motion is removed. Actions are added greedily, and all amounts are fitted anew with each of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from twin.arrays import Array
from twin.errors import DataError
from twin.identification.predicted import field_degrees, unresolved_variance
from twin.machine.grid_quadrature import GridQuadrature
from twin.machine.mounting import Mounting, require_shoes_within_travel
from twin.machine.rigid_motion import rigid_fields
from twin.machine.volumetric import evaluation_grid
from twin.workpiece.action_fields import ActionKind, Candidate, MechanicalAction, candidates
from twin.workpiece.machine_field import MachineField, MachineKnowledge

MOST_ACTIONS = 5
LARGEST_SHIM_MM = 1.0
"""Largest shim that is proposed. A rail that needs more was not fitted straight, or its carriage is not as stated."""
COVERAGE = 0.95
_DRAWS = 1000
_SEED = 17
_LEVER_MM = 1000.0  # scale on which rotations and translations are compared
_COVERAGE_FACTOR = 2.0
_DOUBTED = 0.0455
"""Probability with which the error of an amount exceeds its expanded uncertainty (k = 2), if it is one number."""
_DEGREE_OF_RAILS = 12  # the shape of a shimmed rail is no polynomial; its sums over the grid err by less than 1e-3


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


def plan_actions(
    estimate: MachineKnowledge, tool_offset: Array, most: int = MOST_ACTIONS, mounting: Mounting | None = None
) -> ActionPlan:
    """Return at most `most` actions on the machine of `estimate`, for a tool with the offset `tool_offset` (3,) in mm.

    `mounting` contains the guides and the feet of the machine, as far as they are known; only known guides are
    straightened. An action is proposed only if its amount is larger than its expanded uncertainty; an action with
    several amounts, only if one of them is, and if all of them together would be as improbable on a machine that does
    not need it. Nor is a guide straightened by more than `LARGEST_SHIM_MM`. Raises DataError if `most` is not at least
    1, and ModelError if the shoes of a guide are farther apart than its axis travels.
    """
    if most < 1:
        raise DataError(f"at least one action must be allowed, not {most}")
    mounting = mounting or Mounting()
    require_shoes_within_travel(mounting, estimate.model.ranges_mm)
    possible = candidates(estimate.model, mounting)
    forms = _ErrorForms.of(estimate, tool_offset, possible)
    chosen: list[int] = []
    states = [forms.state([])]
    while len(chosen) < most:
        left = [number for number in range(len(possible)) if number not in chosen]
        certain = [number for number in left if forms.are_certain([*chosen, number])]
        if not certain:
            break
        chosen.append(min(certain, key=lambda number: forms.remaining([*chosen, number])))
        states.append(forms.state(chosen))
    amounts, expanded = forms.amounts(chosen)
    actions, start = [], 0
    for number in chosen:
        own = slice(start, start + possible[number].size)
        actions.append(possible[number].action(amounts[own], expanded[own], mounting))
        start = own.stop
    return ActionPlan(tuple(actions), tuple(states))


@dataclass(frozen=True, eq=False)
class _ErrorForms:
    """Mean squares in mm² of an error field after the best-fitting rigid motion is removed.

    The field is the sum of the expected field, of what a draw of the P parameters and misfit coefficients differs from
    their expected values (`drawn`, shape (P, draws)), and of the actions. `form` (P + 1 + K, P + 1 + K) contains the
    mean products of the P columns, the expected field and the K fields of all amounts of the actions, each with the
    amount 1. `sizes` are the numbers of amounts of the actions, and `largest` the largest amount of each. `beside_mm2`
    is the mean square of the misfit that no mode shows.
    """

    form: Array
    drawn: Array
    sizes: tuple[int, ...]
    largest: tuple[float, ...]
    beside_mm2: float

    @classmethod
    def of(cls, estimate: MachineKnowledge, tool_offset: Array, actions: Sequence[Candidate]) -> _ErrorForms:
        degrees = field_degrees(estimate)
        if any(one.kind is ActionKind.STRAIGHTNESS for one in actions):
            degrees = (
                max(degrees[0], _DEGREE_OF_RAILS),
                max(degrees[1], _DEGREE_OF_RAILS),
                max(degrees[2], _DEGREE_OF_RAILS),
            )
        sums = GridQuadrature.for_points(evaluation_grid(estimate.model.ranges_mm), degrees)
        nodes = sums.nodes
        field = MachineField.at(estimate, nodes, tool_offset)
        fields = [field.expected, *(one.columns(nodes, tool_offset).reshape(nodes.size, -1) for one in actions)]
        roots = np.sqrt(sums.weights / sums.count).repeat(3)[:, None]
        motions = np.linalg.qr(roots * rigid_fields(nodes, nodes.mean(axis=0), _LEVER_MM).reshape(nodes.size, 6))[0]
        columns = roots * np.column_stack((field.columns, *fields))
        shared = motions.T @ columns
        values, vectors = np.linalg.eigh(field.covariance)
        half = np.random.default_rng(_SEED).standard_normal((len(values), _DRAWS // 2))
        drawn = (vectors * np.sqrt(np.maximum(values, 0.0))) @ np.concatenate((half, -half), axis=1)
        beside_mm2 = 3.0 * unresolved_variance(estimate)
        form, sizes = np.asarray(columns.T @ columns - shared.T @ shared), tuple(one.size for one in actions)
        largest = tuple(LARGEST_SHIM_MM if one.kind is ActionKind.STRAIGHTNESS else np.inf for one in actions)
        return cls(form, np.asarray(drawn), sizes, largest, beside_mm2)

    def amounts(self, chosen: Sequence[int]) -> tuple[Array, Array]:
        """Return the amounts (k,) of the `chosen` actions that leave the smallest expected mean square, and their
        expanded uncertainties (k,)."""
        found, deviations = self._fitted(chosen)
        return found, np.asarray(_COVERAGE_FACTOR * deviations.std(axis=1))

    def are_certain(self, chosen: Sequence[int]) -> bool:
        """Return True if, of each action, the amounts together and one of them alone exceed their uncertainty, and none
        is larger than an action can be."""
        found, deviations = self._fitted(chosen)
        start = 0
        for number in chosen:
            own = slice(start, start + self.sizes[number])
            start = own.stop
            covariance = deviations[own] @ deviations[own].T / deviations.shape[1]
            square = float(found[own] @ np.linalg.pinv(covariance, hermitian=True) @ found[own])
            larger = np.abs(found[own]) > _COVERAGE_FACTOR * np.sqrt(np.diagonal(covariance))
            if np.ptp(np.append(found[own], 0.0)) > self.largest[number]:
                return False
            if not larger.any() or square <= float(chdtri(float(self.sizes[number]), _DOUBTED)):
                return False
        return True

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

    def _fitted(self, chosen: Sequence[int]) -> tuple[Array, Array]:
        """Return the best amounts (k,) of the chosen actions, and their deviations (k, draws) in the draws."""
        fit, size = self._fit(chosen), len(self.drawn)
        return -fit[:, size], np.asarray(fit[:, :size] @ self.drawn)

    def _fit(self, chosen: Sequence[int]) -> Array:
        """Return the amounts (k, P + 1 + K) of the chosen fields of which each field contains most."""
        rows = self._rows(chosen)
        return np.asarray(np.linalg.solve(self.form[np.ix_(rows, rows)], self.form[rows]))

    def _rows(self, chosen: Sequence[int]) -> list[int]:
        starts = np.concatenate(([0], np.cumsum(self.sizes)))
        first = len(self.drawn) + 1
        return [first + row for number in chosen for row in range(int(starts[number]), int(starts[number + 1]))]
