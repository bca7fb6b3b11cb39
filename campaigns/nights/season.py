"""Definition of a season, and the error that a full calibration would leave in each of its nights.

A season is a sequence of nights in which the errors of one machine change.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from agent.planning.case_file import CASE_STUDY, SHIPPED_CONFIGURATION
from agent.planning.job import Job
from agent.planning.job_preparation import prepare_job
from agent.results.estimation import estimate_machine, table_grid
from agent.results.table_image import image_of
from agent.settings.load import load_settings
from drivers.roles import TableImage
from simulators.scenario import AgeingSettings, Scenario, read_scenario
from simulators.world.ageing import scenario_of_night
from simulators.world.world import World
from twin.arrays import Array
from twin.artefact.observations import Observations
from twin.artefact.position_set import mount_pose
from twin.compensation.table import CompensationTable, build_table
from twin.identification import Options

DRAWS = 2
BANK = 1

COLLISION = {"B0Z": 12.0, "EAZ": 4.0, "EYX": 3.0}
"""Jumps of three errors in the collision, in µrad, µrad and µm. They represent a blow that mainly tilts the column."""


@dataclass(frozen=True)
class Season:
    """Sequence of `nights` nights after a first full calibration, in which the errors of one machine change.

    The machine has a collision before the run of night `step`.
    """

    nights: int = 30
    step: int = 17
    seed: int = 1

    @property
    def scenario(self) -> Scenario:
        """Simulated scenario of the season, in which the machine's errors change from night to night.

        The scale errors vary with a period of three months, all errors follow a slow random walk, and there is one
        collision.
        """
        shipped = read_scenario(SHIPPED_CONFIGURATION / "simulators" / "case-study.toml")
        ageing = AgeingSettings(
            seed=self.seed,
            seasonal_um_per_m=(6.0, 5.0, -5.0),
            season_nights=90.0,
            phases_deg=(0.0, 40.0, 20.0),
            walk_um=0.15,
            collision_night=self.step,
            collision=COLLISION,
        )
        return replace(shipped, settings=shipped.settings.model_copy(update={"ageing": ageing, "seed": self.seed}))

    def station(self, night: int) -> int:
        """Return the number of the station at which the artefact stands in `night`.

        The day shift moves the artefact to the next station every day.
        """
        return 1 + night % len(self.scenario.settings.stations_mm)


def load_season_case(state: Path) -> Job:
    """Return the job of the shipped case study, with `state` as its state directory."""
    settings = load_settings(CASE_STUDY).model_copy(update={"state_directory": state})
    return prepare_job(settings, SHIPPED_CONFIGURATION)


def full_calibration_vce_um(season: Season, night: int) -> float:
    """Return the mean true volumetric error after compensation (VCE), in µm, that full calibrations of the machine as
    it is in `night` would leave.

    The mean is taken over several simulated measurements (their number is `DRAWS`). The best-fitting rigid motion is
    removed from the error.
    """
    job = load_season_case(Path("unused"))
    world = World(scenario_of_night(season.scenario, night))
    reached = []
    for number in range(DRAWS):
        observations = simulated_observations(world, job, np.random.default_rng([season.seed, night, number]))
        table = calibrated_table(job, observations, Options())
        reached.append(true_vce_with_table(world, image_of(table, world.controller.store_limits)))
    return float(np.mean(reached))


def calibrated_table(job: Job, observations: Observations, options: Options) -> CompensationTable:
    """Return the compensation table of `estimate_for_job`, without its limits and figures, which take as long again."""
    settings = job.settings
    estimate = estimate_machine(job.machine, job.artefact, observations, options, settings.identification.order)
    nodes, anchor = table_grid(estimate.model, settings.table)
    return build_table(
        estimate.model, estimate.parameters, nodes, job.tool_offset_mm, anchor, observations.axis_positions
    )


def true_vce_with_table(world: World, image: TableImage) -> float:
    """Return the true volumetric error after compensation (VCE), in µm, with the table `image`, which replaces the
    active table.

    The best-fitting rigid motion is removed from the error. The function changes the simulation `world`, which must not
    be used afterwards.
    """
    if world.controller.active_bank == BANK:
        world.controller.activate(0)
    world.controller.write_bank(BANK, image)
    return world.truth.true_volumetric_error(BANK)[1]


def simulated_observations(world: World, job: Job, rng: np.random.Generator) -> Observations:
    """Return simulated measurements of the ball centres of the artefact in all positions of the position set, with
    touch noise.

    The ball centres are measured as the machine without a compensation table would measure them.
    """
    planned = job.procedure.plan(job.positions).observations
    settings = world.scenario.settings
    centres = np.concatenate([_true_balls(world, job, k, planned, rng) for k in np.unique(planned.position)], axis=0)
    touch = settings.trigger.touch_sigma_um / (1e3 * job.rules.probing.touch_sigma_mm)
    factor = touch * np.linalg.cholesky(job.procedure.covariance_mm2)
    wanted = centres - job.tool_offset_mm
    at = wanted.copy()
    for _ in range(3):
        at = wanted - world.truth.machine.deviation(at)
    return replace(
        planned,
        axis_positions=at + rng.standard_normal(at.shape) @ factor.T,
        temperature_c=np.full(planned.size, settings.temperatures.artefact_c),
    )


def _true_balls(world: World, job: Job, k: int, planned: Observations, rng: np.random.Generator) -> Array:
    """Return the true ball centres (m, 3) of one position, with a random placement of the mount."""
    settings = world.scenario.settings
    position = job.procedure.plan(job.positions).positions[k]
    place = np.array(settings.stations_mm[position.station - 1])
    place = place + settings.mount_behaviour.place_error_mm * rng.uniform(-1.0, 1.0, 3)
    elevation = math.radians(position.elevation_deg)
    pose = mount_pose(place, settings.mount, math.radians(position.azimuth_deg), elevation)
    balls = world.workpiece.artefact.at(settings.temperatures.artefact_c, elevation)
    return np.asarray(pose.apply(balls)[planned.ball[planned.position == k]])
