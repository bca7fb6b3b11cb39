"""Every gate at its limit: a value just below passes, a value just above does not."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from agent.errors import GateRefused
from agent.results.gates.gate import Gate
from agent.results.gates.required_gates import require_passed
from agent.results.gates.table_gates import table_gates
from agent.results.travel_parts import TravelPart, TravelParts
from agent.settings.schema import GateSettings
from drivers.roles import Activation, StoreLimits
from twin.compensation.table import CompensationTable
from twin.errors import DataError, FormatError
from twin.formats.toml_reading import validate_document
from twin.machine.anchor import Anchor

LIMITS = GateSettings()
ALL_MEASURED = TravelParts(None, None)
STORE = StoreLimits((1, 2), (64, 64, 64), 20000, 1e-4, 0.2, Activation.IMMEDIATE)


def table(corrections: np.ndarray, *, outside: bool = False) -> CompensationTable:
    shape = corrections.shape[:3]
    return CompensationTable(
        x=np.array([0.0, 100.0]),
        y=np.array([0.0, 50.0]),
        z=np.array([0.0, 200.0]),
        corrections=corrections,
        tool_offset=np.zeros(3),
        anchor=Anchor(np.zeros(3)),
        extrapolated=np.full(shape, outside),
    )


def verdicts(
    of: CompensationTable, limits: GateSettings = LIMITS, travel: TravelParts = ALL_MEASURED
) -> dict[str, bool]:
    return {gate.name: gate.passed for gate in table_gates(of, travel, STORE, limits)}


def test_correction_is_held_to_the_smaller_of_both_limits() -> None:
    corrections = np.full((2, 2, 2, 3), 0.1999)
    assert verdicts(table(corrections))["correction"]
    corrections[1, 1, 1, 2] = -0.2001
    assert not verdicts(table(corrections))["correction"]


@pytest.mark.parametrize(("axis", "spacing_mm"), [(0, 100.0), (1, 50.0), (2, 200.0)])
def test_slope_is_per_mm_along_each_axis(axis: int, spacing_mm: float) -> None:
    corrections = np.zeros((2, 2, 2, 3))
    upper = [slice(None)] * 3
    upper[axis] = slice(1, 2)
    corrections[tuple(upper)] = 0.499e-3 * spacing_mm
    assert verdicts(table(corrections))["slope"]
    corrections[tuple(upper)] = 0.501e-3 * spacing_mm
    assert not verdicts(table(corrections))["slope"]


def test_extrapolation_can_be_forbidden() -> None:
    flat = np.zeros((2, 2, 2, 3))
    forbidden = GateSettings(allow_extrapolation=False)
    assert verdicts(table(flat), forbidden)["extrapolation"]
    assert not verdicts(table(flat, outside=True), forbidden)["extrapolation"]
    assert verdicts(table(flat, outside=True))["extrapolation"]


def test_corrections_outside_the_measured_region_must_exceed_their_uncertainty() -> None:
    flat = table(np.zeros((2, 2, 2, 3)), outside=True)
    for left_um, passed in ((9.99, True), (10.01, False)):
        outside = TravelPart(0.4, math.hypot(10.0, left_um), (5.0, 15.0), 10.0, left_um, (5.0, 15.0))
        assert verdicts(flat, travel=TravelParts(None, outside))["unmeasured"] is passed


def test_refusal_names_every_gate_that_did_not_pass() -> None:
    gates = [Gate("fit", False, 3.0, 2.0, "x"), Gate("gain", True, 0.5, 0.25, "y"), Gate("slope", False, 1.0, 0.5, "z")]
    with pytest.raises(GateRefused) as caught:
        require_passed(gates)
    assert "fit of the model: 3, required ≤ 2 (gates.max_chi2; " in str(caught.value)
    assert "steepest correction: 1 µm/mm, required ≤ 0.5 µm/mm" in str(caught.value)
    assert "gain of the new table" not in str(caught.value)
    require_passed([gates[1]])


def test_a_table_with_a_value_that_is_not_a_number_is_refused() -> None:
    corrections = np.zeros((2, 2, 2, 3))
    corrections[0, 0, 0, 0] = math.nan
    with pytest.raises(DataError, match="finite"):
        table(corrections)


@pytest.mark.parametrize(
    ("stated", "limit"), [({}, 2.5), ({"max_certificate_en": 3.0}, 3.0), ({"max_certificate_sigma": 4}, 2.0)]
)
def test_the_limit_of_the_certificate_is_read_in_its_earlier_form(stated: dict[str, float], limit: float) -> None:
    assert GateSettings(**stated).max_certificate_en == limit


@pytest.mark.parametrize(
    "stated",
    [
        {"max_certificate_sigma": "many"},
        {"max_certificate_sigma": "5"},
        {"max_certificate_sigma": True},
        {"max_certificate_sigma": -4},
        {"max_certificate_sigma": math.nan},
        {"max_certificate_sigma": 4.0, "max_certificate_en": 2.0},
    ],
)
def test_an_earlier_limit_that_cannot_be_meant_is_refused_by_the_key_that_was_written(stated: dict[str, Any]) -> None:
    with pytest.raises(FormatError) as refused:
        validate_document(stated, "settings.toml", GateSettings)
    assert refused.value.where["key"] == "max_certificate_sigma"
    assert "max_certificate_en" not in refused.value.message
