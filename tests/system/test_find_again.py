"""An artefact that was carried is found again by the wide search, or it is not, without anything being hit."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from nights import document

from agent.errors import MeasurementFault
from agent.execution.device_assembly import assemble
from agent.execution.engine import Engine
from agent.execution.rig import Rig
from agent.planning.job import Job
from agent.planning.job_preparation import prepare_job
from agent.probing.run_plan import MeasuredPositions, MeasuringOrder, measure_positions
from agent.settings.schema import Settings
from drivers.clock import VirtualClock
from drivers.errors import GuardTripped
from simulators.world.world import World
from twin.artefact.position_set import Position

FREE, UPWARDS = Position(2, 45.0, 0.0), Position(2, 0.0, 45.0)


@pytest.fixture(scope="module")
def job() -> Iterator[Job]:
    with TemporaryDirectory() as directory:
        yield prepare_job(Settings.model_validate(document(Path(directory) / "state")), Path.cwd())


def carried_and_measured(
    job: Job, position: Position, by_mm: tuple[float, float, float], turn_deg: float
) -> tuple[MeasuredPositions, World]:
    """The simulated operator puts it down at station 2; then it stands that far off besides."""
    rig = assemble(job.settings, VirtualClock(), Path.cwd())
    rig.open()
    world: World = rig.devices["twin"].world  # type: ignore[attr-defined]
    careless(rig, world, by_mm, turn_deg)
    plan = measure_positions(MeasuringOrder("m", (position,), 1), job.layout, job.rules)
    try:
        return Engine(rig.actions()).run(plan), world
    finally:
        assert world.collisions == []
        assert world.workpiece.station == 2


def careless(rig: Rig, world: World, by_mm: tuple[float, float, float], turn_deg: float) -> None:
    ask = rig.operator.ask

    class Hand:
        def ask(self, request: object) -> bool:
            done = ask(request)  # type: ignore[arg-type]
            world.workpiece.shift(by_mm, turn_deg)
            return done

    rig.operator = Hand()


@pytest.mark.parametrize("position", [FREE, UPWARDS])
@pytest.mark.parametrize(
    ("by_mm", "turn_deg"), [((3.0, 0.0, 0.0), 0.3), ((-2.0, 2.0, -1.0), -0.3), ((0.0, -3.0, 0.0), 0.3)]
)
def test_three_millimetres_and_a_third_of_a_degree_are_found(
    job: Job, position: Position, by_mm: tuple[float, float, float], turn_deg: float
) -> None:
    measured, world = carried_and_measured(job, position, by_mm, turn_deg)
    [found] = measured.positions
    assert len(found.balls) == 11
    assert measured.lost == 0
    nominal = job.layout.nominal(position)[found.ball_numbers]
    off = np.linalg.norm(found.centres_mm - nominal, axis=1)
    assert off.max() > 3.5
    true = np.array(world.workpiece.snapshot(world.now).balls)[found.ball_numbers] - job.tool_offset_mm
    assert found.centres_mm == pytest.approx(true, abs=0.05)


@pytest.mark.parametrize("position", [FREE, UPWARDS])
@pytest.mark.parametrize(
    ("by_mm", "turn_deg"),
    [((20.0, 0.0, 0.0), 1.0), ((0.0, 20.0, 0.0), 0.0), ((0.0, 0.0, 15.0), 0.0), ((0.0, -20.0, 0.0), 0.0)],
)
def test_too_far_off_is_a_clear_fault_and_nothing_is_hit(
    job: Job, position: Position, by_mm: tuple[float, float, float], turn_deg: float
) -> None:
    with pytest.raises((MeasurementFault, GuardTripped)) as caught:
        carried_and_measured(job, position, by_mm, turn_deg)
    error = caught.value
    assert "station-2" in str(error.where["step"])
    if isinstance(error, MeasurementFault):
        assert "was not found where it was expected" in error.message
        assert "the station's location" in (error.hint or "")
