"""Orders that the settings accept, and their effect on an identification."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError

from agent.model_files import load_machine
from agent.results.estimation import estimate_machine, order_text, scale_warnings
from agent.settings.schema import IdentificationSettings, Order
from twin.artefact.artefact import ball_bar
from twin.artefact.mount_geometry import MountGeometry
from twin.artefact.observations import Observations
from twin.artefact.position_set import mount_pose, parse_position_set, station_locations
from twin.identification import Options
from twin.machine.machine_description import MachineDescription

ROOT = Path(__file__).parents[3]
BAR = ball_bar("bar", balls=5, length_mm=1000.0, tilt_rad=0.26, holder_length_mm=60.0, ball_diameter_mm=25.0)
OFFSET = np.array([0.0, 250.0, 0.0])


@pytest.fixture(scope="module")
def machine() -> MachineDescription:
    return load_machine(ROOT / "config" / "machines" / "case-study.toml")


@pytest.fixture(scope="module")
def seen() -> Observations:
    """Observations of a perfect machine with touch noise alone."""
    rng, rows = np.random.default_rng(1), []
    places = station_locations(2, (0.0, 4000.0), 560.0, 900.0, 750.0)
    for number, position in enumerate(parse_position_set("S3", 2)):
        azimuth, elevation = np.radians(position.azimuth_deg), np.radians(position.elevation_deg)
        pose = mount_pose(places[position.station - 1], MountGeometry(), azimuth, elevation)
        rows += [(number, ball, *point) for ball, point in enumerate(pose.apply(BAR.balls) - OFFSET)]
    table = np.array(rows)
    n = len(table)
    return Observations(
        position=table[:, 0].astype(int),
        ball=table[:, 1].astype(int),
        tool=np.zeros(n, dtype=int),
        axis_positions=table[:, 2:] + rng.normal(0.0, 1e-3, (n, 3)),
        covariance=np.tile(np.eye(3) * 1e-6, (n, 1, 1)),
        temperature_c=np.full(n, 20.0),
        elevation_rad=np.zeros(n),
        tool_offsets=OFFSET[None],
    )


@pytest.mark.parametrize("order", ["evidence", "file", 1, 15])
def test_orders_that_are_accepted(order: object) -> None:
    assert IdentificationSettings.model_validate({"order": order}).order == order


@pytest.mark.parametrize("order", ["best", 0, 16, 4.5, None])
def test_orders_that_are_refused(order: object) -> None:
    with pytest.raises(ValidationError):
        IdentificationSettings.model_validate({"order": order})


def test_evidence_is_the_default() -> None:
    assert IdentificationSettings().order == "evidence"


def test_each_order_selects_its_model(machine: MachineDescription, seen: Observations) -> None:
    def sizes(order: Order, options: Options) -> int:
        return estimate_machine(machine, BAR, seen, options, order).model.size

    plain = Options(misfit_mm=0.0, outliers="none", estimate_scales=False)
    assert sizes("file", plain) == 90
    assert sizes(3, plain) == 54
    known = estimate_machine(machine, BAR, seen, plain, 3).carried_over()
    assert sizes("evidence", Options(carried_over=known)) == 54


def test_the_order_text_names_the_compared_orders(machine: MachineDescription, seen: Observations) -> None:
    chosen = estimate_machine(machine, BAR, seen, Options(misfit_mm=0.0), "evidence")
    text = order_text(chosen)
    assert text.startswith(f"{chosen.model.highest_order[0]}, by evidence (ln, against the likeliest: 3: ")
    assert order_text(estimate_machine(machine, BAR, seen, Options(), "file")) == "5"


def test_a_scale_at_its_bound_is_a_warning(machine: MachineDescription, seen: Observations) -> None:
    """Noise stated a hundred times too large."""
    quiet = dataclasses.replace(seen, covariance=seen.covariance * 1e4)
    (warning,) = scale_warnings(estimate_machine(machine, BAR, quiet, Options(misfit_mm=0.0), "file"))
    assert warning.startswith("A scale ran into its bounds. Touch noise: 0.3 times as stated")
    assert scale_warnings(estimate_machine(machine, BAR, seen, Options(misfit_mm=0.0), "file")) == ()
