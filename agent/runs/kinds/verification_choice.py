"""Choice of the positions of a verification: the fewest that find a step of any squareness of the size stated in the
settings.

They can be chosen before the machine moves, because the power to find a step depends only on the covariance of the
prior.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from agent.runs.kinds.night_plan import NightPlan
from agent.runs.kinds.position_choice import PositionChooser
from twin.arrays import Array
from twin.artefact.position_set import Position
from twin.identification import CarriedOverPrior
from twin.identification.jump import coefficients_of
from twin.machine.error_model import SQUARENESS, ErrorModel
from twin.machine.forward_model import deviation_basis
from twin.machine.volumetric import evaluation_grid
from twin.monitoring.step_power import SmallestStep, StepPower, largest_of

_EFFECT_GRID = (5, 4, 4)


@dataclass(frozen=True, eq=False)
class VerificationChoice:
    """Positions of a verification with the artefact at `station`, in the order in which they were chosen.

    `steps` contains the smallest step of each error that is found with a probability of 95 %, if an error is reported
    from the evidence `evidence` on.
    """

    station: int
    positions: tuple[Position, ...]
    evidence: float
    steps: tuple[SmallestStep, ...]

    @property
    def plan(self) -> NightPlan:
        """Plan of a run that measures these positions. None of them enters an estimate, so none is held out of it."""
        return NightPlan(self.station, (), self.positions)

    @property
    def worst_squareness(self) -> SmallestStep | None:
        """Step of the squareness that is found worst; None if no squareness of the machine can change."""
        found = [step for step in self.steps if step.error in SQUARENESS]
        return largest_of(found) if found else None

    def worst_found(self, measured: StepPower) -> SmallestStep | None:
        """Return the step of the squareness that is found worst by what was `measured`, which is less than planned if
        balls or positions were left out; None if no squareness of the machine can change."""
        found = [measured.smallest(step.error, self.evidence) for step in self.steps if step.error in SQUARENESS]
        return largest_of(found) if found else None


@dataclass(frozen=True, eq=False)
class VerificationChooser:
    """Choice of the positions of a verification.

    `prior` is the estimate of the last accepted night with the drift since then. A verification raises a false alarm
    with the probability `false_alarm` at most.
    """

    chooser: PositionChooser
    prior: CarriedOverPrior
    false_alarm: float
    _powers: dict[tuple[Position, ...], StepPower] = field(default_factory=dict, init=False, repr=False)
    _evidences: dict[tuple[Position, ...], float] = field(default_factory=dict, init=False, repr=False)
    _ranked: dict[tuple[tuple[str, ...], float], tuple[Position, ...]] = field(
        default_factory=dict, init=False, repr=False
    )

    @classmethod
    def of(cls, chooser: PositionChooser, prior: CarriedOverPrior) -> VerificationChooser:
        """Return the choice with the false alarms that the settings of the job allow."""
        return cls(chooser, prior, chooser.job.settings.nightly.verify_false_alarm)

    def choice(self) -> VerificationChoice:
        """Return the positions that `volcal verify` measures: the fewest that find the step stated in the settings of
        any squareness. If all positions at the station do not find it, or if no squareness can change, they are as many
        as the settings state for the beginning of a night."""
        fewest = self.fewest(SQUARENESS, self.chooser.job.settings.nightly.verify_step_urad)
        return self.usual() if fewest is None else fewest

    def usual(self) -> VerificationChoice:
        """Return as many positions as the settings state for the beginning of a night, those that find a step of a
        squareness fastest or, if no squareness can change, a jump of any error."""
        chosen = self.chooser.job.settings.nightly
        count = chosen.held_out_positions + chosen.check_positions
        ranked = self.ranked(SQUARENESS, chosen.verify_step_urad) or self.chooser.detecting_jumps(self.prior, count, ())
        return self.found(ranked[:count])

    def fewest(self, errors: Sequence[str], size: float) -> VerificationChoice | None:
        """Return the fewest positions that find a step of `size` in µm or µrad of each of `errors`, chosen one by one
        by power per minute; None if all positions at the station do not find it, or if none of the errors can
        change."""
        sought, ranked = self._sought(errors), self.ranked(errors, size)
        for count in range(1, len(ranked) + 1):
            if self.power(ranked[:count]).finds(sought, size, self.false_alarm):
                return self.found(ranked[:count])
        return None

    def ranked(self, errors: Sequence[str], size: float) -> tuple[Position, ...]:
        """Return the positions at the station in the order in which they find a step of `size` in µm or µrad of each of
        `errors` fastest."""
        asked = self._sought(errors), size
        if asked not in self._ranked:
            steps = dict.fromkeys(*asked)
            self._ranked[asked] = self.chooser.finding_steps(self.prior, steps) if steps else ()
        return self._ranked[asked]

    def found(self, positions: tuple[Position, ...]) -> VerificationChoice:
        """Return what a verification finds that measures `positions`."""
        evidence = self.evidence(positions)
        return VerificationChoice(self.chooser.station, positions, evidence, self.steps(positions, evidence))

    def steps(self, positions: tuple[Position, ...], evidence: float) -> tuple[SmallestStep, ...]:
        """Return the smallest step of each error that `positions` find, if an error is reported from `evidence` on."""
        found = self.power(positions).smallest_of_each(evidence)
        return tuple(one for one in found if one.error not in self.no_effect)

    def power(self, positions: tuple[Position, ...]) -> StepPower:
        if positions not in self._powers:
            self._powers[positions] = self.chooser.step_power(self.prior, positions)
        return self._powers[positions]

    def evidence(self, positions: tuple[Position, ...]) -> float:
        """Return the limit of the evidence with which `positions` raise no more false alarms than allowed."""
        if positions not in self._evidences:
            self._evidences[positions] = self.power(positions).evidence_for(self.false_alarm)
        return self._evidences[positions]

    @cached_property
    def no_effect(self) -> tuple[str, ...]:
        """Errors that move the tool nowhere; a verification cannot find them."""
        return errors_without_effect(self.prior.unknowns.model, self.chooser.job.tool_offset_mm)

    def _sought(self, errors: Sequence[str]) -> tuple[str, ...]:
        """Return those of `errors` that can change and that move the tool."""
        unknowns = self.prior.unknowns
        return tuple(e for e in errors if e not in self.no_effect and coefficients_of(unknowns, e).size)


def errors_without_effect(model: ErrorModel, tool_offset_mm: Array) -> tuple[str, ...]:
    """Return the errors that move the tool nowhere, such as a rotation about the axis of the only lever arm.

    `tool_offset_mm` (3,) leads from the reference point of the machine to the tip.
    """
    effect = np.abs(deviation_basis(model, evaluation_grid(model.ranges_mm, _EFFECT_GRID), tool_offset_mm))
    moved = effect.reshape(-1, model.size).max(axis=0)
    errors = {parameter.error for parameter, one in zip(model.parameters, moved, strict=True) if one > 0.0}
    return tuple(one for one in dict.fromkeys(p.error for p in model.parameters) if one not in errors)
