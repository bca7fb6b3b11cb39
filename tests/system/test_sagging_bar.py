"""A bar that hangs lower than its file says: the real command over real links."""

from __future__ import annotations

from pathlib import Path

import pytest
from simulated import CONFIG, configured, scenario_text, simulated
from volcal_command import volcal_json

SAG_UM = 20.0
BAR = CONFIG / "artefacts" / "ball-bar-1500.toml"
STIFF = "sag_um = 0.0\n"


def test_an_unstated_sag_is_estimated_and_the_table_is_proved(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    text = BAR.read_text(encoding="utf-8")
    assert STIFF in text
    (tmp_path / "true.toml").write_text(text.replace(STIFF, f"sag_um = {SAG_UM}\n"))
    (tmp_path / "stated.toml").write_text(text.replace(STIFF, ""))
    scenario = tmp_path / "scenario.toml"
    scenario.write_text(scenario_text().replace(str(BAR), str(tmp_path / "true.toml")))
    with simulated(scenario) as (_, ready):
        config = configured(ready, tmp_path)
        config.write_text(config.read_text().replace(str(BAR), str(tmp_path / "stated.toml")))
        found = volcal_json("calibrate", "--config", config, "--stations", "1,2")
    assert found["state"] == "complete"
    assert found["shift_pattern"]["false_alarm"] > 0.01
    [shift] = found["ball_shifts"]
    assert shift["name"] == "sag"
    assert shift["size_um"] == pytest.approx(SAG_UM, abs=4.0 * shift["standard_uncertainty_um"])
    assert shift["standard_uncertainty_um"] < 2.0
