"""Conversion of measured balls into observations of the bare machine, that is, of the machine without compensation."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

from agent.planning.job import Job
from agent.probing.measured_balls import MeasuredBall, no_correction, observations_of, position_numbers
from agent.probing.run_plan import MeasuredPositions
from agent.thermal.machine_drift import is_drifting
from twin.arrays import Array
from twin.artefact.artefact import Artefact
from twin.artefact.held_out_check import HeldOutCovariance, HeldOutResiduals, held_out_covariance, held_out_residuals
from twin.artefact.observations import Observations
from twin.errors import PositionError
from twin.identification import shared_with_artefact
from twin.identification.unknowns import Unknowns


def balls_for_estimate(job: Job, measured: MeasuredPositions) -> list[MeasuredBall]:
    """Return the measured balls for the estimate. These are all balls except those of held-out positions, which serve
    only for the proof of the table.

    The first ball of each position is measured again at the end of the position. If the machine drifted, these repeated
    measurements are included.
    """
    balls = job.balls_of(measured, held_out=False)
    drifting = is_drifting(job.settings.temperature, [ball.conditions for ball in balls])
    return job.balls_of(measured, held_out=False, again=True) if drifting else balls


def displayed_residuals(balls: Sequence[MeasuredBall], tool_offset_mm: Array, artefact: Artefact) -> HeldOutResiduals:
    """Return the residuals of the artefact's balls at displayed axis positions, to which the corrections of the active
    table are not added. The residuals contain the effect of the table that was active during the measurement."""
    displayed = observations_of(balls, tool_offset_mm, no_correction)
    return held_out_residuals(displayed, displayed.axis_positions + tool_offset_mm, artefact)


@dataclass(frozen=True, eq=False)
class ReferenceArtefact:
    """Artefact with whose ball centres held-out positions are compared.

    It is that of the artefact file. If that has no certificate, it is the artefact as an estimate calibrated it; its
    errors are then correlated with those of the machine in the same estimate, `unknowns` with `z_covariance` (P, P).
    """

    artefact: Artefact
    unknowns: Unknowns | None = None
    z_covariance: Array | None = None

    @classmethod
    def of(cls, artefact: Artefact, unknowns: Unknowns, z: Array, z_covariance: Array) -> ReferenceArtefact:
        """Return the reference for the estimate `z` (P,) of `unknowns` with the covariance `z_covariance` (P, P)."""
        calibration = unknowns.artefact_calibration(z, z_covariance)
        if calibration is None or calibration.certified:
            return cls(artefact)
        return cls(calibration.calibrated(artefact, "this run"), unknowns, z_covariance)

    def covariance(
        self, observations: Observations, result: HeldOutResiduals, field_covariance: Array, tool_offset_mm: Array
    ) -> HeldOutCovariance:
        """Return the covariance expected of the residuals `result` of held-out `observations`. `field_covariance` is
        that of `held_out_covariance`."""
        shared = None
        if self.unknowns is not None and self.z_covariance is not None:
            shared = shared_with_artefact(self.unknowns, self.z_covariance, observations.axis_positions, tool_offset_mm)
        return held_out_covariance(observations, result.placed_mm, self.artefact, field_covariance, shared)


def certified_balls(balls: Sequence[MeasuredBall], artefact: Artefact) -> list[MeasuredBall]:
    """Return the balls whose centres are certified. The others cannot prove a table."""
    return [ball for ball in balls if ball.ball not in artefact.uncertified]


@contextmanager
def positions_named(balls: Sequence[MeasuredBall]) -> Iterator[None]:
    """Name the position of an error raised in the `with` block, which concerns the observations of `balls`, by its
    number in the run."""
    try:
        yield
    except PositionError as error:
        error.where.pop("row", None)
        raise error.renumbered(position_numbers(balls)[error.position]) from None
