"""Bars, plates and frames: planned, measured on the simulated machine without a collision, and identified."""

from __future__ import annotations

import json
import tomllib
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from agent.cli.main import main
from agent.execution.engine import Engine
from agent.planning.job import Job
from agent.planning.job_preparation import prepare_job
from agent.probing.run_plan import MeasuredPositions, MeasuringOrder, measure_positions
from agent.settings.schema import Settings
from campaigns.nights.play import build_rig
from campaigns.plans.collision_check import CollisionJudge
from campaigns.plans.motion_run import AlarmClock
from simulators.scenario import ScenarioDocument, build_scenario
from simulators.world.world import World
from twin.artefact.mount_geometry import MountGeometry
from twin.artefact.pose_alignment import align_to_end_balls, align_to_third_ball, choose_alignment_balls
from twin.artefact.position_set import Position, mount_pose

CONFIG = Path(__file__).resolve().parents[3] / "config"


def case(artefact: str) -> tuple[Job, World]:
    """The case study with another artefact, which stands 0.4 mm from its nominal place."""
    settings = tomllib.loads((CONFIG / "case-study.toml").read_text())
    settings |= {"artefact": f"artefacts/{artefact}.toml"}
    settings["procedure"]["stations"] = [1]
    document = tomllib.loads((CONFIG / "simulators" / "case-study.toml").read_text())
    document["artefact"] = f"../artefacts/{artefact}.toml"
    document["mount_behaviour"] = {"place_error_mm": 0.4, "place_error_deg": 0.02, "index_error_deg": 0.005}
    scenario = build_scenario(ScenarioDocument.model_validate(document), CONFIG / "simulators")
    return prepare_job(Settings.model_validate(settings).resolved(CONFIG), CONFIG), World(scenario)


def command(*arguments: str) -> dict[str, Any]:
    """What a command prints with --json; the gates may refuse a table (exit code 4)."""
    result = CliRunner().invoke(main, [*arguments, "--json"])
    assert result.exit_code in (0, 4), result.output
    document: dict[str, Any] = json.loads(result.stdout.splitlines()[-1])
    return document


def options(artefact: str, out: Path) -> list[str]:
    return [
        *("--machine", str(CONFIG / "machines" / "case-study.toml")),
        *("--artefact", str(CONFIG / "artefacts" / f"{artefact}.toml")),
        *("--order", "1", "--temperature-uncertainty", "0.1", "--out", str(out / "results")),
    ]


def as_file(measured: MeasuredPositions, *, stated: bool) -> str:
    """The balls as a file; unless the angles are `stated`, as if the artefact had been placed by hand."""
    lines = ["position,station,azimuth_deg,elevation_deg,tool,ball,x_mm,y_mm,z_mm,sigma_um,temperature_c"]
    for ball in (ball for position in measured.positions for ball in position.balls):
        angles = (ball.azimuth_deg, ball.elevation_deg) if stated else (0, 0)
        numbers = ",".join(f"{value:.6f}" for value in ball.found.centre_mm)
        lines.append(f"{ball.position},1,{angles[0]},{angles[1]},probe,{ball.ball},{numbers},1.0,{ball.temperature_c}")
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize(
    ("artefact", "angles", "balls", "third"),
    [
        ("straight-bar-1500", (-30.0, 45.0), [11, 11], False),
        ("ball-plate-420", (90.0, 0.0), [16, 4], True),  # edge-on: only its front column, a line, is within reach
        ("ball-tetrahedron-600", (-30.0, 45.0), [9, 9], True),
    ],
)
def test_every_artefact_is_measured_without_a_collision_and_identified(
    tmp_path: Path, artefact: str, angles: tuple[float, float], balls: list[int], third: bool
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
    path = tmp_path / "balls.csv"
    path.write_text(as_file(measured, stated=not third))
    for formulation in ("centres",) if third else ("centres", "distances"):
        result = command(
            "identify", str(path), *options(artefact, tmp_path), "--formulation", formulation, "--no-report"
        )
        assert result["balls"] == sum(balls)
        assert result["chi2_normalised"] < 2.0
        assert result["rejected"] == []
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


def test_a_straight_bar_is_ranked_designed_and_studied_in_every_formulation_and_set(tmp_path: Path) -> None:
    bar = ("--case", "case-study", "--artefact", str(CONFIG / "artefacts" / "straight-bar-1500.toml"))
    for formulation, positions in product(("centres", "distances"), ("S2", "S1+S2+S3")):
        ranked = command("rank", *bar, "--set", positions, "--formulation", formulation, "--grid", "6x3x3")
        assert 0 < ranked["rank"] < ranked["parameters"]
    few = (*bar, "--stations", "1")
    designed = command("design", *few, "--positions", "2", "--grid-deg", "90", "--out", str(tmp_path / "design.csv"))
    assert designed["expected_vce_um"] < designed["expected_ve_um"]
    found = command("study", "strategy", *few, "--machines", "1", "--workers", "1", "--out", str(tmp_path))
    for way in ("centres, full weights, prior", "distances, unit weights, prior"):
        assert list(found["vce_aligned_um"][way]) == ["S1", "S2", "S3", "S1+S2", "S1+S3", "S2+S3", "S1+S2+S3"]
        assert max(found["vce_aligned_um"][way].values()) < found["ve_aligned_um"]
