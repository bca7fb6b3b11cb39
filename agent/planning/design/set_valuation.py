"""Valuation of a position set before it is measured: the expected volumetric error before and after compensation."""

from __future__ import annotations

from collections.abc import Sequence

from agent.files import translated
from agent.planning.job import Job
from agent.planning.planning_options import planning_options
from drivers.errors import ConfigurationError
from twin.artefact.position_set import Position
from twin.design.valuation import Valuation, valuation
from twin.machine.volumetric import evaluation_grid


def valuation_of(job: Job, positions: Sequence[Position]) -> Valuation:
    """Return the valuation of `positions`, which contains the expected volumetric error before and after compensation.

    The valuation assumes that the positions are measured with the rules of `job`, and that the errors of the machine
    are identified from ball centres with the prior of the machine file. Raises ConfigurationError if none of the
    positions is within reach.
    """
    with translated(ConfigurationError, key="procedure.position_set"):
        return valuation(
            job.machine.family,
            job.artefact,
            job.procedure.plan(positions).observations,
            planning_options(job.settings.temperature),
            evaluation_grid(job.machine.model.ranges_mm),
            job.tool_offset_mm,
        )
