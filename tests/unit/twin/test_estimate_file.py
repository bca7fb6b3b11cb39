"""Estimate files: round trip without loss, and errors that name the invalid key."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from measured_set import TOOL, bar, case_study, measured

from campaigns.fuzz.estimate_decoder import short_estimate
from twin.errors import DataError, FormatError
from twin.formats.estimate_file import format_estimate, parse_estimate
from twin.identification import Estimate, Options, identify, identify_by_evidence

MODEL, FAMILY = case_study(3)


@cache
def estimate() -> Estimate:
    seen = measured("S3", 2, bar(7), lambda X, t: np.zeros_like(X) + 1e-3 * np.sin(X / 900.0), np.random.default_rng(1))
    return identify(MODEL, seen, bar(7), FAMILY)


@cache
def text() -> str:
    return format_estimate(estimate(), {"software": "volcal 0.1.0", "balls": "balls.csv"})


def test_what_is_read_is_what_was_found() -> None:
    stored = parse_estimate(text(), "e.json")
    assert stored.model == MODEL
    assert (stored.parameters == estimate().parameters).all()
    assert (stored.covariance == estimate().covariance).all()
    assert stored.tool_offsets.tolist() == [TOOL.tolist()]
    assert stored.document.rank == estimate().rank
    assert stored.document.provenance["software"] == "volcal 0.1.0"


def test_people_find_names_units_and_null_directions() -> None:
    document = json.loads(text())
    first = document["parameters"][0]
    assert (first["name"], first["unit"]) == ("EXX[1]", "mm")
    assert first["standard_uncertainty"] == pytest.approx(np.sqrt(estimate().covariance[0, 0]))
    assert any(line.startswith("EBY[1..3]: not seen with one straight probe") for line in document["null_summary"])
    assert len(document["null_directions"]) == MODEL.size - document["rank"]


def test_an_estimate_from_its_file_carries_over_as_the_one_in_hand() -> None:
    known, stored = estimate().carried_over(), parse_estimate(text(), "e.json").carried_over()
    second = measured("S2", 2, bar(7), lambda X, t: np.zeros_like(X), np.random.default_rng(2))
    from_hand, from_file = (
        identify(MODEL, second, bar(7), FAMILY, Options(carried_over=prior)) for prior in (known, stored)
    )
    assert stored.scales == known.scales
    assert from_file.z == pytest.approx(from_hand.z, abs=1e-12)
    assert from_file.z_covariance == pytest.approx(from_hand.z_covariance, abs=1e-12)


def test_the_shortened_estimate_of_the_fuzz_trial_has_every_section_and_is_read() -> None:
    short = short_estimate(text())
    whole, read = json.loads(text()), json.loads(short)
    carried = "carried_over"
    assert read.keys() == whole.keys()
    assert read[carried].keys() == whole[carried].keys()
    assert read[carried]["misfit"].keys() == whole[carried]["misfit"].keys()
    assert read[carried]["misfit"]["sizes"] == [1, 1, 1, 1]
    assert len(read[carried]["mean"]) == parse_estimate(short, "e.json").carried_over().unknowns.blocks.size
    assert len(short) < 0.5 * len(text())


def test_the_sag_is_stored_and_carried_over_with_the_estimate() -> None:
    sagging = replace(bar(7), sag_standard_uncertainty_mm=0.02)
    first, second = (
        measured(name, 2, sagging, lambda X, t: np.zeros_like(X), np.random.default_rng(k))
        for k, name in enumerate(("S3", "S2"))
    )
    once = identify(MODEL, first, sagging, FAMILY)
    stored = parse_estimate(format_estimate(once, {}), "e.json")
    [told] = stored.document.ball_shifts
    assert (told.name, told.size_um) == ("sag", once.shifts[0].size_um)
    assert once.unknowns.name(once.unknowns.blocks.sag.start) == "sag"
    again = [
        identify(MODEL, second, sagging, FAMILY, Options(carried_over=known))
        for known in (once.carried_over(), stored.carried_over())
    ]
    assert again[1].z == pytest.approx(again[0].z, abs=1e-12)
    alone = identify(MODEL, second, sagging, FAMILY)
    uncertainties = [one.shifts[0].standard_uncertainty_um for one in (again[0], once, alone)]
    assert uncertainties[0] < 0.9 * min(uncertainties[1:])
    stiffer = replace(sagging, sag_standard_uncertainty_mm=0.0)  # a new statement replaces the estimate
    assert not identify(MODEL, second, stiffer, FAMILY, Options(carried_over=once.carried_over())).shifts


def test_without_misfit_and_with_a_perfect_certificate_too() -> None:
    seen = measured("S3", 2, bar(7), lambda X, t: np.zeros_like(X), np.random.default_rng(1))
    plain = identify(MODEL, seen, bar(7), FAMILY, Options(misfit_mm=0.0))
    stored = parse_estimate(format_estimate(plain, {}), "e.json")
    assert stored.unknowns.modes is None
    assert stored.z_covariance.shape == (MODEL.size, MODEL.size)


def test_the_orders_that_were_compared_are_told() -> None:
    seen = measured("S3", 2, bar(7), lambda X, t: np.zeros_like(X), np.random.default_rng(3))
    chosen = identify_by_evidence(lambda order: case_study(order)[1], seen, bar(7), candidates=(2, 3))
    orders = parse_estimate(format_estimate(chosen, {}), "e.json").document.order_evidence
    assert [entry.order for entry in orders] == [2, 3]
    assert [entry.order for entry in orders if entry.chosen] == [chosen.model.highest_order[0]]
    assert parse_estimate(text(), "e.json").document.order_evidence == ()


def test_a_singular_covariance_is_told_when_it_is_to_be_carried_over() -> None:
    stored = parse_estimate(with_carried(covariance=zeros_in_row(8)), "e.json")
    with pytest.raises(DataError, match="singular") as caught:
        stored.carried_over()
    assert caught.value.where["unknown"] == MODEL.names[8]


def carried() -> dict:
    return json.loads(text())["carried_over"]


def with_carried(**changes: object) -> str:
    return changed(carried_over={**carried(), **changes})


def with_misfit(**changes: object) -> str:
    return with_carried(misfit={**carried()["misfit"], **changes})


def zeros_in_row(row: int) -> list[list[float]]:
    covariance = carried()["covariance"]
    for place, values in enumerate(covariance[row:], start=row):
        values[:] = [0.0] * len(values) if place == row else [0.0 if k == row else v for k, v in enumerate(values)]
    return covariance


def changed(**changes: object) -> str:
    return json.dumps({**json.loads(text()), **changes})


def with_parameter(**changes: object) -> str:
    parameters = json.loads(text())["parameters"]
    parameters[4] |= changes
    return changed(parameters=parameters)


def with_covariance(row: int, column: int, value: float) -> str:
    covariance = json.loads(text())["covariance"]
    covariance[row][column] = value
    return changed(covariance=covariance)


def with_correlation(variance: float, covariance_of_two: float) -> str:
    covariance = json.loads(text())["covariance"]
    covariance[0][0] = variance
    covariance[0][1] = covariance[1][0] = covariance_of_two
    return changed(covariance=covariance)


@pytest.mark.parametrize(
    ("bad", "words", "key"),
    [
        (lambda: text().replace("{", "[", 1), "not valid JSON", None),
        (lambda: changed(colour="red"), "unknown key 'colour'", "colour"),
        (lambda: changed(format="volcal estimate 9"), "format|estimate", "format"),
        (lambda: changed(parameters=[]), "0 parameters, but the model has", "parameters"),
        (lambda: with_parameter(name="EXX[9]"), "instead of", "parameters[4].name"),
        (lambda: with_parameter(unit="rad"), "the unit of", "parameters[4].unit"),
        (lambda: with_parameter(value=float("nan")), "NaN is not a number", None),
        (lambda: with_covariance(1, 0, 1.0), "not symmetric", "covariance"),
        (lambda: with_covariance(0, 0, -1.0), "not symmetric|positive", "covariance"),
        (lambda: with_correlation(1e-320, 1e300), "not positive semi-definite", "covariance"),
        (lambda: changed(covariance=[[1.0]]), "rows of", "covariance"),
        (lambda: with_carried(mean=[1.0]), "numbers are required", "carried_over.mean"),
        (lambda: with_carried(scale=[1.0]), "numbers are required", "carried_over.scale"),
        (lambda: with_carried(covariance=[[1.0]]), "lower triangle", "carried_over.covariance"),
        (lambda: with_misfit(removed=[[1.0]]), "numbers are required", "carried_over.misfit.removed"),
        (lambda: with_misfit(mixing=[[[1.0]]]), "list is too short", "carried_over.misfit.mixing[1]"),
    ],
)
def test_what_does_not_fit_is_named(bad: Callable[[], str], words: str, key: str | None) -> None:
    with pytest.raises(FormatError, match=words) as caught:
        parse_estimate(bad(), "e.json")
    assert caught.value.where["file"] == "e.json"
    assert caught.value.where.get("key") == key


@pytest.mark.parametrize(("stored", "read"), [(1.0, 1.0), (1.0000000000000002, 1.0), (0.25, 0.25), (1.001, None)])
def test_a_sum_of_probabilities_that_exceeds_1_by_its_rounding_is_read(stored: float, read: float | None) -> None:
    suspects = [{"text": "the bar is turned", "size_um": 3.0, "probability": stored}]
    document = changed(shift_pattern={"false_alarm": 0.5, "suspects": suspects})
    if read is None:
        with pytest.raises(FormatError, match="probability"):
            parse_estimate(document, "estimate.json")
        return
    pattern = parse_estimate(document, "estimate.json").document.shift_pattern
    assert pattern is not None
    assert pattern.suspects[0].probability == read
