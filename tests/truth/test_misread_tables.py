"""Tables that a controller stores but does not apply as written: the change of held-out balls names the mistake.

The controller here is a list of corrections in the order of the register map and a loop that reads it.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest
from scipy.interpolate import RegularGridInterpolator

from agent.probing.measured_balls import no_correction
from agent.results.applied_table import BANK_DOUBTED, AppliedTable, applied_table, diagnosed
from campaigns.foreign.artefact import S3, MeasuringConditions, measure, measure_at, tilted_bar
from campaigns.foreign.machine import TOOL, foreign_machine
from campaigns.foreign.score import family_of
from twin.arrays import Array
from twin.artefact.artefact import Artefact
from twin.artefact.change_test import ChangeTest
from twin.artefact.held_out_check import HeldOutCovariance, held_out_covariance, held_out_residuals
from twin.artefact.observations import Observations
from twin.compensation.misread_tables import misread_tables
from twin.compensation.table import CompensationTable, build_table, regular_nodes
from twin.identification import identify, residual_covariance
from twin.machine.anchor import Anchor

MACHINES, REPEATS, MAX_CHI2 = 10, 3, 2.0
STATIONS_MM = ((700.0, 1000.0, 750.0), (1567.0, 1000.0, 750.0), (2433.0, 1000.0, 750.0), (3300.0, 1000.0, 750.0))
HELD_OUT = [
    (STATIONS_MM[0], [(-120.0, -60.0), (-30.0, -60.0), (-60.0, 60.0)]),
    (STATIONS_MM[3], [(30.0, -60.0)]),
]
CONDITIONS = MeasuringConditions(clamping_roll_rad=0.4)

Reading = Callable[[list[list[float]], tuple[int, int, int], int, int, int], list[float]]
"""Function that returns the correction that a controller finds in its list for the node i, j, k."""


def as_written(listed: list[list[float]], nodes: tuple[int, int, int], i: int, j: int, k: int) -> list[float]:
    return listed[(i * nodes[1] + j) * nodes[2] + k]


def x_fastest(listed: list[list[float]], nodes: tuple[int, int, int], i: int, j: int, k: int) -> list[float]:
    return listed[(k * nodes[1] + j) * nodes[0] + i]


def y_fastest(listed: list[list[float]], nodes: tuple[int, int, int], i: int, j: int, k: int) -> list[float]:
    return listed[(i * nodes[2] + k) * nodes[1] + j]


def axis_by_axis(listed: list[list[float]], nodes: tuple[int, int, int], i: int, j: int, k: int) -> list[float]:
    values, node = [value for row in listed for value in row], (i * nodes[1] + j) * nodes[2] + k
    return [values[axis * len(listed) + node] for axis in range(3)]


def half_received(listed: list[list[float]], nodes: tuple[int, int, int], i: int, j: int, k: int) -> list[float]:
    node = (i * nodes[1] + j) * nodes[2] + k
    return listed[node] if node < len(listed) // 2 else [0.0, 0.0, 0.0]


def z_downwards(listed: list[list[float]], nodes: tuple[int, int, int], i: int, j: int, k: int) -> list[float]:
    return as_written(listed, nodes, i, j, nodes[2] - 1 - k)


def x_and_z_exchanged(listed: list[list[float]], nodes: tuple[int, int, int], i: int, j: int, k: int) -> list[float]:
    return as_written(listed, nodes, i, j, k)[::-1]


def scaled(factor: float) -> Reading:
    def reading(listed: list[list[float]], nodes: tuple[int, int, int], i: int, j: int, k: int) -> list[float]:
        return [factor * value for value in as_written(listed, nodes, i, j, k)]

    return reading


def wrong_sign_of_z(listed: list[list[float]], nodes: tuple[int, int, int], i: int, j: int, k: int) -> list[float]:
    x, y, z = as_written(listed, nodes, i, j, k)
    return [x, y, -z]


@dataclass(frozen=True, eq=False)
class ProofScene:
    """Held-out balls of one machine, measured with the former and the new table, and the new table."""

    table: CompensationTable
    artefact: Artefact
    former: Observations
    later: Observations
    field: Array

    def diagnosis(self, former_share: float, reading: Reading) -> AppliedTable:
        """Replace a table with the share `former_share` of the corrections by a new one that is applied as `reading`
        says, and return the diagnosis."""

        def share(points: Array) -> Array:
            return former_share * self.table.at(points)

        earlier = share if former_share else no_correction

        before = self._residuals(self.former, earlier)
        after = self._residuals(self.later, self._applied(reading))
        covariance = self._covariance(after)

        def projected(correction: Callable[[Array], Array]) -> Array:
            return covariance.projected(correction(self.former.axis_positions))

        change = covariance.projected(after - before) - projected(earlier)
        test = ChangeTest.of(change, covariance, covariance.touches, 1.0)
        return applied_table(test, self.table, earlier, projected, MAX_CHI2)

    def _residuals(self, part: Observations, correction: Callable[[Array], Array]) -> Array:
        displayed = part.axis_positions - correction(part.axis_positions)
        return held_out_residuals(part, displayed + TOOL, self.artefact).residuals_mm

    def _covariance(self, residuals_mm: Array) -> HeldOutCovariance:
        placed_mm = self.later.axis_positions + TOOL - residuals_mm
        return held_out_covariance(self.later, placed_mm, self.artefact, self.field)

    def _applied(self, reading: Reading) -> Callable[[Array], Array]:
        nodes = self.table.corrections.shape[:3]
        listed = [[float(value) for value in row] for row in self.table.corrections.reshape(-1, 3)]
        read = np.zeros((*nodes, 3))
        for i in range(nodes[0]):
            for j in range(nodes[1]):
                for k in range(nodes[2]):
                    read[i, j, k] = reading(listed, (nodes[0], nodes[1], nodes[2]), i, j, k)
        return RegularGridInterpolator(self.table.nodes, read, bounds_error=False, fill_value=None)


@cache
def scenes() -> tuple[ProofScene, ...]:
    found = []
    for seed in range(MACHINES):
        rng = np.random.default_rng([seed, 81])
        family = family_of(6)
        machine, bar = foreign_machine(rng), tilted_bar(rng)
        seen = measure(machine, bar, S3, rng, stations=STATIONS_MM).seen
        estimate = identify(family.model, seen, bar.artefact, family)
        nodes = regular_nodes(family.model.ranges_mm, (200.0, 200.0, 200.0))
        table = build_table(family.model, estimate.parameters, nodes, TOOL, Anchor(np.zeros(3)), seen.axis_positions)
        for _ in range(REPEATS):
            former, later = (measure_at(machine, bar, HELD_OUT, rng, CONDITIONS).seen for _ in range(2))
            former, later = (
                part.select(np.isin(keys(part), keys(other))) for part, other in ((former, later), (later, former))
            )
            field = residual_covariance(estimate, later.axis_positions, TOOL)
            found.append(ProofScene(table, bar.artefact, former, later, field))
    return tuple(found)


def keys(part: Observations) -> Array:
    return np.asarray(100 * part.position + part.ball)


@pytest.mark.parametrize("former_share", [0.0, 0.65])
def test_a_table_that_is_applied_as_written_is_never_blamed(former_share: float) -> None:
    found = [scene.diagnosis(former_share, as_written) for scene in scenes()]
    assert [one.reason for one in found] == [""] * len(found)
    assert np.mean([one.chi2_normalised for one in found]) == pytest.approx(1.0, abs=0.15)


def test_a_small_table_is_blamed_for_the_noise_twice_in_ten_thousand_proofs_at_most() -> None:
    """The mistakes of a small table differ from it by little more than the noise, and there are forty of them."""
    rng, blamed, draws = np.random.default_rng(20), 0, 1000
    for scene in scenes()[::REPEATS]:
        small = replace(scene.table, corrections=0.15 * scene.table.corrections)
        covariance = scene._covariance(scene._residuals(scene.later, no_correction))
        at = scene.former.axis_positions
        written, *others = (
            covariance.projected(one(at)) for one in (small.at, *(one.table.at for one in misread_tables(small)))
        )
        named = [(str(number), other) for number, other in enumerate(others)]
        test = ChangeTest.of(-written, covariance, covariance.touches, 1.0)
        noise = np.linalg.inv(test.whitening)
        for _ in range(draws):
            noisy = replace(test, measured=noise @ rng.standard_normal(test.freedom) - written)
            blamed += bool(diagnosed(noisy, written, named, MAX_CHI2).mistake)
    assert blamed <= 2e-4 * draws * MACHINES


@pytest.mark.parametrize("former_share", [0.0, 0.65])
@pytest.mark.parametrize(
    ("reading", "named", "least"),
    [
        (scaled(0.0), "no effect", 1.0),
        (scaled(-1.0), "acts the wrong way", 1.0),
        (scaled(0.5), "half of each correction", 0.9),
        (scaled(2.0), "twice", 0.9),
        (scaled(1.35), r"1[1-6]\d % of the correction", 0.8),
        (x_fastest, "X, then Y, then Z, the fastest first", 1.0),
        (y_fastest, "Y, then Z, then X, the fastest first", 0.9),
        (axis_by_axis, "axis by axis", 1.0),
        (z_downwards, "opposite direction along Z", 1.0),
        (half_received, "first 2 quarters", 0.8),
        (x_and_z_exchanged, "correction of Z on X, the correction of X on Z", 0.9),
        (wrong_sign_of_z, "correction of Z acts the wrong way", 1.0),
    ],
)
def test_a_table_that_is_not_applied_as_written_is_named(
    former_share: float, reading: Reading, named: str, least: float
) -> None:
    found = [scene.diagnosis(former_share, reading) for scene in scenes()]
    assert np.mean([bool(one.reason) for one in found]) >= least
    assert np.mean([re.search(named, one.mistake) is not None for one in found]) >= least


@pytest.mark.parametrize(("reading", "doubted"), [(scaled(0.0), True), (scaled(-1.0), False), (x_fastest, False)])
def test_the_reported_bank_is_doubted_if_no_reading_of_its_table_explains_what_acts(
    reading: Reading, doubted: bool
) -> None:
    """A controller that reads the table wrongly has activated it, and will activate the former one, too."""
    found = [scene.diagnosis(0.65, reading).reason for scene in scenes()]
    assert [BANK_DOUBTED in reason for reason in found] == [doubted] * len(found)
    assert all("odds against the table as written" in reason for reason in found)


def test_a_former_table_that_still_acts_is_named() -> None:
    found = [scene.diagnosis(0.35, scaled(0.35)) for scene in scenes()]
    assert all(one.mistake for one in found)
    assert np.mean([one.mistake.startswith("the former table still acts") for one in found]) >= 0.9
    assert np.mean([BANK_DOUBTED in one.reason for one in found]) >= 0.9
    assert all(math.isfinite(one.chi2_normalised) for one in found)
