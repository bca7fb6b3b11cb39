"""`volcal design artefact` as people run it: files that `volcal plan` takes, and one line for every wrong input."""

from __future__ import annotations

from pathlib import Path

import pytest
from volcal_command import refused, volcal_json

from agent.planning.design.artefact_costs import SHIPPED_COSTS

COMMAND = ("design", "artefact", "--case", "case-study")
FEW = (
    *("--length-mm", "1500", "--stations", "2", "--centre", "beside:120", "--height-mm", "750", "--across-mm", "1000"),
    *("--spacing", "even", "--theta-deg", "15", "--grid-deg", "45", "--screening-grid-deg", "90", "--finalists", "1"),
)


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def test_the_design_is_one_that_plan_takes_and_values_alike():
    said = volcal_json(*COMMAND, *FEW, "--slot", "24min", "--budget", "9000", "--balls", "5,11", "--out", "bar")
    best = said["best"]
    assert {Path(path).parent.name for path in said["files"]} == {"bar"}
    assert best["machine_minutes"] <= 24.0
    assert best["purchase_euro"] == pytest.approx(sum(best["purchase_by_part"].values()), abs=0.03)
    assert best["purchase_euro"] <= 9000.0
    gained_um = said["expected_ve_um"] - best["expected_vce_um"]
    assert best["gain_um_per_minute"] == pytest.approx(gained_um / best["machine_minutes"], rel=1e-4)
    assert said["present"]["balls"] == 11
    assert [one["balls"] for one in said["changes"]] == [11 if best["balls"] == 5 else 5]
    plan = volcal_json("plan", "--config", "bar/settings.toml", exit_code=None)
    assert plan["machine_minutes"] == best["machine_minutes"]
    # preflight fits know the radius from the qualification, so their centres are a little better than planned
    assert plan["predicted_vce_um"] == pytest.approx(best["expected_vce_um"], rel=1e-2)


def changed_costs(former: str, now: str) -> str:
    text = SHIPPED_COSTS.read_text()
    assert former in text
    Path("costs.toml").write_text(text.replace(former, now, 1))
    return "costs.toml"


def test_wrong_input_is_refused_in_one_line():
    slot, budget = ("--slot", "24min"), ("--budget", "9000")
    bad = changed_costs("euro_per_mm = 0.40", 'euro_per_mm = "cheap"')
    for arguments, code, words in [
        ((*slot, *budget, "--costs", bad), 2, ("bar.euro_per_mm", "costs.toml")),
        ((*slot, *budget, "--costs", "none.toml"), 2, ("there is no such file", "none.toml")),
        ((*slot, "--budget", "100", *FEW), 2, ("100 € are too little", "cheapest", "raise the budget")),
        ((*slot, "--budget", "-5"), 2, ("above zero",)),
        (("--slot", "2min", *budget, *FEW, "--balls", "5"), 2, ("2 min", "too short", "allow a longer slot")),
        (("--slot", "soon", *budget), 2, ("15min",)),
        ((*slot, *budget, "--centre", "under:100"), 2, ("under:100", "beside:120")),
        ((*slot, *budget, "--spacing", "odd"), 2, ("odd", "even, graded")),
        ((*slot, *budget, "--balls", "2"), 2, ("2 is not between 3 and 99", "--balls")),
        ((*slot, *budget, "--ball-places", "0,300,200"), 2, ("do not begin with 0 and rise", "--ball-places")),
        ((*slot, *budget, "--length-mm", "long"), 2, ("separated by commas",)),
        ((*slot, *budget, "--ball-places", "0,200,500", "--balls", "4"), 2, ("--ball-places", "leave out")),
        ((*slot, *budget, "--grid-deg", "40"), 2, ("40° does not divide 90°", "--grid-deg")),
        ((*slot, *budget, "--screening-grid-deg", "0"), 2, ("0° does not divide 90°", "--screening-grid-deg")),
        ((*slot, *budget, "--grid-deg", "1e-6"), 2, ("1e-06° is less than 2.5°", "--grid-deg")),
        (
            (*slot, *budget, "--ball-places", "0,5,300", "--theta-deg", "0"),
            2,
            ("less than their diameter", "25 mm", "--ball-places"),
        ),
        ((*slot, *budget, "--out", "costs.toml"), 2, ("a directory is needed", "costs.toml")),
        ((*slot, "--budget", "inf"), 2, ("finite",)),
        (slot, 2, ("--budget",)),
    ]:
        found = refused(*COMMAND, *arguments)
        assert found[0] == code, found
        assert all(word in found[1] for word in words), found


def test_without_settings_it_says_what_to_do():
    code, line = refused("design", "artefact", "--slot", "24min", "--budget", "9000")
    assert code == 2
    assert "--case case-study" in line


def test_the_case_may_stand_before_the_command():
    code, line = refused("design", "--case", "case-study", "artefact", "--slot", "24min", "--budget", "1", *FEW)
    assert code == 2
    assert "1 € are too little" in line
