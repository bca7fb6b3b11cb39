"""Artefacts without a certificate, of which one length is certified: cost, and the calibration that a run makes."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from click.testing import Result
from volcal_command import volcal

from agent.results.artefact_calibration import calibration_warnings
from agent.results.observations import ReferenceArtefact
from campaigns.foreign.artefact import (
    CERTIFICATE_MM,
    S1,
    S2,
    S3,
    STATIONS_MM,
    ForeignBar,
    measure,
    straight_bar,
    tilted_bar,
)
from campaigns.foreign.files import artefact_text, ball_text, machine_text, rows_of
from campaigns.foreign.machine import TOOL, foreign_machine
from campaigns.foreign.score import family_of, true_error_um
from twin.artefact.artefact import Artefact
from twin.artefact.certificate import BallDistance, with_reference_length
from twin.artefact.held_out_check import held_out_residuals
from twin.artefact.observations import Observations
from twin.errors import DataError
from twin.formats.artefact_file import parse_artefact
from twin.identification import Estimate, Options, identify, residual_covariance
from twin.machine.forward_model import exact_deviation

SEEDS = range(8)
ROUGH_MM = 0.05
END = 10


def rough(bar: ForeignBar, seed: int) -> ForeignBar:
    """Return the bar with centres in its file that are right within a standard deviation of 50 µm."""
    nominal = bar.true + np.random.default_rng(seed + 500).normal(0.0, ROUGH_MM, bar.true.shape)
    return replace(bar, certified=nominal)


def end_length_mm(bar: ForeignBar, seed: int) -> float:
    true = float(np.linalg.norm(bar.true[END] - bar.true[0]))
    return true + float(np.random.default_rng(seed + 600).normal(0.0, CERTIFICATE_MM))


def without_certificate(bar: ForeignBar, seed: int, *, length: bool = True) -> Artefact:
    """Return what the program knows of the bar: centres to 50 µm and, if `length` is True, the length of its ends."""
    balls, covariance = rough(bar, seed).certified, np.eye(bar.true.size) * ROUGH_MM**2
    if length:
        stated = BallDistance((0, END), end_length_mm(bar, seed), CERTIFICATE_MM)
        balls, covariance = with_reference_length(balls, covariance, stated)
    return replace(bar.artefact, balls=balls, covariance=covariance)


def measured(seed: int) -> tuple[ForeignBar, Observations]:
    rng = np.random.default_rng(seed)
    machine, bar = foreign_machine(rng), tilted_bar(rng)
    return bar, measure(machine, bar, S3, np.random.default_rng(seed + 100)).seen


@cache
def estimated(seed: int, known: str) -> Estimate:
    bar, seen = measured(seed)
    artefact = bar.artefact if known == "certificate" else without_certificate(bar, seed, length=known == "length")
    return identify(family_of(6).model, seen, artefact, family_of(6))


def mean_after_um(known: str) -> float:
    return float(
        np.mean([true_error_um(foreign_machine(np.random.default_rng(seed)), estimated(seed, known)) for seed in SEEDS])
    )


def rigidly_aligned(points: np.ndarray, onto: np.ndarray) -> np.ndarray:
    """Return points (n, 3) moved rigidly so that they fit the points `onto` best (Kabsch)."""
    here, there = points.mean(axis=0), onto.mean(axis=0)
    u, _, vt = np.linalg.svd((onto - there).T @ (points - here))
    turn = u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt
    return np.asarray((points - here) @ turn.T + there)


def test_one_length_instead_of_a_certificate_costs_little_and_nothing_certified_costs_much() -> None:
    certified, length, nothing = (mean_after_um(known) for known in ("certificate", "length", "nothing"))
    assert 1.0 < length / certified < 1.15
    assert nothing / certified > 1.25


@pytest.mark.parametrize("known", ["length", "certificate"])
def test_the_calibration_covers_the_true_centres_as_stated(known: str) -> None:
    """The truth is that of the generator, in the frame of the calibration."""
    inside, squares = [], []
    for seed in SEEDS:
        found = estimated(seed, known).artefact_calibration
        assert found is not None
        assert found.certified == (known == "certificate")
        error = found.balls - rigidly_aligned(measured(seed)[0].true, found.balls)
        inside.append(np.abs(error) <= found.expanded_uncertainty_mm)
        values, vectors = np.linalg.eigh(found.covariance)
        assert (values[:6] < 1e-9 * values[-1]).all()  # the frame of the artefact has no uncertainty
        squares.append(np.square(vectors[:, 6:].T @ error.reshape(-1)) / values[6:])
    assert np.mean(inside) == pytest.approx(0.955, abs=0.03)  # 264 coordinates, normal distribution at k = 2
    assert np.mean(squares) == pytest.approx(1.0, abs=0.2)  # 216 independent errors in units of their uncertainty


def test_a_table_is_proved_with_the_calibrated_artefact() -> None:
    """The centres of the file are 50 µm off; those of the calibration agree with new positions as predicted."""
    tests = []
    for seed in SEEDS:
        bar, found = measured(seed)[0], estimated(seed, "length")
        machine = foreign_machine(np.random.default_rng(seed))
        held_out = [(20.0, 15.0), (-65.0, -20.0)]
        part = measure(machine, bar, held_out, np.random.default_rng(seed + 200)).seen
        written = part.axis_positions + exact_deviation(found.model, part.axis_positions, TOOL, found.parameters)
        reference = ReferenceArtefact.of(without_certificate(bar, seed), found.unknowns, found.z, found.z_covariance)
        result = held_out_residuals(part, written + TOOL, reference.artefact)
        covariance = reference.covariance(part, result, residual_covariance(found, part.axis_positions, TOOL), TOOL)
        tests.append((covariance.test(result.residuals_mm), 1e3 * result.rms_mm))
    assert max(rms_um for _, rms_um in tests) < 6.0
    assert np.mean([test.chi2_normalised for test, _ in tests]) == pytest.approx(1.0, abs=0.2)


def test_a_calibration_is_far_better_than_the_file_and_rests_on_the_length() -> None:
    found = estimated(0, "length").artefact_calibration
    assert found is not None
    assert 1e3 * found.expanded_uncertainty_mm.max() < 2.0
    assert found.before.balls == found.scale.balls == (0, END)
    assert found.scale.standard_uncertainty_mm == pytest.approx(CERTIFICATE_MM, rel=0.1)
    assert found.not_improved == ()
    assert "distance of balls 0 and 10, which was known to 1.6 µm (1.1 ppm, k = 2)" in found.limits[0]


@pytest.mark.parametrize("seed", range(2))
def test_a_straight_bar_shows_its_own_pattern(seed: int) -> None:
    """The balls are 50 µm off a line, and the file says that they stand on it."""
    rng = np.random.default_rng(seed)
    machine, bar = foreign_machine(rng), straight_bar(rng, ROUGH_MM)
    seen = measure(machine, bar, S1 + S2 + S3, np.random.default_rng(seed + 100)).seen
    known = without_certificate(bar, seed)
    on_line = known.balls * [1.0, 0.0, 0.0] - [0.0, 60.0, 0.0]
    family = family_of(6)
    certified, found = (
        identify(family.model, seen, artefact, family) for artefact in (bar.artefact, replace(known, balls=on_line))
    )
    assert found.rejected == ()
    assert found.chi2_normalised == pytest.approx(certified.chi2_normalised, rel=0.02)
    assert true_error_um(machine, found) < 1.3 * true_error_um(machine, certified)
    calibration = found.artefact_calibration
    assert calibration is not None
    error = calibration.balls - rigidly_aligned(bar.true, calibration.balls)
    # the roll about the line is free: the alignment finds it from the pattern
    assert np.mean(np.abs(error) <= calibration.expanded_uncertainty_mm) > 0.85
    assert 1e3 * np.abs(error[:, 1:]).max() < 3.0


def test_a_later_night_knows_the_pattern_of_a_straight_bar() -> None:
    """At one station the straightness of the machine would make a wrong pattern."""
    rng = np.random.default_rng(1)
    machine, bar = foreign_machine(rng), straight_bar(rng, ROUGH_MM)
    known, family = without_certificate(bar, 1), family_of(6)
    on_line = replace(known, balls=known.balls * [1.0, 0.0, 0.0] - [0.0, 60.0, 0.0])
    first = measure(machine, bar, S1 + S2 + S3, np.random.default_rng(101)).seen
    before = identify(family.model, first, on_line, family)
    night = measure(machine, bar, S3, np.random.default_rng(102), stations=STATIONS_MM[:1]).seen
    after = identify(family.model, night, on_line, family, Options(carried_over=before.carried_over()))
    assert after.rejected == ()
    assert after.chi2_normalised < 1.3
    assert true_error_um(machine, after) < 1.05 * true_error_um(machine, before)


def test_equal_weights_need_a_certificate() -> None:
    bar, seen = measured(0)
    family = family_of(6)
    with pytest.raises(DataError, match=r"equal weights take the balls of .* as exact"):
        identify(family.model, seen, without_certificate(bar, 0), family, Options(weights="unit"))


def run_identify(folder: Path, seed: int, artefact: Path, out: str) -> Result:
    _, seen = measured(seed)
    (folder / "balls.csv").write_text(ball_text(rows_of(seen, 0, per_station=len(S3))))
    (folder / "machine.toml").write_text(machine_text())
    files = [str(folder / "balls.csv"), "--machine", str(folder / "machine.toml"), "--artefact", str(artefact)]
    options = ["--order", "6", "--even-so", "--out", str(folder / out), "--json"]
    return volcal("identify", *files, *options, exit_code=None)


def rough_text(seed: int, end_length: str) -> str:
    text = artefact_text(rough(measured(seed)[0], seed))
    return end_length + text.replace("standard_uncertainty_um = 0.8", "standard_uncertainty_um = 50.0")


def test_the_calibration_of_a_run_is_an_artefact_file(tmp_path: Path) -> None:
    bar, _ = measured(0)
    length = f"end_length_mm = {end_length_mm(bar, 0):.5f}\nend_length_standard_uncertainty_um = 0.8\n"
    (tmp_path / "bar.toml").write_text(rough_text(0, length))
    result = run_identify(tmp_path, 0, tmp_path / "bar.toml", "out")
    assert result.exit_code == 0, result.stderr
    stated = json.loads(result.stdout)["artefact_calibration"]
    out = tmp_path / "out"
    stored = json.loads((out / "estimate.json").read_text())["artefact_calibration"]
    assert stated.items() <= stored.items()
    text = (out / "artefact.toml").read_text()
    calibrated = parse_artefact(text, "artefact.toml", lambda name: (out / name).read_text())
    assert calibrated.balls.tolist() == stored["balls_mm"]
    assert 1e6 * calibrated.covariance == pytest.approx(np.array(stored["covariance_um2"]), abs=1e-12)
    error = calibrated.balls - rigidly_aligned(bar.true, calibrated.balls)
    assert np.mean(1e3 * np.abs(error) <= np.array(stated["expanded_uncertainty_um"])) > 0.85
    page = (out / "report.html").read_text()
    assert "Artefact as measured by this run" in page
    assert stated["limits"][0] in page
    # with it, another machine is identified as with a certificate
    machine = foreign_machine(np.random.default_rng(1))
    seen = measure(machine, bar, S3, np.random.default_rng(101)).seen
    certified, own = (identify(family_of(6).model, seen, one, family_of(6)) for one in (bar.artefact, calibrated))
    assert own.artefact_calibration is not None
    assert own.artefact_calibration.certified
    assert true_error_um(machine, own) < 1.15 * true_error_um(machine, certified)


def test_a_run_without_any_certified_length_warns() -> None:
    (warning,) = calibration_warnings(estimated(0, "nothing").artefact_calibration)
    assert warning.startswith("No length of the artefact is known better than 47 ppm")
    assert calibration_warnings(estimated(0, "length").artefact_calibration) == ()


def test_a_length_that_contradicts_the_balls_writes_nothing(tmp_path: Path) -> None:
    wrong = "end_length_mm = 1501.5\nend_length_standard_uncertainty_um = 0.8\n"
    (tmp_path / "bar.toml").write_text(rough_text(0, wrong))
    result = run_identify(tmp_path, 0, tmp_path / "bar.toml", "out")
    assert result.exit_code == 2
    assert "end_length_mm" in result.stderr
    assert "|E_n|" in result.stderr
    assert not (tmp_path / "out").exists()
