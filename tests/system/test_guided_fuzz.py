"""The search along branches finds a defect that mutations alone would not find, and says where it is."""

from __future__ import annotations

from campaign_command import run_campaign


def test_a_defect_behind_four_comparisons_is_found() -> None:
    code, found = run_campaign("fuzz.guided", "--factory", "campaigns.fuzz.planted:decoders", "--seconds", "600")
    planted, good = found["decoders"]["planted"], found["decoders"]["good"]
    assert "KeyError: 'planted'" in planted["failure"]
    assert "planted.py" in planted["failure"]
    assert good["failure"] == ""
    assert (code, found["passed"]) == (1, False)
