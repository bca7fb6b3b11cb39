"""The settings as keys with their values: what stands in the file, what a run had, and no secrets."""

from __future__ import annotations

from pathlib import Path

import pytest

from agent.settings.listing import REMOVED, setting_rows, without_secrets
from agent.settings.load import read_settings

CASE_STUDY = Path(__file__).parents[3] / "config" / "case-study.toml"


def test_rows_name_the_keys_of_the_file_and_what_a_run_had() -> None:
    settings = read_settings(CASE_STUDY)
    password = settings.devices["cnc"].model_copy(update={"options": {"host": "a", "password": "b", "port": 1}})
    settings = settings.model_copy(update={"devices": {"cnc": password}})
    former = settings.model_dump(mode="json")
    former["procedure"]["touches_per_ball"] = 9
    former["procedure"]["given_up_since"] = 1
    rows = {row.key: row for row in setting_rows(settings, former)}
    assert (rows["procedure.touches_per_ball"].now, rows["procedure.touches_per_ball"].in_run) == (5, 9)
    assert (rows["procedure.given_up_since"].now, rows["procedure.given_up_since"].in_run) == (None, 1)
    assert rows["devices.cnc.options.password"].now == rows["devices.cnc.options.password"].in_run == REMOVED
    assert rows["devices.cnc.options.host"].now == "a"
    assert rows["machine"].stated
    assert not rows["procedure.recentre_mm"].stated
    assert all(row.in_run is None for row in setting_rows(settings, None))


@pytest.mark.parametrize(
    ("address", "shown"),
    [
        ("https://hooks.plant.example/T0/B1/x9", f"https://hooks.plant.example/{REMOVED}"),
        ("https://hooks.plant.example?key=x9", f"https://hooks.plant.example/{REMOVED}"),
        ("postgresql://volcal:x9@db.example:5432/runs", f"postgresql://db.example:5432/{REMOVED}"),
        ("mqtt://broker.example:1883", "mqtt://broker.example:1883"),
    ],
)
def test_of_an_address_only_scheme_and_host_are_shown(address: str, shown: str) -> None:
    assert without_secrets({"notifications": [{"to": address}]}) == {"notifications": [{"to": shown}]}
