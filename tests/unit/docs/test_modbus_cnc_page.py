"""The page of the Modbus driver names every setting, with the default that it has."""

from __future__ import annotations

from pathlib import Path

import pytest

from drivers.modbus_cnc.settings import BlockAddresses, ModbusCncSettings

PAGE = (Path(__file__).resolve().parents[3] / "docs" / "reference" / "modbus-cnc.md").read_text(encoding="utf-8")
ROWS = {row.split("|")[1].strip(" `"): row.split("|")[2].strip() for row in PAGE.splitlines() if row.startswith("| `")}


@pytest.mark.parametrize("key", ModbusCncSettings.model_fields)
def test_setting_has_its_row_with_its_default(key: str) -> None:
    default = ModbusCncSettings.model_fields[key].default
    if isinstance(default, BlockAddresses):
        assert all(f"`{name}` {first}" in PAGE for name, first in default)
    elif isinstance(default, tuple):
        assert ROWS[key] == ", ".join(default)
    elif isinstance(default, bool):
        assert ROWS[key] == str(default).lower()
    elif isinstance(default, (int, float)):
        assert float(ROWS[key]) == default
    else:
        assert ROWS[key] == str(default or "none").lower()
