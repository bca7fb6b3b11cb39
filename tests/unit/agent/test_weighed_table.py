"""A calibration confirms the active table only on a machine that has not changed, and a new table is weighed and proved
as the controller stores it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from agent.execution.engine import Engine
from agent.execution.steps import Conclude, Decide, Enter, Plan, Record
from agent.planning.stand_ins import USUAL_STORE, MemoryStore
from agent.probing.publish import ActiveCompensation
from agent.results.gates.gate import Gate
from agent.results.gates.gate_rules import CHANGE, FIT, PROOF
from agent.results.table_replacement import ExpectedGain
from agent.runs.consent import Consent
from agent.runs.kinds import calibration
from agent.runs.kinds.calibration import KEEP, REFUSE, WRITE, CalibrationTask
from twin.compensation.table import CompensationTable
from twin.machine.anchor import Anchor


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
        "table_as_applied": SimpleNamespace(at=None),
    }
    for name, value in replaced.items():
        monkeypatch.setattr(calibration, name, lambda *_, value=value: value)
    verification = SimpleNamespace(min_gain=0.25)
    job: Any = SimpleNamespace(
        gate_limits=None, tool_offset_mm=None, settings=SimpleNamespace(verification=verification)
    )
    reference: Any = SimpleNamespace()
    task = CalibrationTask(job, reference=reference, consent=consent, changed=seen_before)
    estimation: Any = SimpleNamespace(unknown_um=18.0, estimate=None, table=None, travel=None)
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


@dataclass(frozen=True)
class Estimated:
    table: CompensationTable


def test_a_table_is_proved_as_the_controller_stores_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """Otherwise the controller would be blamed for its resolution."""
    nodes = np.array([0.0, 500.0])
    corrections = 0.02 * np.random.default_rng(1).normal(size=(2, 2, 2, 3))
    outside, zeros = np.zeros((2, 2, 2), dtype=bool), np.zeros(3)
    estimation: Any = Estimated(CompensationTable(nodes, nodes, nodes, corrections, zeros, Anchor(zeros), outside))
    limits, store, compared = replace(USUAL_STORE, resolution_mm=0.01), MemoryStore(), list[Any]()

    def nothing(*_: object) -> Plan[Any]:
        yield from ()
        return SimpleNamespace(standing_at=1, placed=None, mount_poses={}, last_conditions=None)

    def seen(_: object, estimation: Estimated, *__: object) -> Any:
        compared.append(estimation.table.corrections)
        return SimpleNamespace(accepted=False, reason="none")

    for name in ("measure_positions", "note_measured"):
        monkeypatch.setattr(calibration, name, nothing)
    for name in ("proof_power", "prove"):
        monkeypatch.setattr(calibration, name, seen)
    monkeypatch.setattr(calibration, "FormerBalls", SimpleNamespace(of=lambda *_: None))
    job: Any = SimpleNamespace(verification_order=nothing, layout=None, balls_of=lambda *_, **__: ())
    ready: Any = SimpleNamespace(found=ActiveCompensation(0, None), rules=None, correction=None)
    measured: Any = SimpleNamespace(standing_at=1, placed=None, mount_poses={}, last_conditions=None)

    calibration.power_of_proof(job, ready, limits, estimation, measured)
    actions = store.actions() | {
        Conclude: lambda step: step.compute(),
        Decide: lambda step: step.choose(),
        Enter: lambda _: None,
        Record: lambda _: None,
    }
    Engine(actions).carry_out(calibration.written(CalibrationTask(job, limits), ready, estimation, measured))
    written = store.tables[1]
    assert len(compared) == 2
    for one in compared:
        np.testing.assert_array_equal(one, 0.01 * written.counts)
    assert np.abs(compared[0] - corrections).max() > 1e-3
