"""Estimates of an earlier version: read with the meaning that they had when they were written, or refused."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from former_estimate import PARAMETERS, TEXT, assert_field, changed, stored, two_tools
from former_levers import former_basis, former_deviation
from measured_set import AMPLITUDES, TOOL, bar, measured

from twin.errors import FormatError
from twin.formats.estimate_file import parse_estimate
from twin.identification import Options, identify
from twin.identification.misfit import misfit_modes
from twin.machine.lever_origin import from_levers_at_axis_zeros
from twin.machine.machine_population import family_from_amplitudes
from twin.machine.rigid_motion import rigid_fields


def test_field_is_that_of_the_former_version() -> None:
    known = stored()
    assert_field(known.model, known.parameters, "estimate")
    assert np.abs(known.parameters - PARAMETERS).max() > 5e-4


def test_parameters_and_unknowns_agree() -> None:
    known = stored()
    own = known.unknowns.blocks.parameters
    assert known.unknowns.parameters(known.z) == pytest.approx(known.parameters, rel=1e-12)
    covariance = known.unknowns.physical_covariance(known.z_covariance[own, own])
    deviations = np.sqrt(np.diagonal(known.covariance))
    assert np.abs(covariance - known.covariance).max() < 1e-9 * deviations.max() ** 2


def test_second_night_is_fused_as_by_the_former_version() -> None:
    known, rng = stored(), np.random.default_rng(5)
    family = family_from_amplitudes(known.model, AMPLITUDES)
    truth = rng.normal(0.0, 1.0, known.model.size) * family.prior_standard_deviation
    low = np.array(known.model.ranges_mm)[:, 0]
    seen = measured(
        "S2", 2, bar(7), lambda at, tool: former_deviation(known.model, at + low, tool, truth), np.random.default_rng(2)
    )
    seen = replace(seen, axis_positions=seen.axis_positions + low)
    options = Options(carried_over=known.carried_over(), misfit_mm=0.0, estimate_scales=False, outliers="none")
    fused = identify(known.model, seen, bar(7), family, options)
    assert_field(known.model, fused.parameters, "fused")


def test_modes_of_the_misfit_keep_their_fields() -> None:
    """The former modes are what the former basis and the rigid motions leave of the same candidates."""
    model = stored().model
    present = misfit_modes(model, (0.0, 250.0, 0.0))
    candidates = replace(present, removed=np.zeros_like(present.removed), rigid=np.zeros_like(present.rigid))
    low, high = np.array(model.ranges_mm).T
    points = np.random.default_rng(8).uniform(low, high, (400, 3))
    rigid = rigid_fields(points, 0.5 * (low + high), 4000.0)
    known = np.concatenate((former_basis(model, points, TOOL), rigid), axis=2)
    flat = known.reshape(-1, known.shape[2])
    amplitudes = np.linalg.lstsq(flat, candidates.at(points).reshape(len(flat), -1), rcond=1e-10)[0]
    former = candidates.at(points) - known @ amplitudes
    conversion = from_levers_at_axis_zeros(model, TOOL)
    found = present.with_removed(conversion @ amplitudes[: model.size]).at(points)
    motions = rigid.reshape(-1, 6)
    left = (found - former).reshape(len(motions), -1)
    left -= motions @ np.linalg.lstsq(motions, left, rcond=None)[0]
    assert np.abs(left).max() < 1e-9 * np.abs(former).max()


def test_present_format_is_read_as_written() -> None:
    known = parse_estimate(changed(format="volcal estimate 3"), "estimate.json")
    assert known.conversion is None
    assert known.parameters.tolist() == PARAMETERS.tolist()


def test_ranges_from_zero_are_read_as_written() -> None:
    model = {**json.loads(TEXT)["model"], "ranges_mm": [[0.0, 4000.0], [0.0, 1300.0], [0.0, 1500.0]]}
    assert parse_estimate(changed(model=model), "estimate.json").conversion is None


def held_at_zero() -> str:
    carried = json.loads(TEXT)["carried_over"]
    carried["scale"][stored().model.index("A0Z")] = 0.0
    return changed(carried_over=carried)


def other_cross_effect() -> str:
    document = json.loads(TEXT)
    document["model"]["chain"] = "tool-Y-bed-Z-X-workpiece"
    return json.dumps(document)


@pytest.mark.parametrize(
    ("text", "words", "key"),
    [
        (two_tools, "2 tools cannot be converted", "tool_offsets_mm"),
        (held_at_zero, "A0Z, which the prior population holds at zero", "carried_over.scale"),
        (other_cross_effect, r"CROSS\[c1\] cannot be represented", "model"),
    ],
)
def test_what_cannot_be_converted_is_refused(text: Callable[[], str], words: str, key: str) -> None:
    with pytest.raises(FormatError, match=words) as caught:
        parse_estimate(text(), "estimate.json")
    assert caught.value.where == {"file": "estimate.json", "key": key}
    assert "balls.csv" in caught.value.hint
