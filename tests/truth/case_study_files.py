"""Files of the shipped case study that measurements on foreign machines use."""

from __future__ import annotations

import re
from pathlib import Path

CONFIG = Path(__file__).resolve().parents[2] / "config"
MACHINE_FILE = CONFIG / "machines" / "case-study.toml"


def settings_text(uncertainty_k: float | None) -> str:
    """Return the settings of the case study with this uncertainty of the thermometer, or without any."""
    text = (CONFIG / "case-study.toml").read_text(encoding="utf-8")
    stated = "" if uncertainty_k is None else f"[temperature]\nstandard_uncertainty_k = {uncertainty_k}\n"
    changed, count = re.subn(r"\[temperature\]\nstandard_uncertainty_k[^\n]*\n", stated, text)
    assert count == 1
    return changed
