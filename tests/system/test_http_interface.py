"""The small form of `python -m campaigns.http_interface`."""

from __future__ import annotations

from campaign_command import run_campaign


def test_every_response_is_one_that_the_document_states() -> None:
    code, found = run_campaign("http_interface", "--examples", "3")
    assert found["listed"] == []
    assert (code, found["exit_code"], found["collisions"]) == (0, 0, 0)
    assert found["operations"] > 20
    assert found["requests"] > 200
    assert {"200", "202", "401", "404", "422"} <= set(found["answers"])
