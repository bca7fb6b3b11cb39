"""A file whose Z coordinates count from the other end is told from a wrong certificate, even for a nearly straight
bar."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from campaigns.foreign.artefact import S3, measure, straight_bar
from campaigns.foreign.machine import HIGH, foreign_machine
from campaigns.foreign.score import family_of
from twin.artefact.artefact import Artefact
from twin.artefact.observations import Observations
from twin.errors import DataError
from twin.identification import identify
from twin.identification.checks.measured_shape import check_shape

ORDER = 7


def measured_bar(off_axis_mm: float, seed: int) -> tuple[Observations, Artefact]:
    rng = np.random.default_rng([seed, 33])
    machine, bar = foreign_machine(rng), straight_bar(rng, off_axis_mm)
    return measure(machine, bar, S3, rng, clamping_roll_rad=0.0).seen, bar.artefact


def with_z_from_the_other_end(seen: Observations) -> Observations:
    mirrored = seen.axis_positions.copy()
    mirrored[:, 2] = HIGH[2] - mirrored[:, 2]
    return replace(seen, axis_positions=mirrored)


@pytest.mark.parametrize(("off_axis_mm", "seed"), [(0.003, 0), (0.01, 1)])
def test_mirrored_file_is_not_blamed_on_the_certificate(off_axis_mm: float, seed: int) -> None:
    seen, artefact = measured_bar(off_axis_mm, seed)
    mirrored = with_z_from_the_other_end(seen)
    check_shape(mirrored, artefact)  # each position alone does not show it
    family = family_of(ORDER)
    with pytest.raises(DataError, match="mirror image of the artefact"):
        identify(family.model, mirrored, artefact, family)


def test_wrong_balls_are_not_taken_for_a_mirror_image() -> None:
    seen, artefact = measured_bar(0.01, 1)
    wrong = artefact.balls.copy()
    wrong[[2, 7], 1] += 0.03
    family = family_of(ORDER)
    estimate = identify(family.model, seen, replace(artefact, balls=wrong), family)
    assert set(estimate.free_balls) == {2, 7}
