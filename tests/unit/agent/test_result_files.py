"""Which files beside a new estimate an identification may delete."""

from __future__ import annotations

from pathlib import Path

import pytest

from agent.runs.result_files import replaced_results

NAMES = ("report.html", "table.csv", "artefact.toml", "artefact-covariance.csv")


def estimate_of(folder: Path, run_id: str) -> None:
    text = f'{{\n"format": "volcal estimate 3",\n"provenance": {{\n"run_id": "{run_id}",\n"time": ""\n}}\n}}\n'
    (folder / "estimate.json").write_text(text, encoding="utf-8")


def test_results_of_an_earlier_identification_are_replaced(tmp_path: Path) -> None:
    estimate_of(tmp_path, "identify-20261130T055437Z")
    assert replaced_results(tmp_path, NAMES, [Path("elsewhere") / "report.csv"]) == NAMES


@pytest.mark.parametrize("run_id", [None, "20261130-055437"])
def test_a_report_that_no_identification_wrote_is_kept(tmp_path: Path, run_id: str | None) -> None:
    if run_id is not None:
        estimate_of(tmp_path, run_id)
    assert replaced_results(tmp_path, NAMES, []) == ()
    assert replaced_results(tmp_path / "absent", NAMES, []) == ()


def test_inputs_in_the_same_folder_are_kept(tmp_path: Path) -> None:
    estimate_of(tmp_path, "identify-20261130T055437Z")
    assert replaced_results(tmp_path, NAMES, [tmp_path / "artefact.toml"]) == ("report.html", "table.csv")
