"""Other ways to measure than the settings': touches a ball, number of balls, tilt of the holders, tools."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np

from agent.job import Job, prepare_job
from drivers.errors import ConfigurationError
from twin.artefact import Artefact, ball_bar


@dataclass(frozen=True, eq=False)
class Variant:
    """`jobs`: tool → job. `made_up`: the artefact is none that the settings name."""

    touches: int
    balls: int
    theta_deg: float
    jobs: Mapping[str, Job]
    made_up: bool


def variants_of(
    job: Job,
    base: Path,
    *,
    tools: Sequence[str] = (),
    touches: Sequence[int] = (),
    balls: Sequence[int] = (),
    thetas_deg: Sequence[float] = (),
) -> list[Variant]:
    """Every combination; what is not given stays as the job has it. Raises ConfigurationError for an unknown tool."""
    made_up = bool(balls or thetas_deg)
    theta_deg = math.degrees(tilt_of(job.artefact))
    found = []
    for count, number, theta in product(
        touches or [job.settings.procedure.touches_per_ball], balls or [job.artefact.count], thetas_deg or [theta_deg]
    ):
        artefact = bar_like(job.artefact, number, math.radians(theta)) if made_up else job.artefact
        jobs = {tool: _job(job, base, tool, count, artefact) for tool in tools or [job.settings.tool]}
        found.append(Variant(count, number, theta, jobs, made_up))
    return found


def bar_like(artefact: Artefact, balls: int, tilt_rad: float) -> Artefact:
    """A nominal bar of the same length, holders, diameter, expansion and uncertainty with other balls."""
    return ball_bar(
        f"{artefact.name}, {balls} balls, θ {math.degrees(tilt_rad):g}°",
        balls=balls,
        length_mm=2.0 * artefact.half_length_mm,
        tilt_rad=tilt_rad,
        holder_length_mm=artefact.holder_length_mm,
        ball_diameter_mm=artefact.ball_diameter_mm,
        standard_uncertainty_mm=float(np.sqrt(np.mean(np.diagonal(artefact.covariance)))),
        reference_temperature_c=artefact.reference_temperature_c,
        cte_per_k=artefact.cte_per_k,
        cte_standard_uncertainty_per_k=artefact.cte_standard_uncertainty_per_k,
        sag_mm=artefact.sag_mm,
    )


def tilt_of(artefact: Artefact) -> float:
    """Tilt of the holders in rad, from how far the balls stand off to the sides."""
    if artefact.holder_length_mm <= 0.0:
        return 0.0
    return math.asin(min(float(np.abs(artefact.balls[:, 2]).max()) / artefact.holder_length_mm, 1.0))


def _job(job: Job, base: Path, tool: str, touches: int, artefact: Artefact) -> Job:
    if tool not in job.machine.tools:
        raise ConfigurationError(
            f"the machine has no tool {tool!r}",
            key="--tool",
            hint=f"tools of {job.machine.name}: {', '.join(sorted(job.machine.tools))}",
        )
    procedure = job.settings.procedure.model_copy(update={"touches_per_ball": touches})
    own = prepare_job(job.settings.model_copy(update={"procedure": procedure, "tool": tool}), base)
    return replace(own, artefact=artefact, layout=replace(own.layout, artefact=artefact))
