"""Comparison of the artefact with its mirror image, for a set of measurements that contradict the certificate.

A bar whose balls stand a few micrometres off a line differs from its mirror image by less than the errors of the
machine. A rigid fit of each position (`measured_shape`) cannot tell one from the other, but all positions together can.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from twin.artefact.artefact import Artefact
from twin.artefact.certificate import CERTIFIED_MM, UNCERTIFIED_MM
from twin.artefact.observations import Observations
from twin.errors import DataError, SingularSet
from twin.identification.checks.certificate_check import worst_ball
from twin.identification.options import Options
from twin.identification.problem import IdentificationProblem
from twin.identification.roll import build_measured_problem
from twin.identification.solution import log_evidence_and_scales, solve
from twin.machine.machine_population import Family

_DECISIVE = 10.0  # ln of the Bayes factor: odds of 22,000 to 1
_OCCAM_OF_A_BALL = 3.0 * math.log(UNCERTIFIED_MM / CERTIFIED_MM)  # at least: most certificates are better


def refuse_mirrored(
    given: IdentificationProblem,
    free: Sequence[int],
    family: Family,
    observations: Observations,
    artefact: Artefact,
    options: Options,
) -> None:
    """Raise DataError if the mirror image of `artefact` explains the observations far better than the artefact itself.

    `given` is the problem of the same observations with the artefact itself, in which the centres of the balls `free`
    are free. No ball may contradict the mirror image: a wrong ball is wrong in both. A carried-over artefact is not
    compared, since its mirror image would not be that of the earlier estimate.
    """
    if options.carried_over is not None:
        return
    mirrored = build_measured_problem(family, observations, _mirror_image(artefact), options)
    try:
        solution = solve(mirrored, options, "centres")
    except SingularSet:  # so far from what was measured that the equations do not converge
        return
    if worst_ball(mirrored.unknowns, solution.z, solution.covariance, ()) is not None:
        return
    better = log_evidence_and_scales(mirrored, options, solution.scales)[0] - log_evidence_and_scales(given, options)[0]
    # the evidence of a problem with free balls leaves out their wide prior
    better += len(free) * _OCCAM_OF_A_BALL
    if better > _DECISIVE:
        raise DataError(
            "the balls are a mirror image of the artefact: with one axis mirrored they agree with its certificate, as "
            "given they contradict it",
            hint="one axis has the wrong sign or counts from its other end; or the certificate is left-handed",
        )


def _mirror_image(artefact: Artefact) -> Artefact:
    """Return the artefact with the Z axis of its frame reversed."""
    signs = np.array([1.0, 1.0, -1.0])
    every = np.tile(signs, artefact.count)
    return replace(
        artefact, balls=artefact.balls * signs, covariance=artefact.covariance * np.multiply.outer(every, every)
    )
