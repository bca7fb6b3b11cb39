"""Exports of an estimate of an earlier version, for a machine whose axis ranges do not begin at zero."""

from __future__ import annotations

import pytest
from controller_rules import RULES
from estimated_machine import source_of
from former_estimate import CORNERS, TOOL, aligned_um, expected_um, stored

from twin.compensation.controllers.format_options import ExportOptions
from twin.compensation.controllers.registry import FORMATS


@pytest.mark.parametrize("name", ["isg-volcomp", "gcode-csv"])
def test_controllers_get_the_field_of_the_former_version(name: str) -> None:
    """ISG's kernel gets error motions with its own lever arms, the others get grids."""
    known = stored()
    source = source_of(known.model, known.parameters, known.covariance, (200.0, 100.0, 100.0), TOOL)
    added = RULES[name](FORMATS[name].export(source, ExportOptions({}, False)).files)(CORNERS)
    assert aligned_um(-1e3 * added) == pytest.approx(expected_um("estimate"), abs=2e-2)
