"""Which files beside a new estimate an identification may delete."""

from __future__ import annotations

from pathlib import Path

import pytest

from agent.runs.result_files import check_inputs_kept, replaced_results
from drivers.errors import InputError

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


def test_a_result_that_would_replace_what_is_read_is_refused(tmp_path: Path) -> None:
    (tmp_path / "link.toml").symlink_to(tmp_path / "artefact.toml")
    for read in (tmp_path / "artefact.toml", tmp_path / "x" / ".." / "artefact.toml", tmp_path / "link.toml"):
        with pytest.raises(InputError, match="a result would replace this file") as refused:
            check_inputs_kept(tmp_path, NAMES, [tmp_path / "balls.csv", read])
        assert refused.value.where["file"] == str(tmp_path / "artefact.toml")
    check_inputs_kept(tmp_path, NAMES, [tmp_path / "balls.csv", tmp_path / "x" / "artefact.toml"])
