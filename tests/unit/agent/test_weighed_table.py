"""A calibration confirms the active table only on a machine that has not changed."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from agent.results.gates.gate import Gate
from agent.results.gates.gate_rules import CHANGE, FIT, PROOF
from agent.results.table_replacement import ExpectedGain
from agent.runs.consent import Consent
from agent.runs.kinds import calibration
from agent.runs.kinds.calibration import KEEP, REFUSE, WRITE, CalibrationTask


def weighed(monkeypatch: pytest.MonkeyPatch, power: float, consent: Consent, *, found: bool, seen_before: bool) -> Any:
    """Weigh a table that would lower the VE from 30 to 18 µm, and whose proof has the given power. The measurement
    itself has `found` that the machine changed, or an earlier one has (`seen_before`)."""
    replaced: dict[str, Any] = {
        "expected_gain": ExpectedGain(30.0, 18.0),
        "estimate_gates": (Gate(FIT, True, 1.0, 2.0, "fit"),),
        "change_since": SimpleNamespace(found_um=20.0, expected_um=2.0),
        "change_gate": Gate(CHANGE, not found, 10.0, 3.0, "change"),
        "table_gates": (),
        "power_of_proof": power,
    }
    for name, value in replaced.items():
        monkeypatch.setattr(calibration, name, lambda *_, value=value: value)
    verification = SimpleNamespace(min_gain=0.25)
    job: Any = SimpleNamespace(
        gate_limits=None, tool_offset_mm=None, settings=SimpleNamespace(verification=verification)
    )
    reference: Any = SimpleNamespace()
    task = CalibrationTask(job, reference=reference, consent=consent, changed=seen_before)
    volumetric = SimpleNamespace(after_aligned=SimpleNamespace(value_um=18.0))
    estimation: Any = SimpleNamespace(volumetric=volumetric, estimate=None, table=None, travel=None)
    ready: Any = SimpleNamespace(correction=None)
    return calibration._weigh(task, ready, estimation, ready)


@pytest.mark.parametrize(
    ("consent", "found", "seen_before"),
    [(Consent.GIVEN, True, True), (Consent.GIVEN, True, False), (Consent.ASK, False, True)],
)
def test_a_changed_machine_is_never_confirmed(
    monkeypatch: pytest.MonkeyPatch, consent: Consent, found: bool, seen_before: bool
) -> None:
    refused = weighed(monkeypatch, 0.8, consent, found=found, seen_before=seen_before)
    assert refused.way == REFUSE
    assert PROOF in [gate.name for gate in refused.gates if not gate.passed]
    assert weighed(monkeypatch, 0.99, consent, found=found, seen_before=seen_before).way == WRITE


def test_an_unchanged_machine_whose_gain_cannot_be_shown_is_confirmed(monkeypatch: pytest.MonkeyPatch) -> None:
    assert weighed(monkeypatch, 0.8, Consent.ASK, found=False, seen_before=False).way == KEEP
