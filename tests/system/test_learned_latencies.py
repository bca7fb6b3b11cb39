"""A controller and a person that take longer than the settings state, over the simulated machine's real links."""

import json
from pathlib import Path

import pytest
from volcal_command import volcal, volcal_json

from agent.execution.run_record import read_record
from agent.results.decision_kinds import OUTCOME

CONFIG = Path(__file__).resolve().parents[2] / "config"


def test_a_run_says_what_made_it_longer_and_the_next_plan_knows(tmp_path: Path) -> None:
    text = (CONFIG / "hand-placed.toml").read_text(encoding="utf-8")
    for given, hasty in (
        ("touch_latency_s = 0.079", "touch_latency_s = 0.0"),
        ("relocation_minutes = 2.0", "relocation_minutes = 1.0"),
        ("[procedure]\n", "[procedure]\ntouches_per_ball = 5\n"),
        ('state_directory = "../runs"', f'state_directory = "{tmp_path}/runs"'),
        ('"machines/', f'"{CONFIG}/machines/'),
        ('"artefacts/', f'"{CONFIG}/artefacts/'),
        ('"hand-placed-positions.csv"', f'"{CONFIG}/hand-placed-positions.csv"'),
    ):
        assert given in text
        text = text.replace(given, hasty)
    hasty_settings = tmp_path / "settings.toml"
    hasty_settings.write_text(text, encoding="utf-8")

    planned = volcal_json("plan", "--config", hasty_settings)
    assert planned["latencies_from_run"] is None
    case = ("--case", "hand-placed", "--config", hasty_settings, "--out", tmp_path / "runs")
    said = volcal_json("demo", *case)
    told = said["run_time"]
    assert told["forecast_minutes"] == pytest.approx(planned["machine_minutes"], abs=0.01)
    assert told["minutes"] == said["machine_minutes"] > 1.2 * told["forecast_minutes"]
    learned = {one["kind"]: one["learned_s"] for one in told["latencies"]}
    assert learned["AskOperator"] == pytest.approx(120.0, rel=0.01)
    assert 0.001 < learned["TouchTowards"] < 0.12
    explained = sum(one["count"] * (one["learned_s"] - one["forecast_s"]) for one in told["latencies"]) / 60.0
    assert told["forecast_minutes"] + explained == pytest.approx(told["minutes"], rel=0.02)
    stored = read_record(tmp_path / "runs", said["run_id"]).decision(OUTCOME)
    assert stored is not None
    assert stored["run_time"] == json.loads(json.dumps(told))

    again = volcal_json("plan", "--config", hasty_settings)
    assert again["latencies_from_run"] == said["run_id"]
    assert again["machine_minutes"] == pytest.approx(told["minutes"], rel=0.02)
    designed = volcal_json("design", "--config", hasty_settings, "--positions", "3", "--out", tmp_path / "designed.csv")
    assert designed["latencies_from_run"] == said["run_id"]
    assert f"of run {said['run_id']}" in volcal("plan", "--config", hasty_settings).stdout
