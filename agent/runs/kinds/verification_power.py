"""Smallest sudden changes (steps) of machine errors that a verification finds, and its machine time. They are computed
before anything moves, because they depend only on the covariance of the prior.

The prior is the estimate of the last accepted night or, before there is one, the planned calibration, and the drift of
one night.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field

import numpy as np

from agent.execution.steps import Plan
from agent.planning.cycle_time import plan_minutes
from agent.planning.job import Job
from agent.probing.run_plan import MeasuredPositions, measure_positions, position_key
from agent.runs.change_since_reference import night_noise
from agent.runs.kinds.drift_check import Judge
from agent.runs.kinds.night_plan import VERIFICATION, NightPlan, job_at_station, station_of, verification_plan
from agent.runs.kinds.position_choice import PositionChooser
from agent.runs.reference_state import ReferenceState, reference_for
from twin.arrays import Array
from twin.artefact.position_set import Position
from twin.identification import CarriedOverPrior
from twin.identification.scales import Scales
from twin.machine.error_model import SQUARENESS, ErrorModel
from twin.machine.forward_model import deviation_basis
from twin.machine.volumetric import evaluation_grid
from twin.monitoring.step_power import FALSE_ALARM, POWER, ROTATIONS, SmallestStep, StepPower

SOUGHT_URAD = 10.0
"""Step in µrad of a squareness or rotation for which the fewest positions are sought."""

_NIGHTS = 1.0
_MORE = 3  # positions beyond those of the settings that are also considered
_EFFECT_GRID = (5, 4, 4)


@dataclass(frozen=True)
class FoundSteps:
    """Smallest steps that the measurement of `positions` finds with a probability of 95 % and 1 % false alarms.

    `machine_minutes` is the time of the verification, with the checks of the probe before it. `evidence` is the limit
    of the evidence with which 1 % is the bound of the false alarms of a verification. `steps` contains one step for
    each error.
    """

    positions: tuple[Position, ...]
    machine_minutes: float
    evidence: float
    steps: tuple[SmallestStep, ...]

    def as_json(self) -> dict[str, object]:
        """Return the steps as a JSON object."""
        return {
            "positions": [position_key(position) for position in self.positions],
            "machine_minutes": round(self.machine_minutes, 3),
            "step_evidence": round(self.evidence, 3),
            "steps": [asdict(step) for step in self.steps],
        }


@dataclass(frozen=True)
class VerificationPower:
    """Steps that a verification at `station` finds one night after the run `since`, or after the planned calibration if
    `since` is empty.

    `planned` are the steps found by the positions that `volcal verify` measures, and `as_set` the smallest steps that
    these positions find with the limit `set_evidence` of the settings, whose false alarms have the bound
    `set_false_alarm`. `by_positions` are the steps found by fewer and by more positions, in the order in which they
    are chosen. `fewest_squareness` and `fewest_angles` are the fewest positions that find 10 µrad of any squareness,
    and of any squareness or rotation; None if all positions at the station do not find it. The errors `no_effect` do
    not move the tool and are left out.
    """

    station: int
    since: str
    planned: FoundSteps
    set_evidence: float
    set_false_alarm: float
    as_set: tuple[SmallestStep, ...]
    by_positions: tuple[FoundSteps, ...]
    fewest_squareness: FoundSteps | None
    fewest_angles: FoundSteps | None
    no_effect: tuple[str, ...]

    def as_json(self) -> dict[str, object]:
        """Return the power as a JSON object."""
        fewest = {"squareness": self.fewest_squareness, "squareness_or_rotation": self.fewest_angles}
        return {
            "station": self.station,
            "since": self.since or None,
            "power": POWER,
            "false_alarm": FALSE_ALARM,
            "planned": self.planned.as_json(),
            "as_set": {
                "step_evidence": self.set_evidence,
                "false_alarm": self.set_false_alarm,
                "steps": [asdict(step) for step in self.as_set],
            },
            "by_positions": [one.as_json() for one in self.by_positions],
            "sought_urad": SOUGHT_URAD,
            "fewest": {name: None if one is None else one.as_json() for name, one in fewest.items()},
            "no_effect": list(self.no_effect),
        }


def verification_power(job: Job, station: int) -> VerificationPower:
    """Return what a verification with the artefact at `station` finds.

    Raises ConfigurationError if there is no such station, or if the artefact is placed by hand.
    """
    chooser = PositionChooser(job_at_station(job, station_of(job, station)), station)
    reference = reference_for(job)
    prior, change = _prior(job, reference)
    study = _PowerStudy(chooser, prior, _errors_without_effect(prior.unknowns.model, job.tool_offset_mm))
    chosen = job.settings.nightly
    plan = verification_plan(chooser, prior, change)
    more = chooser.detecting_jumps(prior, chosen.check_positions + _MORE, plan.held_out)
    counts = range(1, len(more) + 1)
    evidence = chosen.step_evidence
    power = study.power(plan.first)
    return VerificationPower(
        station=station,
        since="" if reference is None else reference.run_id,
        planned=study.found(plan),
        set_evidence=evidence,
        set_false_alarm=power.false_alarm(evidence),
        as_set=study.steps(power, evidence),
        by_positions=tuple(study.found(NightPlan(station, plan.held_out, more[:count])) for count in counts),
        fewest_squareness=study.fewest(SQUARENESS),
        fewest_angles=study.fewest((*SQUARENESS, *ROTATIONS)),
        no_effect=study.no_effect,
    )


@dataclass(frozen=True, eq=False)
class _PowerStudy:
    """Steps that sets of positions find. The errors `no_effect` are left out."""

    chooser: PositionChooser
    prior: CarriedOverPrior
    no_effect: tuple[str, ...]
    _powers: dict[tuple[Position, ...], StepPower] = field(default_factory=dict, init=False, repr=False)

    def power(self, positions: tuple[Position, ...]) -> StepPower:
        if positions not in self._powers:
            self._powers[positions] = self.chooser.step_power(self.prior, positions)
        return self._powers[positions]

    def steps(self, power: StepPower, evidence: float) -> tuple[SmallestStep, ...]:
        return tuple(one for one in power.smallest_of_each(evidence) if one.error not in self.no_effect)

    def found(self, plan: NightPlan) -> FoundSteps:
        power = self.power(plan.first)
        evidence = power.evidence_for(FALSE_ALARM)
        return FoundSteps(plan.first, _minutes(self.chooser.job, plan), evidence, self.steps(power, evidence))

    def fewest(self, errors: Sequence[str]) -> FoundSteps | None:
        """Return the fewest positions that find the sought step of each of `errors`, chosen one by one by power per
        minute."""
        sought = [error for error in errors if error not in self.no_effect]
        ranked = self.chooser.finding_steps(self.prior, dict.fromkeys(sought, SOUGHT_URAD))
        for count in range(1, len(ranked) + 1):
            power = self.power(ranked[:count])
            evidence = power.evidence_for(FALSE_ALARM)
            if all(power.power(error, SOUGHT_URAD, evidence) >= POWER for error in sought):
                return self.found(NightPlan(self.chooser.station, (), ranked[:count]))
        return None


def _prior(job: Job, reference: ReferenceState | None) -> tuple[CarriedOverPrior, Array]:
    """Return the prior of a verification, and the expected squares and products (p, p) of the change of the p
    parameters since the active table was computed."""
    if reference is not None:
        judge = Judge(job, reference, _NIGHTS)
        return judge.prior, judge.expected_change
    seen = job.step_visibility
    covariance = 0.5 * (seen.covariance + seen.covariance.T)
    calibrated = CarriedOverPrior(seen.unknowns, np.zeros(len(covariance)), covariance, Scales())
    prior = calibrated.after(night_noise(job, seen.unknowns.model), _NIGHTS)
    own = seen.unknowns.blocks.parameters
    return prior, prior.covariance[own, own] - calibrated.covariance[own, own]


def _errors_without_effect(model: ErrorModel, tool_offset_mm: Array) -> tuple[str, ...]:
    """Return the errors that move the tool nowhere, such as a rotation about the axis of the only lever arm."""
    effect = np.abs(deviation_basis(model, evaluation_grid(model.ranges_mm, _EFFECT_GRID), tool_offset_mm))
    moved = effect.reshape(-1, model.size).max(axis=0)
    errors = {parameter.error for parameter, one in zip(model.parameters, moved, strict=True) if one > 0.0}
    return tuple(one for one in dict.fromkeys(p.error for p in model.parameters) if one not in errors)


def _minutes(job: Job, plan: NightPlan) -> float:
    own = plan.job(job)
    return plan_minutes(own, _check(own, plan))


def _check(job: Job, plan: NightPlan) -> Plan[MeasuredPositions]:
    prepared = yield from job.preparation_plan()
    order = plan.order(VERIFICATION, plan.first)
    return (yield from measure_positions(order, job.layout, prepared.rules))
