"""Measuring variants that differ from the settings in the procedure or the equipment.

A variant may differ in the number of touches per ball, the number of balls, the share of them that is measured, the
tilt of the ball holders, or the tools.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

from agent.files import translated
from agent.planning.design.bar_variants import Bar
from agent.planning.job import Job
from agent.planning.job_preparation import prepare_job
from drivers.errors import ConfigurationError
from twin.artefact.artefact import Artefact

BALL_SHARES = (1.0, 0.55, 0.45)
"""Shares of the balls within reach among which a design chooses."""


@dataclass(frozen=True, eq=False)
class Variant:
    """Measuring variant.

    `jobs` maps the name of each tool to the job with that tool. `touches` is the number of touches per ball, and
    `balls` the number of balls. `made_up` is True if an uncalibrated bar with nominal ball centres replaces the
    artefact of the settings. `theta_deg` is the tilt of the ball holders of the nominal bar in degrees; it is None if
    `made_up` is False. `ball_share` is the share of the balls within reach that is measured in each position.
    """

    touches: int
    balls: int
    theta_deg: float | None
    jobs: Mapping[str, Job]
    made_up: bool
    ball_share: float = 1.0


def variants_of(
    job: Job,
    base: Path,
    *,
    tools: Sequence[str] = (),
    touches: Sequence[int] = (),
    balls: Sequence[int] = (),
    thetas_deg: Sequence[float] = (),
    ball_shares: Sequence[float] = (1.0,),
) -> list[Variant]:
    """Return the measuring variants for all combinations of the given tools, touches per ball, numbers of balls and
    tilts of the ball holders, and shares of the balls that are measured in each position.

    If a choice is omitted, the value of `job` is used. Raises ConfigurationError if a tool is unknown, or if the balls
    or the tilt of the artefact cannot be changed.
    """
    made_up = bool(balls or thetas_deg)
    with translated(ConfigurationError, file=str(job.settings.artefact)):
        bar = Bar.of(job.artefact) if made_up else None
    tilts: list[float | None] = [*thetas_deg] or [None if bar is None else bar.tilt_deg]
    found = []
    for count, number, theta in product(
        touches or [job.settings.procedure.touches_per_ball], balls or [job.artefact.count], tilts
    ):
        with translated(ConfigurationError, key="--touches, --balls or --theta-deg"):
            artefact = job.artefact if bar is None else bar.with_(number, theta)
            jobs = {tool: _job(job, base, tool, count, artefact) for tool in tools or [job.settings.tool]}
        found += [Variant(count, number, theta, jobs, made_up, share) for share in ball_shares]
    return found


def _job(job: Job, base: Path, tool: str, touches: int, artefact: Artefact) -> Job:
    if tool not in job.machine.tools:
        raise ConfigurationError(
            f"the machine has no tool {tool!r}",
            key="--tool",
            hint=f"tools of {job.machine.name}: {', '.join(sorted(job.machine.tools))}",
        )
    chosen = job.settings.procedure
    if (tool, touches, artefact) == (job.settings.tool, chosen.touches_per_ball, job.artefact):
        return job
    procedure = chosen.model_copy(update={"touches_per_ball": touches})
    own = prepare_job(job.settings.model_copy(update={"procedure": procedure, "tool": tool}), base)
    preparation = replace(own.preparation, layout=replace(own.preparation.layout, artefact=artefact))
    return replace(
        own,
        artefact=artefact,
        layout=replace(own.layout, artefact=artefact),
        preparation=preparation,
        latencies_from=job.latencies_from,
        stated_timing=job.stated_timing,
    )
