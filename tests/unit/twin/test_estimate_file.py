"""Estimate files: nothing is lost on the way, and what does not fit is named."""

from __future__ import annotations

import json
from functools import cache

import numpy as np
import pytest
from measured_set import TOOL, bar, case_study, measured

from twin.errors import FormatError
from twin.formats.estimate_file import format_estimate, parse_estimate
from twin.identification import Estimate, identify

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


@pytest.mark.parametrize(
    ("bad", "words", "key"),
    [
        (lambda: text().replace("{", "[", 1), "not valid JSON", None),
        (lambda: changed(colour="red"), "unknown key 'colour'", "colour"),
        (lambda: changed(format="volcal estimate 9"), "format|estimate", "format"),
        (lambda: changed(parameters=[]), "0 parameters where the model has", "parameters"),
        (lambda: with_parameter(name="EXX[9]"), "where the model has", "parameters[4].name"),
        (lambda: with_parameter(unit="rad"), "the unit of", "parameters[4].unit"),
        (lambda: with_parameter(value=float("nan")), "NaN is no number", None),
        (lambda: with_covariance(1, 0, 1.0), "not symmetric", "covariance"),
        (lambda: with_covariance(0, 0, -1.0), "not symmetric|positive", "covariance"),
        (lambda: changed(covariance=[[1.0]]), "rows of", "covariance"),
    ],
)
def test_what_does_not_fit_is_named(bad: object, words: str, key: str | None) -> None:
    with pytest.raises(FormatError, match=words) as caught:
        parse_estimate(bad(), "e.json")
    assert caught.value.where["file"] == "e.json"
    assert caught.value.where.get("key") == key
