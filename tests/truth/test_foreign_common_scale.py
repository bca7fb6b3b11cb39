"""A scale that all axes have in common: found if neither machine nor artefact may have it, and its causes named."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from foreign_files import Folder

from agent.results.gates.estimate_gates import estimate_gates
from agent.results.gates.gate_rules import COMMON_SCALE
from agent.results.gates.required_gates import names_of_failed
from agent.settings.schema import GateSettings
from campaigns.foreign.artefact import CTE_PER_K, S3, ForeignBar, measure, straight_bar, tilted_bar
from campaigns.foreign.files import rows_of
from campaigns.foreign.machine import ForeignMachine, foreign_machine
from campaigns.foreign.score import family_of
from twin.artefact.observations import Observations
from twin.formats.estimate_file import parse_estimate
from twin.identification import CommonScale, Estimate, Options, identify, identify_by_evidence

LIMIT = GateSettings().common_scale_false_alarm
THERMOMETER_K = 0.1
SEEDS = range(6)


def drawn(seed: int, worse: float = 1.0) -> tuple[ForeignMachine, ForeignBar]:
    rng = np.random.default_rng(seed)
    machine = foreign_machine(rng, worse)
    return machine, straight_bar(rng, 0.01) if seed % 2 else tilted_bar(rng)


def measured(seed: int, error_k: float = 0.0, worse: float = 1.0, hall_c: float = 20.0) -> Observations:
    machine, bar = drawn(seed, worse)
    rng = np.random.default_rng(seed + 100)
    return measure(machine, bar, S3, rng, hall_c=hall_c, thermometer_error_k=error_k).seen


def estimate_of(seed: int, seen: Observations, thermometer_k: float = THERMOMETER_K) -> Estimate:
    options = Options(temperature_standard_uncertainty_k=thermometer_k)
    return identify(family_of(5).model, seen, drawn(seed)[1].artefact, family_of(5), options)


def scale_of(estimate: Estimate) -> CommonScale:
    assert estimate.common_scale is not None
    return estimate.common_scale


@pytest.mark.parametrize("error_k", [2.0, -2.0])
@pytest.mark.parametrize("seed", SEEDS)
def test_a_thermometer_wrong_by_twenty_times_its_uncertainty_is_found(seed: int, error_k: float) -> None:
    sound, wrong = (estimate_of(seed, measured(seed, error)) for error in (0.0, error_k))
    found = scale_of(wrong)
    assert found.false_alarm < LIMIT
    assert COMMON_SCALE in names_of_failed(estimate_gates(wrong, GateSettings()))
    shown = found.scale_um_per_m - scale_of(sound).scale_um_per_m
    assert shown == pytest.approx(1e6 * CTE_PER_K * error_k, rel=0.15)


@pytest.mark.parametrize("worse", [0.1, 1.0, 3.0])
@pytest.mark.parametrize("seed", SEEDS)
def test_a_sound_measurement_raises_no_alarm(seed: int, worse: float) -> None:
    machine, bar = drawn(seed, worse)
    seen = measure(machine, bar, S3, np.random.default_rng(seed + 100)).seen
    estimate = identify_by_evidence(
        family_of, seen, bar.artefact, Options(temperature_standard_uncertainty_k=THERMOMETER_K)
    )
    assert scale_of(estimate).false_alarm >= LIMIT
    assert COMMON_SCALE not in names_of_failed(estimate_gates(estimate, GateSettings()))


@pytest.mark.parametrize("seed", SEEDS)
def test_a_thermometer_that_may_be_wrong_by_that_much_raises_no_alarm(seed: int) -> None:
    assert scale_of(estimate_of(seed, measured(seed, 2.0), thermometer_k=1.0)).false_alarm >= LIMIT


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_the_scale_of_a_single_axis_is_no_common_one(axis: int) -> None:
    """The artefact cannot explain a scale of one axis, which the table may correct."""
    seen = measured(0)
    points = seen.axis_positions.copy()
    points[:, axis] *= 1.0 - 70e-6
    estimate = estimate_of(0, replace(seen, axis_positions=points))
    assert scale_of(estimate).axes_um_per_m[axis] > 50.0
    assert scale_of(estimate).false_alarm >= LIMIT


def test_each_named_cause_explains_the_scale() -> None:
    """The measurement is evaluated again, with each of the named errors corrected."""
    seed, hall_c = 0, 24.0
    seen, bar = measured(seed, 2.0, hall_c=hall_c), drawn(seed)[1].artefact
    found = scale_of(estimate_of(seed, seen))
    assert found.temperature_k is not None
    assert found.cte_per_k is not None
    strain = 1e-6 * found.scale_um_per_m
    assert found.length_um == pytest.approx(1e3 * strain * found.length_mm)
    corrected = (
        (replace(seen, temperature_c=seen.temperature_c - found.temperature_k), bar),
        (seen, replace(bar, balls=bar.balls * (1.0 - 1e-3 * found.length_um / found.length_mm))),
        (seen, replace(bar, cte_per_k=bar.cte_per_k - found.cte_per_k)),
    )
    options = Options(temperature_standard_uncertainty_k=THERMOMETER_K)
    for again, artefact in corrected:
        estimate = identify(family_of(5).model, again, artefact, family_of(5), options)
        assert abs(scale_of(estimate).scale_um_per_m) < 0.1 * found.scale_um_per_m


def test_an_artefact_at_its_reference_temperature_has_no_expansion_to_doubt() -> None:
    seen = measured(0, 2.0)
    cold = replace(seen, temperature_c=np.full(seen.size, 20.0))
    found = scale_of(estimate_of(0, cold))
    assert found.cte_per_k is None
    assert "CTE" not in found.causes


def test_a_length_of_unknown_scale_raises_no_alarm() -> None:
    """Balls that are known to 0.1 mm allow any scale that a machine can have."""
    seed = 0
    bar = drawn(seed)[1].artefact
    rough = replace(bar, covariance=bar.covariance * (0.1 / math.sqrt(bar.covariance[0, 0])) ** 2)
    options = Options(temperature_standard_uncertainty_k=THERMOMETER_K)
    estimate = identify(family_of(5).model, measured(seed, 2.0), rough, family_of(5), options)
    assert scale_of(estimate).expected_um_per_m > 20.0
    assert scale_of(estimate).false_alarm >= LIMIT


def test_a_later_night_is_not_tested() -> None:
    """The common scale is then that of the estimate before."""
    first = estimate_of(0, measured(0))
    options = Options(temperature_standard_uncertainty_k=THERMOMETER_K, carried_over=first.carried_over())
    again = identify(family_of(5).model, measured(0), drawn(0)[1].artefact, family_of(5), options)
    assert again.common_scale is None
    gates = {gate.name: gate for gate in estimate_gates(again, GateSettings())}
    assert gates[COMMON_SCALE].passed
    assert "not tested" in gates[COMMON_SCALE].text


def test_the_command_refuses_the_table_and_names_the_causes(tmp_path: Path) -> None:
    seen = measured(0, 2.0, hall_c=24.0)
    folder = Folder(tmp_path)
    options = ("--order", "4", "--temperature-uncertainty", "0.1", "--json")
    done = folder.run(drawn(0)[1], rows_of(seen, per_station=len(S3)), *options)
    assert done.exit_code == 0, done.output  # `--even-so`
    said = json.loads(done.stdout)
    assert said["gates"]["common scale"] is False
    assert said["gates"]["pattern"] is True
    reason = said["reason"]
    assert "gates.common_scale_false_alarm; a common scale of +" in reason
    for cause in ("an artefact temperature too high by 2.", "an artefact length too long by ", "a CTE too large by "):
        assert cause in reason
    stored = parse_estimate((folder.out / "estimate.json").read_text(), "estimate.json").document.common_scale
    assert stored is not None
    assert stored.model_dump(mode="json") == said["common_scale"]
