"""Changes of a machine that its nights show, in words and as JSON: a sudden change, and a drift in one direction."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from twin.monitoring.constant_drift import FoundDrift
from twin.monitoring.step_detection import PossibleJump


def possible_text(possible: Sequence[PossibleJump]) -> str:
    """Return the errors of which one may have changed, the likeliest first, in words with their probabilities."""
    return "; or ".join(one.text for one in possible)


def drift_text(drift: FoundDrift) -> str:
    """Return the drift in one direction that the nights show, in words."""
    return f"the machine drifts in one direction: {drift.text}. The estimate follows the drift; find its cause"


def drift_document(drift: FoundDrift | None) -> dict[str, Any] | None:
    """Return a drift in one direction as the JSON object that docs/reference/json.md describes; None if there is
    none."""
    if drift is None:
        return None
    suspects = [vars(one) for one in drift.suspects]
    return {"nights": drift.nights, "false_alarm": drift.false_alarm, "suspects": suspects}


def jump_documents(possible: Sequence[PossibleJump]) -> list[dict[str, Any]]:
    """Return the errors of which one may have changed as the JSON objects that docs/reference/json.md describes."""
    return [
        {"error": jump.error, "change": jump.change, "unit": jump.unit, "probability": one.probability}
        for one in possible
        for jump in [one.jump]
    ]
