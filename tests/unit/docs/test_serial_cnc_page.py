"""The page of the serial CNC names every setting, with the default that it has."""

from __future__ import annotations

from pathlib import Path

import pytest

from drivers.serial_cnc.codes import POSITION_KEPT
from drivers.serial_cnc.settings import BankSettings, SerialCncSettings

PAGE = (Path(__file__).resolve().parents[3] / "docs" / "reference" / "serial-cnc.md").read_text(encoding="utf-8")
ROWS = [line for line in PAGE.splitlines() if line.startswith("| `")]
KEYS = [name for name in SerialCncSettings.model_fields if name != "banks"]


@pytest.mark.parametrize("key", [*KEYS, *(f"banks.{name}" for name in BankSettings.model_fields)])
def test_setting_has_its_row_with_its_default(key: str) -> None:
    [row] = [row for row in ROWS if f"`{key}`" in row.split("|")[1]]
    model = BankSettings if key.startswith("banks.") else SerialCncSettings
    field = model.model_fields[key.removeprefix("banks.")]
    names = [name.strip().strip("`") for name in row.split("|")[1].split(",")]
    shown = [part.strip().strip("`") for part in row.split("|")[2].split(",")]
    if field.is_required() or field.default_factory is not None or isinstance(field.default, tuple):
        return
    told = shown[names.index(key)]
    assert told in {str(field.default), str(field.default).lower()} or float(told) == field.default


def test_alarms_that_keep_the_position_are_the_ones_listed() -> None:
    listed = ", ".join(str(code) for code in sorted(POSITION_KEPT))
    assert f"| alarms {listed} |" in PAGE
