"""Steel bars whose thermometer is wrong, or was not there."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from case_study_files import MACHINE_FILE, settings_text
from click.testing import CliRunner, Result

from agent.cli.offline_commands.identify import identify
from campaigns.foreign.artefact import S3, ForeignBar, measure, straight_bar, tilted_bar
from campaigns.foreign.files import artefact_text, ball_text, rows_of
from campaigns.foreign.machine import GRID, TOOL, ForeignMachine, foreign_machine
from campaigns.foreign.score import score, true_error_um
from twin.artefact.observations import Observations
from twin.formats.estimate_file import parse_estimate
from twin.identification import Options, predicted_vce
from twin.identification.predicted import field_forms
from twin.uncertainty.thermometer_effect import thermometer_effect
from twin.uncertainty.volumetric_distribution import aligned_distributions

WRONG_K = 2.0
SEEDS = range(3)
BARS = {"tilted": tilted_bar, "straight": lambda rng: straight_bar(rng, 0.005)}


@dataclass(frozen=True)
class Case:
    machine: ForeignMachine
    bar: ForeignBar
    seen: Observations


def case(seed: int, error_k: float, bar: str = "tilted") -> Case:
    rng = np.random.default_rng(seed)
    machine, drawn = foreign_machine(rng), BARS[bar](rng)
    return Case(machine, drawn, measure(machine, drawn, S3, rng, thermometer_error_k=error_k).seen)


def test_taken_as_exact_the_thermometer_decides_on_the_scales() -> None:
    """What the tests below guard against: 2 K of a bar of steel are 23 µm/m."""
    drawn = case(0, WRONG_K)
    found = score(drawn.machine, drawn.bar, drawn.seen, Options(temperature_standard_uncertainty_k=0.0))
    assert found.after_um > 5.0 * found.predicted_um


@pytest.mark.parametrize("bar", sorted(BARS))
@pytest.mark.parametrize("error_k", [WRONG_K, -WRONG_K])
@pytest.mark.parametrize("seed", SEEDS)
def test_an_uncertainty_that_covers_the_error_makes_the_result_true(seed: int, error_k: float, bar: str) -> None:
    drawn = case(seed, error_k, bar)
    found = score(drawn.machine, drawn.bar, drawn.seen, Options(temperature_standard_uncertainty_k=1.0))
    vce = aligned_distributions(found.estimate, GRID, TOOL).vce
    lower, upper = (1e3 * np.sqrt(vce.quantile(probability)) for probability in (0.0005, 0.975))
    assert lower < found.after_um < upper
    assert found.after_um < 0.65 * found.before_um


@pytest.mark.parametrize("weights", ["full", "unit"])
def test_the_contribution_is_what_a_known_temperature_would_save(weights: Any) -> None:
    """With fixed scales the posterior with an exact thermometer is that with its error known."""
    drawn = case(1, 0.0)
    fixed = {"estimate_scales": False, "outliers": "none", "weights": weights, "misfit_mm": 0.0}
    doubted, exact = (
        score(drawn.machine, drawn.bar, drawn.seen, Options(**fixed, temperature_standard_uncertainty_k=k)).estimate
        for k in (0.5, 0.0)
    )
    effect = thermometer_effect(doubted, field_forms(doubted, GRID, TOOL))
    assert effect.strain == pytest.approx(0.5 * 11.5e-6)
    assert effect.without.aligned_um == pytest.approx(predicted_vce(exact, GRID, TOOL).aligned_um, rel=1e-6)
    assert effect.without.raw_um == pytest.approx(predicted_vce(exact, GRID, TOOL).raw_um, rel=1e-6)
    assert effect.contribution.aligned_um > 1.0


class Desk:
    """The real command on the files of one measurement. It does not enforce the gates, and `unreported` draws no
    report."""

    def __init__(self, folder: Path, drawn: Case, **kind: bool) -> None:
        self.folder, self.drawn = folder, drawn
        (folder / "balls.csv").write_text(
            ball_text(rows_of(drawn.seen, 0, per_station=len(S3), **kind)), encoding="utf-8"
        )
        (folder / "bar.toml").write_text(artefact_text(drawn.bar), encoding="utf-8")
        self.settings(None)

    def settings(self, uncertainty_k: float | None) -> None:
        (self.folder / "volcal.toml").write_text(settings_text(uncertainty_k), encoding="utf-8")

    def run(self, *options: str, out: str = "out") -> Result:
        files = ["--machine", str(MACHINE_FILE), "--artefact", str(self.folder / "bar.toml")]
        where = ["--config", str(self.folder / "volcal.toml"), "--out", str(self.folder / out), "--even-so"]
        return CliRunner().invoke(identify, [str(self.folder / "balls.csv"), *files, *where, *options])

    def unreported(self, *options: str, out: str = "out") -> dict[str, Any]:
        return self.hurry("--no-report", *options, out=out)

    def hurry(self, *options: str, out: str = "out") -> dict[str, Any]:
        """Run with a given order, which spares the choice among seven."""
        return self.said("--order", "6", *options, out=out)

    def said(self, *options: str, out: str = "out") -> dict[str, Any]:
        done = self.run("--json", *options, out=out)
        assert done.exit_code == 0, done.output
        found: dict[str, Any] = json.loads(done.stdout)
        return found

    def after_um(self, out: str = "out") -> float:
        text = (self.folder / out / "estimate.json").read_text(encoding="utf-8")
        return true_error_um(self.drawn.machine, parse_estimate(text, "estimate.json"))

    def report(self, out: str = "out") -> str:
        return " ".join((self.folder / out / "report.html").read_text(encoding="utf-8").split())


def test_where_nothing_is_stated_one_kelvin_is_assumed_and_said(tmp_path: Path) -> None:
    desk = Desk(tmp_path, case(0, WRONG_K))
    said = desk.said()
    thermometer = said["thermometer"]
    assert (thermometer["standard_uncertainty_k"], thermometer["stated"], thermometer["was_read"]) == (1.0, False, True)
    assert thermometer["scale_um_per_m"] == pytest.approx(11.5)
    vce = np.hypot(thermometer["contribution_um"], thermometer["vce_if_known_um"])
    assert vce == pytest.approx(said["predicted_vce_um"])
    assert desk.after_um() < 1.6 * said["predicted_vce_um"]
    assert "Temperature of the artefact ±2 K (k = 2): scale ±23.0 µm/m. It contributes" in desk.report()
    assert "uncertainty of the thermometer is not stated" in desk.report()


def test_the_option_goes_before_the_settings(tmp_path: Path) -> None:
    desk = Desk(tmp_path, case(1, 0.0))
    desk.settings(0.2)
    by_settings = desk.unreported()["thermometer"]
    assert (by_settings["standard_uncertainty_k"], by_settings["stated"]) == (0.2, True)
    by_option = desk.run("--order", "6", "--temperature-uncertainty", "0.5").stdout.replace("\n", " ")
    assert "±1 K (k = 2): scale ±11.5 µm/m" in by_option
    assert "not stated" not in by_option
    assert "thermometer is not stated" not in desk.report()
    exact = desk.unreported("--temperature-uncertainty", "0")
    assert exact["thermometer"]["contribution_um"] == 0.0
    assert exact["thermometer"]["vce_if_known_um"] == pytest.approx(exact["predicted_vce_um"])


def test_a_temperature_that_was_not_read_is_not_20_degrees(tmp_path: Path) -> None:
    """The settings state a thermometer, but none was read in a hall of 24 °C."""
    rng = np.random.default_rng(2)
    machine, bar = foreign_machine(rng), tilted_bar(rng)
    desk = Desk(tmp_path, Case(machine, bar, measure(machine, bar, S3, rng, hall_c=24.0).seen), with_temperature=False)
    desk.settings(0.1)
    said = desk.said()
    thermometer = said["thermometer"]
    assert (thermometer["standard_uncertainty_k"], thermometer["stated"], thermometer["was_read"]) == (
        3.0,
        False,
        False,
    )
    assert desk.after_um() < 1.6 * said["predicted_vce_um"]
    assert "not measured: it counts as 20 °C ± 6 K (k = 2)" in desk.report()
    stated = desk.hurry("--temperature-uncertainty", "0.5")["thermometer"]
    assert (stated["standard_uncertainty_k"], stated["stated"], stated["was_read"]) == (0.5, True, False)
    assert "20 °C ± 1 K (k = 2), as stated" in desk.report()


def test_another_night_without_a_thermometer_has_an_error_of_its_own(tmp_path: Path) -> None:
    """Two nights of one machine and bar in halls of 24 and 16 °C, both of which count as 20 °C."""
    rng = np.random.default_rng(4)
    machine, bar = foreign_machine(rng), tilted_bar(rng)
    for hall_c, out in ((24.0, "first"), (16.0, "second")):
        seen = measure(machine, bar, S3, rng, hall_c=hall_c).seen
        desk = Desk(tmp_path, Case(machine, bar, seen), with_temperature=False)
        carried = [] if out == "first" else ["--carried-over", str(tmp_path / "first" / "estimate.json")]
        said = desk.unreported(*carried, out=out)
        assert said["thermometer"]["standard_uncertainty_k"] == 3.0
        assert desk.after_um(out) < 1.6 * said["predicted_vce_um"]


def test_another_thermometer_has_an_error_of_its_own(tmp_path: Path) -> None:
    """The thermometer of the first night is 2 K wrong, that of the second is a good one."""
    rng = np.random.default_rng(5)
    machine, bar = foreign_machine(rng), tilted_bar(rng)
    first = Desk(tmp_path, Case(machine, bar, measure(machine, bar, S3, rng, thermometer_error_k=WRONG_K).seen))
    first.unreported(out="first")
    second = Desk(tmp_path, Case(machine, bar, measure(machine, bar, S3, rng).seen))
    carried = ("--carried-over", str(tmp_path / "first" / "estimate.json"))
    said = second.said(*carried, "--temperature-uncertainty", "0.05", "--no-report", out="second")
    assert said["thermometer"]["contribution_um"] < 1.0
    assert second.after_um("second") < 1.3 * said["predicted_vce_um"]
