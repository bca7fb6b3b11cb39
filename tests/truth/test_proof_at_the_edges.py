"""A foreign machine that bends near the ends of the ram's height, where no position of the set reaches, is found out by
the chosen held-out positions, and not by orientations in the middle."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from agent.planning.case_file import CASE_STUDY, load_case
from campaigns.foreign.artefact import S3, measure, tilted_bar
from campaigns.foreign.machine import TOOL, ForeignMachine, foreign_machine
from campaigns.foreign.score import family_of
from twin.artefact.held_out_check import HeldOutTest, held_out_covariance, held_out_residuals
from twin.artefact.position_set import Position
from twin.identification import identify_by_evidence, residual_covariance
from twin.machine.forward_model import exact_deviation

IN_THE_MIDDLE = tuple(Position(station, angle, angle) for station in (1, 4) for angle in (30.0, -30.0))
SEEDS = (1, 2, 3, 4, 5, 6)
REACHED_MM, BENT_MM = (230.0, 1270.0), 0.06


@dataclass(frozen=True)
class BentAtTheEnds(ForeignMachine):
    """Foreign machine that bends beyond the heights that the position set reaches, by 60 µm at both ends of Z."""

    def deviation(self, axis_positions: np.ndarray) -> np.ndarray:
        """Return the position of the tool point minus the nominal one, (n, 3) in mm."""
        below, above = REACHED_MM[0] - axis_positions[:, 2], axis_positions[:, 2] - REACHED_MM[1]
        beyond = np.maximum(np.maximum(below, above), 0.0) / REACHED_MM[0]
        bent = super().deviation(axis_positions)
        bent[:, 0] += BENT_MM * beyond**2
        return bent


@cache
def proofs(seed: int) -> tuple[HeldOutTest, HeldOutTest]:
    """Return the comparison of two proofs with their prediction: in the middle, and where the table is least known.

    The predicted residual is that of the position with the largest one.
    """
    rng = np.random.default_rng(seed)
    plain, bar = foreign_machine(rng), tilted_bar(rng)
    machine = BentAtTheEnds(plain.motions, plain.squareness, plain.bending)
    job = load_case(CASE_STUDY)
    places = job.settings.stations.places_mm
    seen = measure(machine, bar, S3, np.random.default_rng(seed + 100), stations=places).seen
    estimate = identify_by_evidence(family_of, seen, bar.artefact)

    def proof(held_out: Sequence[Position]) -> HeldOutTest:
        stations = [places[position.station - 1] for position in held_out]
        orientations = [(position.azimuth_deg, position.elevation_deg) for position in held_out]
        parts = [
            measure(machine, bar, [angles], np.random.default_rng(seed + 200), stations=[place]).seen
            for place, angles in zip(stations, orientations, strict=True)
        ]
        tests = []
        for part in parts:
            compensated = part.axis_positions + exact_deviation(
                estimate.model, part.axis_positions, TOOL, estimate.parameters
            )
            result = held_out_residuals(part, compensated + TOOL, bar.artefact)
            left = residual_covariance(estimate, part.axis_positions, TOOL)
            covariance = held_out_covariance(part, result.placed_mm, bar.artefact, left)
            tests.append(covariance.test(result.residuals_mm))
        freedom = sum(test.freedom for test in tests)
        mean = sum(test.chi2_normalised * test.freedom for test in tests) / freedom
        return HeldOutTest(max(test.predicted_mm for test in tests), mean, freedom)

    return proof(IN_THE_MIDDLE), proof(job.held_out)


def test_the_chosen_positions_find_what_the_middle_does_not() -> None:
    middle, chosen = zip(*(proofs(seed) for seed in SEEDS), strict=True)
    assert all(test.chi2_normalised < 2.0 for test in middle)
    assert sum(test.chi2_normalised > 2.0 for test in chosen) >= 5
