"""The first run on a machine: one ball, over the real links and in this process; nothing is written."""

from __future__ import annotations

import json
import subprocess
import tomllib
from pathlib import Path
from typing import Any

import pytest
from nights import SCENARIO, Night, short_document
from simulated import COMMAND, ROOT, configured, scenario_text, simulated

from agent.errors import MeasurementFault
from agent.execution.journal_reader import open_journal
from agent.execution.states import RunState
from agent.runs.kinds.trial import OneBallTrial, with_checks
from agent.runs.session import RunResult
from agent.runs.unfinished_run import unfinished_run
from agent.settings.schema import Settings

WIDE = dict.fromkeys(("form_limit_um", "touch_limit_um", "pole_limit_um", "radius_limit_um"), 300.0)


def scenario(**sections: Any) -> dict[str, Any]:
    """The shipped scenario as options of the device in this process."""
    document = tomllib.loads(SCENARIO.read_text())
    document |= {name: str(SCENARIO.parent / document[name]) for name in ("machine", "artefact")}
    return {**document, **{name: {**document.get(name, {}), **values} for name, values in sections.items()}}


def called(*arguments: str) -> subprocess.CompletedProcess[str]:
    command = [*COMMAND, *arguments]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=600.0, check=False)


def tried(state: Path, night: Night, **sections: Any) -> RunResult:
    devices = {"twin": {"driver": "simulated", "options": scenario(**sections.pop("scenario", {}))}}
    document = with_checks(Settings.model_validate(short_document(state, devices=devices, **sections)))
    return night.run(document.model_dump(), files=False, kind=OneBallTrial())


def test_the_real_command_measures_one_ball_and_finds_a_late_latch(tmp_path: Path) -> None:
    late = tmp_path / "late.toml"
    late.write_text(scenario_text().replace("[trigger]", "[trigger]\nlatch_delay_ms = 2.0"))
    with simulated(late) as (_, ready):
        config = configured(ready, tmp_path)
        done, told = (called("try", "--config", str(config), *more) for more in (["--json"], []))
    assert (done.returncode, told.returncode) == (0, 0), done.stderr + told.stderr
    outcome = json.loads(done.stdout)
    assert (outcome["kind"], outcome["state"], outcome["table_bank"]) == ("try", "complete", 0)
    assert (outcome["estimated_ve_um"], outcome["verified"], outcome["night"]) == (None, None, None)
    trial = outcome["trial"]
    # five touches each at 300 and 75 mm/min: the standard uncertainty is 0.2 ms
    assert trial["latch_delay_ms"] == pytest.approx(2.0, abs=0.8)
    assert "ms after the trip" in trial["warnings"][0]
    assert set(trial["checks"]) == {"Repeatability", "Delay of the latch", "Stylus", "Reversal of the axes"}
    assert trial["offset_mm"] == pytest.approx(
        [found - expected for found, expected in zip(trial["found_mm"], trial["expected_mm"], strict=True)]
    )
    assert max(map(abs, trial["offset_mm"])) < 2.0
    page = Path(outcome["report"]).read_text()
    assert "Trial of one ball" in page
    assert "mm beside its expected place" in page
    for words in (
        "station 2, azimuth",
        "found beside it",
        "delay of the latch",
        "none, as before",
        "\nwarning: The axis",
    ):
        assert words in told.stdout, told.stdout


def test_a_latch_a_cycle_of_the_controller_late_is_named_and_not_a_lost_ball(state: Path) -> None:
    done = tried(state, Night(), scenario={"trigger": {"latch_delay_ms": 60.0}})
    assert done.outcome.state is RunState.FAULTED
    assert "appears too small" in str(done.error)
    assert "latches the axis positions" in str(done.error)
    assert "in the PLC program" in str(done.error)


def test_a_trial_writes_nothing_and_is_not_left_unfinished(state: Path) -> None:
    night = Night()
    done = tried(state, night)
    assert done.error is None
    assert done.outcome.state is RunState.COMPLETE
    assert done.outcome.trial is not None
    assert done.outcome.trial.warnings == ()
    assert abs(done.outcome.trial.latch_delay_ms or 9.0) < 0.8
    assert night.world is not None
    assert night.world.collisions == []
    assert (night.world.controller.banks, night.world.controller.active_bank) == ({}, 0)
    assert unfinished_run(state) is None
    with open_journal(state) as reader:
        run = reader.last_run()
        assert run is not None
        assert reader.count_balls(run.run) == 0


def test_a_ball_far_from_its_place_is_found_and_the_place_to_be_corrected_is_named(state: Path) -> None:
    """The mount stands 5 mm beside the place in the settings."""
    places = [[705.0, 1000.0, 750.0], [1567.0, 1000.0, 750.0], [2433.0, 1000.0, 750.0], [3300.0, 1000.0, 750.0]]
    done = tried(state, Night(), stations={"places_mm": places})
    assert done.outcome.state is RunState.COMPLETE
    assert done.outcome.trial is not None
    assert done.outcome.trial.offset_mm[0] == pytest.approx(-5.0, abs=0.9)
    (warning,) = done.outcome.trial.warnings
    assert "Correct the place of station 1 in `stations.places_mm`" in warning


def test_a_probe_that_does_not_repeat_ends_the_trial_and_the_axes_are_withdrawn(state: Path) -> None:
    night = Night()
    done = tried(state, night, scenario={"trigger": {"touch_sigma_um": 15.0}}, procedure=WIDE)
    assert isinstance(done.error, MeasurementFault)
    assert "does not repeat" in str(done.error)
    assert night.world is not None
    assert night.world.collisions == []
    assert night.world.controller.displayed_position()[1] == pytest.approx(night.world.controller.limits().lower_mm[1])
