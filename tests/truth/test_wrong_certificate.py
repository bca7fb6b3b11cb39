"""Certificates that are wrong: the ball and the direction are named, and the measurement can still be used."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from case_study_files import MACHINE_FILE
from click.testing import Result
from volcal_command import volcal

from agent.results.gates.estimate_gates import certificate_gate
from agent.results.gates.gate import Gate
from agent.settings.schema import GateSettings
from campaigns.foreign.artefact import S1, S2, S3, ForeignBar, measure, straight_bar, tilted_bar
from campaigns.foreign.files import artefact_text, ball_text, rows_of
from campaigns.foreign.machine import foreign_machine
from campaigns.foreign.score import Score, family_of, score
from twin.artefact.artefact import Artefact
from twin.artefact.observations import Observations
from twin.formats.artefact_file import parse_artefact
from twin.identification import Estimate, identify

SEEDS = range(3)
END = 10
Vector = tuple[float, float, float]


def wrong_bar(bar: ForeignBar, errors_um: dict[int, Vector]) -> ForeignBar:
    """Return the bar with the true centres of some balls displaced from their certified ones."""
    true = bar.true.copy()
    for ball, error_um in errors_um.items():
        true[ball] += 1e-3 * np.array(error_um)
    return replace(bar, true=true)


def measured(seed: int, errors_um: dict[int, Vector]) -> tuple[ForeignBar, Observations]:
    rng = np.random.default_rng(seed)
    machine, bar = foreign_machine(rng), tilted_bar(rng)
    return bar, measure(machine, wrong_bar(bar, errors_um), S3, np.random.default_rng(seed + 100)).seen


def scored(seed: int, errors_um: dict[int, Vector], uncertified: tuple[int, ...] = ()) -> Score:
    bar, seen = measured(seed, errors_um)
    machine = foreign_machine(np.random.default_rng(seed))
    return score(machine, replace(bar, uncertified=uncertified), seen)


def estimated(seed: int, errors_um: dict[int, Vector]) -> Estimate:
    bar, seen = measured(seed, errors_um)
    return fixed_order(bar.artefact, seen)


def fixed_order(artefact: Artefact, seen: Observations) -> Estimate:
    family = family_of(6)
    return identify(family.model, seen, artefact, family)


def gate(estimate: Estimate) -> Gate:
    return certificate_gate(estimate.certificate_check, GateSettings())


@pytest.mark.parametrize("seed", SEEDS)
def test_a_right_certificate_passes(seed: int) -> None:
    found = estimated(seed, {})
    assert gate(found).passed
    assert gate(found).value < 2.05  # exceeded with a probability of 1 % if certificate and model are right
    assert found.free_balls == ()
    assert found.rejected == ()


def test_contradictions_of_a_right_certificate_have_their_stated_distribution() -> None:
    squares = [check.contradiction**2 for seed in range(12) for check in estimated(seed, {}).certificate_check]
    assert np.mean(squares) == pytest.approx(3.0, abs=0.6)  # mean of χ² with three degrees of freedom, 132 balls


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize(("axis", "direction"), list(enumerate("XYZ")))
def test_an_end_ball_20_um_off_is_named_with_its_direction(seed: int, axis: int, direction: str) -> None:
    error = np.eye(3)[axis] * 20.0
    found = estimated(seed, {END: (error[0], error[1], error[2])})
    verdict = gate(found)
    assert not verdict.passed
    assert 7.5 < verdict.value < 12.5
    assert (
        f"ball {END} contradicts its certificate along {direction}, |E_n| = {verdict.value:.2f} (k = 2" in verdict.text
    )
    assert verdict.text.count("contradicts") == 1
    assert f"uncertified_balls = [{END}]" in verdict.text
    assert 1e3 * np.array(found.certificate_check[END].apparent_error_mm) == pytest.approx(error, abs=4.0)


@pytest.mark.parametrize(
    ("ball", "error_um"), [(4, (0.0, 20.0, 0.0)), (5, (0.0, 100.0, 0.0)), (END, (300.0, 0.0, 0.0))]
)
@pytest.mark.parametrize("seed", range(2))
def test_rows_of_a_wrong_ball_are_not_rejected_instead(seed: int, ball: int, error_um: Vector) -> None:
    found = estimated(seed, {ball: error_um})
    assert found.rejected == ()
    assert found.free_balls == (ball,)
    assert f"ball {ball} contradicts" in gate(found).text
    assert gate(found).text.count("contradicts") == 1


def test_two_wrong_balls_are_both_named() -> None:
    found = estimated(0, {END: (20.0, 0.0, 0.0), 3: (0.0, -15.0, 0.0)})
    assert set(found.free_balls) == {3, END}
    assert "uncertified_balls = [3, 10]" in gate(found).text
    assert gate(found).text.count("contradicts") == 2


@pytest.mark.parametrize("error_um", [(20.0, 0.0, 0.0), (0.0, 20.0, 0.0), (0.0, 0.0, 20.0)])
@pytest.mark.parametrize("seed", [0, 3])
def test_a_wrong_ball_on_a_straight_bar_is_named(seed: int, error_um: Vector) -> None:
    """The other balls are 5 µm off the line: the wrong one shows the roll best, but not where its certificate says."""
    rng = np.random.default_rng(seed)
    machine, bar = foreign_machine(rng), straight_bar(rng, 0.005)
    noise = np.random.default_rng(seed + 100)
    seen = measure(machine, wrong_bar(bar, {4: error_um}), S1 + S2 + S3, noise).seen
    found = fixed_order(bar.artefact, seen)
    assert found.rejected == ()
    assert "ball 4 contradicts" in gate(found).text
    assert 1e3 * np.array(found.certificate_check[4].apparent_error_mm) == pytest.approx(error_um, abs=4.0)


def test_a_freed_ball_leaves_the_prior_of_the_machine_as_it_was() -> None:
    right, found = estimated(0, {}), estimated(0, {END: (20.0, 0.0, 0.0)})
    assert found.free_balls == (END,)
    assert found.scales.values == pytest.approx(right.scales.values, rel=0.1)


def test_a_gross_error_of_one_row_is_no_wrong_certificate() -> None:
    bar, seen = measured(0, {})
    touched = seen.axis_positions.copy()
    touched[7] += [0.0, 0.4, 0.0]
    found = fixed_order(bar.artefact, replace(seen, axis_positions=touched))
    assert found.rejected == ((int(seen.position[7]), int(seen.ball[7]), 0),)
    assert found.free_balls == ()
    assert gate(found).passed


@pytest.mark.parametrize("seed", SEEDS)
def test_with_the_ball_uncertified_the_result_is_as_good_as_predicted(seed: int) -> None:
    right, found = scored(seed, {}), scored(seed, {END: (20.0, 0.0, 0.0)}, uncertified=(END,))
    assert found.ratio < 1.2
    assert found.after_um < 1.1 * right.after_um
    assert right.predicted_um <= found.predicted_um < 1.1 * right.predicted_um
    assert gate(found.estimate).passed
    check = found.estimate.certificate_check[END]
    assert not check.certified
    assert 1e3 * np.array(check.apparent_error_mm) == pytest.approx([20.0, 0.0, 0.0], abs=4.0)


def run_identify(folder: Path, errors_um: dict[int, Vector], additions: str = "", *more: str) -> Result:
    bar, seen = measured(0, errors_um)
    (folder / "balls.csv").write_text(ball_text(rows_of(seen, 0, per_station=len(S3))), encoding="utf-8")
    (folder / "artefact.toml").write_text(artefact_text(bar) + additions, encoding="utf-8")
    files = [str(folder / "balls.csv"), "--machine", str(MACHINE_FILE), "--artefact", str(folder / "artefact.toml")]
    options = ["--out", str(folder / "out"), "--order", "6", "--even-so", "--json"]
    return volcal("identify", *files, *options, *more, exit_code=None)


def certificate_of(result: Result) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = json.loads(result.stdout)["certificate"]
    return found


def test_identify_reports_the_contradiction(tmp_path: Path) -> None:
    result = run_identify(tmp_path, {END: (20.0, 0.0, 0.0)})
    assert json.loads(result.stdout)["gates"]["certificate"] is False
    row = certificate_of(result)[END]
    assert row["contradiction"] > 15.0
    assert row["direction"] == "X"
    assert row["certified"] is True
    stored = json.loads((tmp_path / "out" / "estimate.json").read_text(encoding="utf-8"))
    assert stored["certificate"] == certificate_of(result)
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert f"ball {END} contradicts its certificate along" in page


def test_identify_with_the_ball_uncertified(tmp_path: Path) -> None:
    result = run_identify(tmp_path, {END: (20.0, 0.0, 0.0)}, f"uncertified_balls = [{END}]\n")
    assert json.loads(result.stdout)["gates"]["certificate"] is True
    row = certificate_of(result)[END]
    assert row["certified"] is False
    assert row["apparent_error_um"] == pytest.approx([20.0, 0.0, 0.0], abs=4.0)
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert f"uncertified balls: {END}" in page
    assert f"Ball {END}, uncertified" in page
    assert "scale error of all certified lengths" in page


def test_a_reference_length_that_contradicts_the_certificate_is_refused(tmp_path: Path) -> None:
    """All lengths of the certificate are 13 ppm too short, which the balls alone cannot show."""
    bar, _ = measured(0, {})
    distance = float(np.linalg.norm(bar.certified[END] - bar.certified[0])) * (1.0 + 13e-6)
    length = f"[[reference_lengths]]\nballs = [0, {END}]\nlength_mm = {distance:.6f}\nstandard_uncertainty_um = 1.0\n"
    refused = run_identify(tmp_path, {}, length)
    assert refused.exit_code == 2
    assert "reference length of balls 0 and 10" in refused.stderr
    assert "length_standard_uncertainty_ppm" in refused.stderr
    assert not (tmp_path / "out" / "table.csv").exists()
    accepted = run_identify(tmp_path, {}, "length_standard_uncertainty_ppm = 20.0\n" + length, "--no-report")
    assert accepted.exit_code == 0, accepted.stderr


@pytest.mark.parametrize("seed", range(2))
def test_a_reference_length_corrects_a_certificate_with_a_wrong_scale(seed: int) -> None:
    bar, _ = measured(seed, {})
    machine = foreign_machine(np.random.default_rng(seed))
    longer = replace(bar, true=bar.true * (1.0 + 13e-6))
    seen = measure(machine, longer, S3, np.random.default_rng(seed + 100)).seen
    distance = float(np.linalg.norm(longer.true[END] - longer.true[0]))
    additions = (
        "length_standard_uncertainty_ppm = 20.0\n"
        f"[[reference_lengths]]\nballs = [0, {END}]\nlength_mm = {distance:.6f}\nstandard_uncertainty_um = 1.0\n"
    )
    artefact = parse_artefact(artefact_text(bar) + additions, "artefact.toml")
    corrected, before = score(machine, bar, seen, artefact=artefact), score(machine, bar, seen)
    assert before.ratio > 2.0  # nothing shows it
    assert gate(before.estimate).passed
    assert corrected.ratio < 1.25
