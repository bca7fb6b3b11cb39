"""Gates of runs of an earlier version, which limited contradictions in standard deviations."""

from __future__ import annotations

from typing import Any

import pytest

from agent.execution.stored_gates import gate_records
from agent.language.sentences import german

LARGEST = "largest contradiction of a ball with its certificate, in standard deviations: ball 3"
WRONG = (
    "ball 3 contradicts its certificate by 9 standard deviations along X (artefact frame; apparent error X 1.0, Y 2.0, "
    "Z 3.0 µm): clean and calibrate, or state uncertified_balls = [3] in the artefact file"
)
FIT = {"name": "fit", "passed": True, "value": 1.2, "limit": 2.0, "text": "normalised χ²"}


def certificate(value: float, limit: float, text: str) -> dict[str, Any]:
    return {"name": "certificate", "passed": value <= limit, "value": value, "limit": limit, "text": text}


def test_earlier_runs_state_the_score_that_the_title_names() -> None:
    settings = {"gates": {"max_certificate_sigma": 5.0}}
    fit, right, wrong = gate_records([FIT, certificate(4.2, 5.0, LARGEST), certificate(9.0, 5.0, WRONG)], settings)
    assert fit == FIT
    assert (right["value"], right["limit"], right["passed"]) == (2.1, 2.5, True)
    assert right["text"] == "largest contradiction of a ball with its certificate, |E_n| with k = 2: ball 3"
    assert (wrong["value"], wrong["limit"], wrong["passed"], wrong["text"]) == (4.5, 2.5, False, WRONG)


def test_runs_of_this_version_stay_as_they_are() -> None:
    record = certificate(2.1, 2.5, "largest contradiction of a ball with its certificate, |E_n| with k = 2: ball 3")
    assert gate_records([FIT, record], {"gates": {"max_certificate_en": 2.5}}) == [FIT, record]
    assert gate_records([FIT], {}) == [FIT]


@pytest.mark.parametrize(
    "text",
    [
        LARGEST,
        WRONG,
        "largest contradiction of 4 right balls with their certificate, in standard deviations",
        "contradiction to the certificate: 9 standard deviations, required ≤ 5 standard deviations "
        f"(gates.max_certificate_sigma; {WRONG})",
    ],
)
def test_texts_of_earlier_versions_are_still_told_in_german(text: str) -> None:
    told = german(text)
    assert "Standardabweichungen" in told
    for word in ("standard deviations", "contradict", "certificate,", "clean", "apparent"):
        assert word not in told
