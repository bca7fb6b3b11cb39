"""Result of a nightly run or a verification, as rows of a report."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from agent.execution.run_record import RunRecord
from agent.reports.page import NightFacts
from agent.reports.page.number_format import fixed
from agent.results.decision_kinds import OUTCOME
from agent.results.run_outcome import Decision

GOOD = (Decision.WITHIN, Decision.FUSED, Decision.WRITTEN, Decision.FULL_DONE)


def night_of(record: RunRecord) -> Mapping[str, Any] | None:
    """Return the result of a nightly run or a verification from the record of the run; None if `record` contains no
    such result."""
    outcome = record.decision(OUTCOME) or {}
    found: Mapping[str, Any] | None = outcome.get("night") or record.decision("night") or record.decision("verify")
    return found


def night_facts(record: RunRecord) -> NightFacts | None:
    night = night_of(record)
    if night is None:
        return None
    return NightFacts(
        decision=night["decision"],
        good=night["decision"] in [decision.value for decision in GOOD],
        since=night["since"],
        rows=tuple(_rows(night)),
        ve_now_um=night["ve_now_um"],
        ve_before_um=night["ve_before_um"],
    )


def _rows(night: Mapping[str, Any]) -> list[tuple[str, str]]:
    held_out, expected = _um(night["held_out_um"]), _um(night["held_out_predicted_um"])
    chi2 = night["chi2_normalised"]
    return [
        ("Nights since", fixed(night["nights"], 1)),
        ("Measured", f"{night['positions']} positions at station {night['station']}"),
        ("VE after that night", _um(night["ve_before_um"])),
        ("VE now", _um(night["ve_now_um"])),
        ("VE with an updated table", _um(night["ve_after_um"])),
        ("Held-out balls, rms", f"{held_out}, expected {expected}"),
        ("Consistency with the prediction", "–" if chi2 is None else f"normalised χ² {fixed(chi2, 2)}"),
        ("Abrupt changes", _error_changes(night["jumped"]) or "none"),
        ("Most likely cause", _error_changes(night["likeliest"]) or "–"),
        *([("Warning", night["warning"])] if night.get("warning") else []),
        ("Reason", night["reason"] or "none"),
    ]


def _error_changes(found: list[Mapping[str, Any]]) -> str:
    return "; ".join(f"{one['error']} {one['change']:+.1f} {one['unit']} (ln {one['evidence']:.1f})" for one in found)


def _um(value: float | None) -> str:
    return "–" if value is None else f"{fixed(value, 2)} µm"
