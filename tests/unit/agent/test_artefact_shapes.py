"""Bars, plates and frames: planned, measured on the simulated machine without a collision, and identified."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pytest

from agent.execution.engine import Engine
from agent.planning.job import Job
from agent.planning.job_preparation import prepare_job
from agent.probing.run_plan import MeasuringOrder, measure_positions
from agent.results.estimation import estimate_from_balls
from agent.results.observations import no_correction
from agent.settings.schema import Settings
from campaigns.nights.play import build_rig
from campaigns.plans.judge import CollisionJudge
from campaigns.plans.moving import AlarmClock
from simulators.scenario import ScenarioDocument, build_scenario
from simulators.world.world import World
from twin.artefact.mount_geometry import MountGeometry
from twin.artefact.pose_alignment import align_to_end_balls, align_to_third_ball, choose_alignment_balls
from twin.artefact.position_set import Position, mount_pose

CONFIG = Path(__file__).resolve().parents[3] / "config"


def case(artefact: str) -> tuple[Job, World]:
    """The case study with another artefact, which stands 0.4 mm from its nominal place."""
    settings = tomllib.loads((CONFIG / "case-study.toml").read_text())
    settings |= {"artefact": f"artefacts/{artefact}.toml", "identification": {"order": 1}}
    settings["procedure"]["stations"] = [1]
    document = tomllib.loads((CONFIG / "simulators" / "case-study.toml").read_text())
    document["artefact"] = f"../artefacts/{artefact}.toml"
    document["mount_behaviour"] = {"place_error_mm": 0.4, "place_error_deg": 0.02, "index_error_deg": 0.005}
    scenario = build_scenario(ScenarioDocument.model_validate(document), CONFIG / "simulators")
    return prepare_job(Settings.model_validate(settings).resolved(CONFIG), CONFIG), World(scenario)


@pytest.mark.parametrize(
    ("artefact", "angles", "balls", "third"),
    [
        ("straight-bar-1500", (-30.0, 45.0), [11, 11], False),
        ("ball-plate-420", (90.0, 0.0), [16, 4], True),  # edge-on: only its front column, a line, is within reach
        ("ball-tetrahedron-600", (-30.0, 45.0), [9, 9], True),
    ],
)
def test_every_artefact_is_measured_without_a_collision(
    artefact: str, angles: tuple[float, float], balls: list[int], third: bool
) -> None:
    positions = (Position(1, 45.0, 0.0), Position(1, *angles))
    job, world = case(artefact)
    clock = AlarmClock()
    judge = CollisionJudge(world, job)
    clock.watch = judge.watch
    rig = build_rig(world, clock, job)
    rig.open()
    order = MeasuringOrder("measure", positions, 1)
    measured = Engine(rig.actions()).run(measure_positions(order, job.layout, job.rules))
    assert world.collisions == []
    assert judge.seen().collisions == []
    assert measured.lost == 0
    assert [len(position.balls) for position in measured.positions] == balls
    found = [ball for position in measured.positions for ball in position.balls]
    estimation = estimate_from_balls(job, found, no_correction)
    assert estimation.estimate.chi2_normalised < 2.0
    assert not estimation.estimate.rejected
    nominal = job.layout.nominal(positions[0])
    chosen = choose_alignment_balls(nominal, measured.positions[0].ball_numbers)
    assert (chosen.third is not None) is third


def test_three_balls_determine_the_pose_of_a_plate_and_two_that_of_a_bar() -> None:
    plate = np.array([[x, -80.0, z] for z in (-210.0, 0.0, 210.0) for x in (-210.0, 0.0, 210.0)])
    chosen = choose_alignment_balls(plate + 0.05 * np.sin(np.arange(27.0)).reshape(9, 3), range(9))
    assert (chosen.ends, chosen.third) == ((0, 8), 2)
    edge = choose_alignment_balls(plate, (0, 3, 6))
    assert (edge.ends, edge.third) == ((0, 6), None)
    found = mount_pose(np.array([9.0, -4.0, 6.0]), MountGeometry(), 0.1, -0.15).apply(plate)
    by_two = align_to_end_balls(plate, 0, 8, found[0], found[8])
    assert by_two[[0, 8]] == pytest.approx(found[[0, 8]])
    assert np.abs(by_two - found).max() > 10.0
    assert align_to_third_ball(by_two, 0, 8, 2, found[2]) == pytest.approx(found)
