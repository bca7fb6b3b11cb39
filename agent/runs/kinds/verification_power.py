"""Smallest sudden changes (steps) of machine errors that a verification finds, and its machine time. They are computed
before anything moves, because they depend only on the covariance of the prior.

The prior is the estimate of the last accepted night or, before there is one, the planned calibration, and the drift of
one night.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import cache

import numpy as np

from agent.execution.steps import Plan
from agent.planning.cycle_time import plan_minutes
from agent.planning.job import Job
from agent.probing.run_plan import MeasuredPositions, measure_positions, position_key
from agent.runs.change_since_reference import night_noise
from agent.runs.kinds.drift_check import Judge
from agent.runs.kinds.night_plan import VERIFICATION, NightPlan, job_at_station, night_check, station_of
from agent.runs.kinds.position_choice import PositionChooser
from agent.runs.kinds.verification_choice import VerificationChooser
from agent.runs.reference_state import ReferenceState, reference_for
from twin.arrays import Array
from twin.artefact.position_set import Position
from twin.identification import CarriedOverPrior
from twin.identification.scales import Scales
from twin.machine.error_model import SQUARENESS
from twin.monitoring.step_power import POWER, ROTATIONS, SmallestStep

_NIGHTS = 1.0
_MORE = 3  # positions beyond those of `volcal verify` that are also considered


@dataclass(frozen=True)
class FoundSteps:
    """Smallest steps that the measurement of `positions` finds with a probability of 95 %, one for each error.

    `machine_minutes` is the time of the measurement, with the checks of the probe before it. `evidence` is the limit of
    the evidence from which on an error is reported as changed.
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

    `planned` are the steps found by the positions that `volcal verify` measures, `by_positions` those found by fewer
    and by more positions, in the order in which they are chosen; if no squareness can change, they are `planned` alone.
    `fewest_squareness` and `fewest_angles` are the fewest positions that find `sought_urad` of any squareness, and of
    any squareness or rotation; None if all positions at the station do not find it. `night` are the steps that the
    check at the beginning of a night finds with the limit of the settings, whose false alarms have the bound
    `night_false_alarm`. The errors `no_effect` do not move the tool and are left out.
    """

    station: int
    since: str
    false_alarm: float
    sought_urad: float
    planned: FoundSteps
    by_positions: tuple[FoundSteps, ...]
    fewest_squareness: FoundSteps | None
    fewest_angles: FoundSteps | None
    night: FoundSteps
    night_false_alarm: float
    no_effect: tuple[str, ...]

    @property
    def seeks_squareness(self) -> bool:
        """True if a squareness of the machine can change. If none can, a verification looks for a jump of any error."""
        return any(step.error in SQUARENESS for step in self.planned.steps)

    def as_json(self) -> dict[str, object]:
        """Return the power as a JSON object."""
        fewest = {"squareness": self.fewest_squareness, "squareness_or_rotation": self.fewest_angles}
        return {
            "station": self.station,
            "since": self.since or None,
            "power": POWER,
            "false_alarm": self.false_alarm,
            "planned": self.planned.as_json(),
            "by_positions": [one.as_json() for one in self.by_positions],
            "sought_urad": self.sought_urad,
            "fewest": {name: None if one is None else one.as_json() for name, one in fewest.items()},
            "night": {**self.night.as_json(), "false_alarm": self.night_false_alarm},
            "no_effect": list(self.no_effect),
        }


def verification_power(job: Job, station: int) -> VerificationPower:
    """Return what a verification with the artefact at `station` finds.

    Raises ConfigurationError if there is no such station, or if the artefact is placed by hand.
    """
    chooser = PositionChooser(job_at_station(job, station_of(job, station)), station)
    reference = reference_for(job)
    prior, change = _prior(job, reference)
    verification = VerificationChooser.of(chooser, prior)
    settings = job.settings.nightly
    sought = settings.verify_step_urad
    planned = verification.choice()
    more = verification.ranked(SQUARENESS, sought)[: len(planned.positions) + _MORE]
    check = night_check(chooser, prior, change)

    @cache
    def found(positions: tuple[Position, ...]) -> FoundSteps:
        choice = verification.found(positions)
        return FoundSteps(positions, _minutes(chooser.job, choice.plan), choice.evidence, choice.steps)

    def fewest(errors: Sequence[str]) -> FoundSteps | None:
        choice = verification.fewest(errors, sought)
        return None if choice is None else found(choice.positions)

    evidence = settings.step_evidence
    return VerificationPower(
        station=station,
        since="" if reference is None else reference.run_id,
        false_alarm=verification.false_alarm,
        sought_urad=sought,
        planned=found(planned.positions),
        by_positions=tuple(found(more[:count]) for count in range(1, len(more) + 1)) or (found(planned.positions),),
        fewest_squareness=fewest(SQUARENESS),
        fewest_angles=fewest((*SQUARENESS, *ROTATIONS)),
        night=FoundSteps(
            check.first, _minutes(chooser.job, check), evidence, verification.steps(check.first, evidence)
        ),
        night_false_alarm=verification.power(check.first).false_alarm(evidence),
        no_effect=verification.no_effect,
    )


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


def _minutes(job: Job, plan: NightPlan) -> float:
    own = plan.job(job)
    return plan_minutes(own, _check(own, plan))


def _check(job: Job, plan: NightPlan) -> Plan[MeasuredPositions]:
    prepared = yield from job.preparation_plan()
    order = plan.order(VERIFICATION, plan.first)
    return (yield from measure_positions(order, job.layout, prepared.rules))
