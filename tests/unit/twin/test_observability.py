"""Rank of the field and names of null directions, against known facts of the case study."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from measured_set import RANGES, TOOL, bar, case_study, measured

from twin.identification import Options, identify
from twin.identification.observability import field_observability, summary
from twin.machine.forward_model import deviation_basis
from twin.machine.volumetric import align_rigidly, evaluation_grid

ALL_CROSS = ("b0", "b1", "b2", "c0", "c1")
MODEL, FAMILY = case_study(4, ALL_CROSS)
SCALE = FAMILY.prior_standard_deviation


def test_one_straight_probe_shows_56_of_74_directions_and_a_second_length_65() -> None:
    assert MODEL.size == 74
    one = field_observability(MODEL, SCALE, TOOL[None], aligned=True)
    two = field_observability(MODEL, SCALE, np.array([TOOL, 1.6 * TOOL]), aligned=True)
    assert (one.rank, two.rank) == (56, 65)
    assert (len(one.null_directions), len(two.null_directions)) == (18, 9)


def test_what_one_straight_probe_does_not_see_has_names() -> None:
    lines = summary(field_observability(MODEL, SCALE, TOOL[None], aligned=True).null_directions)
    assert "EBY[1..4]: not seen with one straight probe along Y" in lines
    assert "EBZ[1..4]: not seen with one straight probe along Y" in lines
    assert "EAY[2..4] merges with EZY[2..4]: not told apart with one straight probe along Y" in lines
    assert "ECY[2..4] merges with EXY[2..4]: not told apart with one straight probe along Y" in lines
    assert any("CROSS[b0]" in line and "EYY[1]" in line for line in lines)
    assert len(lines) == 8


@pytest.mark.parametrize("tool", [TOOL, np.array([30.0, 250.0, -80.0])])
def test_null_directions_move_nothing_but_the_whole_workspace(tool: np.ndarray) -> None:
    grid = evaluation_grid(RANGES, (7, 6, 5))
    basis = deviation_basis(MODEL, grid, tool)
    for direction in field_observability(MODEL, SCALE, tool[None], aligned=True).null_directions:
        assert not direction.changes_field
        vector = np.zeros(MODEL.size)
        for name, loading in direction.loadings.items():
            vector[MODEL.index(name)] = loading
        assert np.abs(align_rigidly(grid + tool, basis @ vector)).max() < 1e-8


def test_a_poor_set_leaves_field_directions_open_and_says_so() -> None:
    seen = measured("S1", 1, bar(), lambda X, t: np.zeros_like(X), np.random.default_rng(0))
    estimate = identify(MODEL, seen, bar(), FAMILY, Options(outliers="none", estimate_scales=False))
    assert estimate.rank + len(estimate.null_directions) == MODEL.size
    open_ones = [direction for direction in estimate.null_directions if direction.changes_field]
    assert open_ones
    assert all("by this set" in direction.text for direction in open_ones)


def test_a_parameter_that_the_family_excludes_is_named_as_such() -> None:
    scale = SCALE.copy()
    scale[MODEL.index("EXX[3]")] = 0.0
    found = field_observability(MODEL, scale, TOOL[None])
    assert any("EXX[3]: not seen because the family holds it" in direction.text for direction in found.null_directions)


def test_a_tool_that_was_not_used_says_nothing_of_what_is_seen() -> None:
    """A machine file may list more tools than a run uses."""
    seen = measured("S3", 4, bar(), lambda X, t: np.zeros_like(X), np.random.default_rng(0))
    listed = dataclasses.replace(seen, tool_offsets=np.array([TOOL, 1.8 * TOOL]))
    plain = Options(outliers="none", estimate_scales=False, use_prior=False)
    estimate = identify(MODEL, listed, bar(), FAMILY, plain)
    assert estimate.tool_offsets.tolist() == [TOOL.tolist()]
    assert "EBY[1..4]: not seen with one straight probe along Y" in estimate.null_summary
