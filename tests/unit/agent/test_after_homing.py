"""The accuracy after the next homing, as the outcome of a run states it beside the one without."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest
from service_house import outcome

from agent.execution.states import RunState
from agent.results.facts import Quantity
from agent.results.homing_scatter import NOT_KNOWN, AfterHoming, HomingScatter, MeasuredHoming, after_homing_text
from agent.results.run_outcome import Confirmation, Decision, NightReport, Outcome, Proof

SCATTER = HomingScatter(
    homings=5,
    sigma_um=(3.0, 4.0, 12.0),
    limits_um=((1.8, 8.6), (2.4, 11.5), (7.2, 34.5)),
    touches_um=(0.5, 0.5, 0.7),
    confidence=0.95,
    offsets_um=((1.0, 2.0, -3.0),) * 5,
)
AFTER = AfterHoming(MeasuredHoming("20261128T081409Z-b21a", "2026-11-28T08:14:14.758Z", SCATTER), 3.0, 13.0)
PROVED = Proof(True, 9.0, 4.0, 4.1, 1.0, 1.0, 1.0, 0.3, 1.0, "effect shown, and as predicted")
NIGHT = NightReport(Decision.FUSED, "20261127T010000Z-aaaa", 1.0, 1, 4, ve_now_um=6.0)


def ended(**values: Any) -> Outcome:
    estimation: Any = SimpleNamespace(volumetric=SimpleNamespace(after_aligned=Quantity(4.0, 0.2, (3.0, 5.0))))
    return replace(outcome("run", RunState.COMPLETE, None), estimation=estimation, after_homing=AFTER, **values)


def test_both_parts_are_added_in_quadrature_and_the_figure_without_stays() -> None:
    record = ended(proof=PROVED).after_homing_record
    assert record is not None
    assert (record["ve_without_um"], record["ve_um"]) == (4.0, 5.0)
    assert record["ve_limits_um"] == [pytest.approx(math.hypot(3.0, 3.0)), pytest.approx(math.hypot(5.0, 3.0))]
    assert (record["field_um"], record["offset_um"]) == (3.0, 13.0)
    text = after_homing_text(record)
    assert "VE 5.00 µm instead of 4.00" in text
    assert "work offsets kept over it: 13.0 µm rms more" in text
    assert "run 20261128T081409Z-b21a, 2026-11-28" in text


def test_what_was_never_measured_is_not_known_and_not_zero() -> None:
    never = replace(ended(proof=PROVED), after_homing=None)
    assert never.after_homing_record is None
    assert after_homing_text(never.after_homing_record) == NOT_KNOWN
    assert "not known" in NOT_KNOWN
    assert "`" not in NOT_KNOWN  # a report prints it as it is


@pytest.mark.parametrize(
    ("values", "without_um"),
    [
        ({"proof": PROVED}, 4.0),
        ({"proof": replace(PROVED, accepted=False)}, None),
        ({"confirmed": Confirmation(7.0, 6.5, 0.25, 5.0, 1.0, None)}, 7.0),
        ({"night": NIGHT}, 6.0),
        ({"night": NIGHT, "proof": PROVED}, 4.0),
        ({"night": NIGHT, "proof": replace(PROVED, accepted=False)}, 6.0),
        ({"night": replace(NIGHT, ve_now_um=None)}, None),
    ],
)
def test_it_is_stated_for_the_table_that_is_active(values: dict[str, Any], without_um: float | None) -> None:
    record = ended(**values).after_homing_record
    assert (None if record is None else record["ve_without_um"]) == without_um


def test_a_scatter_is_read_back_from_the_journal_as_it_was_written() -> None:
    assert HomingScatter.from_record(SCATTER.as_json()) == SCATTER
    (name, text), *_ = SCATTER.rows
    assert name == "Homing of X"
    assert "2σ 6.00 µm (95%: 3.60 to 17.20) of 5 homings" in text
