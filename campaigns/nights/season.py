"""The season that nights are played in, and what a full calibration of one of its nights would reach."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from agent.planning.case_file import CASE_STUDY, SHIPPED_CONFIGURATION
from agent.planning.job import Job, prepare_job
from agent.results.estimation import find
from agent.results.table_image import image_of
from agent.settings.load import load_settings
from drivers.roles import TableImage
from simulators.scenario import AgeingSettings, Scenario, read_scenario
from simulators.world.ageing import scenario_of_night
from simulators.world.world import World
from twin.arrays import Array
from twin.artefact.observations import Observations
from twin.artefact.position_set import mount_pose
from twin.identification import Options

DRAWS = 2
BANK = 1

COLLISION = {"B0Z": 12.0, "EAZ": 4.0, "EYX": 3.0}
"""µrad, µrad, µm: the column was hit, most of all it leans."""


@dataclass(frozen=True)
class Season:
    """So many nights, the collision before the slot of night `step`."""

    nights: int = 30
    step: int = 17
    seed: int = 1

    @property
    def scenario(self) -> Scenario:
        """Scales of a season of three months, a slow walk of everything, and the collision."""
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
        """Where the day shift has put the artefact: the next station every day."""
        return 1 + night % len(self.scenario.settings.stations_mm)


def case(state: Path) -> Job:
    """The shipped case study with its runs under `state`."""
    settings = load_settings(CASE_STUDY).model_copy(update={"state_directory": state})
    return prepare_job(settings, SHIPPED_CONFIGURATION)


def reach_um(season: Season, night: int) -> float:
    """True VCE, aligned, of full calibrations of that night's machine."""
    job = case(Path("unused"))
    world = World(scenario_of_night(season.scenario, night))
    reached = []
    for number in range(DRAWS):
        observations = found_exactly(world, job, np.random.default_rng([season.seed, night, number]))
        settings = job.settings
        order = settings.identification.order
        finding = find(job.machine, job.artefact, settings.tool, observations, Options(), settings.table, order)
        reached.append(with_table(world, image_of(finding.table, world.controller.store_limits)))
    return float(np.mean(reached))


def with_table(world: World, image: TableImage) -> float:
    """True VCE, aligned, with a table in the place of the one that acts; the world is of no further use."""
    if world.controller.active_bank == BANK:
        world.controller.activate(0)
    world.controller.write_bank(BANK, image)
    return world.truth.true_volumetric_error(BANK)[1]


def found_exactly(world: World, job: Job, rng: np.random.Generator) -> Observations:
    """Ball centres of the whole set as the bare machine would find them, each with the noise of its touches."""
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
    """(m, 3) of one position, the mount somewhere near its place."""
    settings = world.scenario.settings
    position = job.procedure.plan(job.positions).positions[k]
    place = np.array(settings.stations_mm[position.station - 1])
    place = place + settings.mount_behaviour.place_error_mm * rng.uniform(-1.0, 1.0, 3)
    elevation = math.radians(position.elevation_deg)
    pose = mount_pose(place, settings.mount, math.radians(position.azimuth_deg), elevation)
    balls = world.workpiece.artefact.at(settings.temperatures.artefact_c, elevation)
    return np.asarray(pose.apply(balls)[planned.ball[planned.position == k]])
