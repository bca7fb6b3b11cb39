"""Most helpful action against a value that reaches its tolerance: that of `volcal actions`, or why there is none."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from journaled import journaled, run_id
from service_house import settings_document

import volcal
from agent.cli.main import main
from agent.history.cached_trends import CachedTrends
from agent.history.helpful_actions import changes_error
from agent.service.page.trends import TrendCache
from agent.settings.schema import Settings
from agent.workpiece.proposed_actions import propose_actions

NIGHTS = 14
TOLERANCES = {
    "ve_bare_tolerance_um": 13.0,
    "ve_tolerance_um": 12.0,
    "parameter_tolerances": {"EXX": 7.0, "EXX[2]": 9.0},
}


@pytest.fixture(scope="module")
def identified(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Estimate file of the machine of the case study."""
    setup, path = volcal.case_study(), tmp_path_factory.mktemp("identified") / "estimate.json"
    balls = volcal.read_balls(volcal.shipped_file("examples/case-study-balls.csv"), setup.machine)
    volcal.write_estimate(volcal.identify(balls, setup.machine, setup.artefact, order=3), path)
    return path


def document(state: Path, estimate: Path | None, machine: Path | None = None) -> Mapping[str, Any]:
    """Return the page's trends of a machine of which VE, VCE and EXX grow until they are soon at their tolerances."""
    settings = grown(state)
    if estimate is not None:
        give(state, estimate)
    if machine is not None:
        settings = settings.model_copy(update={"machine": machine})
    return TrendCache(CachedTrends()).document(settings, None)


def give(state: Path, estimate: Path) -> None:
    """Write the estimate of one of the last runs."""
    folder = state / run_id(NIGHTS - 2)
    folder.mkdir(exist_ok=True)
    shutil.copy(estimate, folder / "estimate.json")


def grown(state: Path) -> Settings:
    """Write the runs of the machine, and return its settings."""
    rng = np.random.default_rng(3)
    for night in range(NIGHTS):
        exx_um, ve_um = 4.0 + 0.18 * night + 0.1 * rng.normal(), 10.0 + 0.18 * night + 0.1 * rng.normal()
        journaled(state, night, exx_um, machine="mine", ve_um=ve_um)
    return Settings.model_validate(settings_document(state, history={"machine": "mine", **TOLERANCES}))


def hint(shown: Mapping[str, Any]) -> str:
    """Return what the alarm of the VE without a table says."""
    [found] = [alarm["hint"] for alarm in shown["alarms"] if (alarm["series"], alarm["kind"]) == ("ve_bare", "trend")]
    return str(found)


def test_the_action_is_that_of_the_command(tmp_path: Path, identified: Path) -> None:
    shown = document(tmp_path, identified)
    trends = {trend["name"]: trend for trend in shown["trends"]}
    proposed = propose_actions(identified, 5, None).as_json()
    first = proposed["actions"][0]
    found = trends["ve_bare"]["action"]
    assert (found["action"], found["run"]) == (first, run_id(NIGHTS - 2))
    assert (found["ve_before_um"], found["ve_after_um"]) == (
        proposed["ve_before"]["expected_um"], first["ve_after"]["expected_um"],
    )  # fmt: skip
    assert found["ve_after_um"] < found["ve_before_um"]
    scales = [one for one in proposed["actions"] if (one["kind"], one["axis"]) == ("scale", "X")]
    assert trends["EXX"]["action"]["action"] == (scales[0] if scales else None)
    hints = {alarm["series"]: alarm["hint"] for alarm in shown["alarms"] if alarm["kind"] == "trend"}
    assert hints["ve_bare"] == found["text"]
    assert hints["ve_bare"].startswith(f"what helps most: {first['text']} (VE without table ")
    assert trends["A0Z"]["action"] is None
    (limit,) = (alarm for alarm in shown["alarms"] if alarm["kind"] == "limit")
    assert (limit["series"], limit["hint"]) == ("ve_acting", "calibrate anew: the table no longer fits the machine")


def test_without_an_estimate_it_is_said(tmp_path: Path) -> None:
    shown = document(tmp_path, None)
    hints = {alarm["series"]: alarm["hint"] for alarm in shown["alarms"] if alarm["kind"] == "trend"}
    assert "no run with an estimate is in the state directory" in hints["EXX"]


def test_an_estimate_that_is_written_later_is_seen(tmp_path: Path, identified: Path) -> None:
    settings, trends = grown(tmp_path), TrendCache(CachedTrends())
    assert "no run with an estimate" in hint(trends.document(settings, None))
    give(tmp_path, identified)
    helps = hint(trends.document(settings, None))
    assert helps.startswith("what helps most: ")
    assert hint(TrendCache(CachedTrends()).document(settings, None)) == helps  # after a restart
    (tmp_path / run_id(NIGHTS - 2) / "estimate.json").write_text("{}")
    assert hint(trends.document(settings, None)).startswith("no mechanical action can be proposed: ")


def test_the_guides_of_the_machine_file_count(tmp_path: Path, identified: Path) -> None:
    """A rail of X that lies 30 µm higher in the middle is shimmed if the distance of its shoes is known."""
    bent = json.loads(identified.read_text(encoding="utf-8"))
    for one in bent["parameters"]:
        one["value"] += {"EZX[2]": -20e-3, "EBX[1]": 3.0 * 20e-3 / 2000.0}.get(one["name"], 0.0)
    estimate, machine = tmp_path / "bent.json", tmp_path / "machine.toml"
    estimate.write_text(json.dumps(bent), encoding="utf-8")
    shipped = volcal.shipped_file("machines/case-study.toml")
    machine.write_text(
        shipped.read_text(encoding="utf-8").replace('grid = "', f'grid = "{shipped.parent}/')
        + "\n[axes.X.guide]\nshoes_mm = 600.0\ncentre_mm = [0.0, -500.0, -400.0]\n",
        encoding="utf-8",
    )
    (tmp_path / "plain").mkdir()
    (tmp_path / "known").mkdir()
    shimmed = "what helps most: straighten the guide of X"
    assert not hint(document(tmp_path / "plain", estimate)).startswith(shimmed)
    assert hint(document(tmp_path / "known", estimate, machine)).startswith(shimmed)


def test_a_damaged_estimate_is_told_and_the_trends_are_shown(tmp_path: Path) -> None:
    damaged = tmp_path / "damaged.json"
    damaged.write_text("{}")
    state = tmp_path / "state"
    state.mkdir()
    shown = document(state, damaged)
    hints = {alarm["series"]: alarm["hint"] for alarm in shown["alarms"] if alarm["kind"] == "trend"}
    assert hints["EXX"].startswith("no mechanical action can be proposed: ")


def test_the_forecast_of_the_page_is_that_of_the_command(tmp_path: Path, identified: Path) -> None:
    shown = {trend["name"]: trend for trend in document(tmp_path, identified)["trends"]}
    text = json.dumps(settings_document(tmp_path, history={"machine": "mine", **TOLERANCES}))
    forecast = shown["EXX"]["forecast"]
    low, middle, high = forecast["dates"]
    assert "2026-11-14" <= low <= middle <= high
    assert forecast["warn_nights"] == 14
    assert 0.5 <= forecast["probability"] <= 1.0
    assert len({len(values) for values in forecast["course"].values()}) == 1
    assert shown["A0Z"]["forecast"] is None
    config = tmp_path / "volcal.toml"
    config.write_text(_toml(json.loads(text)))
    result = CliRunner().invoke(main, ["history", "trend", "--config", str(config), "--json"])
    assert result.exit_code == 4, result.output
    printed = json.loads(result.stdout)
    assert {trend["name"]: trend for trend in printed["trends"]}["EXX"]["forecast"] == forecast
    assert re.search(f"about {middle} .*what helps most", result.stderr, re.DOTALL)


def _toml(document: Mapping[str, Any]) -> str:
    """Return a settings document as TOML; numbers and texts look as in JSON, tables are inline."""

    def text(value: Any) -> str:
        if isinstance(value, Mapping):
            return "{" + ", ".join(f'"{key}" = {text(one)}' for key, one in value.items()) + "}"
        return "[" + ", ".join(map(text, value)) + "]" if isinstance(value, list) else json.dumps(value)

    return "".join(f"{key} = {text(value)}\n" for key, value in document.items())


@pytest.mark.parametrize(
    ("kind", "axis", "towards", "changed"),
    [
        ("scale", "X", "X", {"EXX", "EXX[1]"}),
        ("squareness", "Z", "X", {"B0Z"}),
        ("squareness", "Y", "X", {"C0Y"}),
        ("squareness", "Z", "Y", {"A0Z"}),
        ("straightness", "X", "Y", {"EYX", "EYX[2]", "ECX", "ECX[1]"}),
        ("straightness", "X", "Z", {"EBX"}),
        ("level", "X", "X", {"EAX", "EAX[1]"}),
    ],
)
def test_which_errors_an_action_changes(kind: str, axis: str, towards: str, changed: set[str]) -> None:
    names = (
        "EXX",
        "EXX[1]",
        "EXX[2]",
        "EYY",
        "A0Z",
        "B0Z",
        "C0Y",
        "EYX",
        "EYX[0]",
        "EYX[2]",
        "EYX[9]",
        "EXY",
        "EAX",
        "EAX[1]",
        "EAX[3]",
        "EBX",
        "ECX",
        "ECX[0]",
        "ECX[1]",
        "held_out",
    )
    action = {"kind": kind, "axis": axis, "towards": towards}
    assert {name for name in names if changes_error(action, name)} == changed
