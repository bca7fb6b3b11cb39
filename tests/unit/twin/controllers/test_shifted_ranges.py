"""Exports for a machine whose axis ranges do not begin at zero."""

from __future__ import annotations

import numpy as np
import pytest
from controller_rules import RULES
from estimated_machine import source_of

from twin.compensation.controllers.format_options import ExportOptions
from twin.compensation.controllers.registry import FORMATS
from twin.machine.error_model import ErrorModel
from twin.machine.forward_model import exact_deviation
from twin.machine.kinematic_chain import parse_chain
from twin.machine.rigid_motion import rigid_fields
from twin.machine.volumetric import evaluation_grid

RANGES = ((-1000.0, 3000.0), (200.0, 1500.0), (-1500.0, 0.0))
MODEL = ErrorModel.uniform(parse_chain("tool-Y-Z-X-bed-workpiece"), RANGES, 2, ("b1", "b2", "c1"))
TOOL = np.array([0.0, 250.0, 0.0])
CORNERS = evaluation_grid(RANGES, (2, 2, 2))


def aligned_um(deviation_um: np.ndarray) -> np.ndarray:
    """Return deviations at the corners without their best-fitting rigid motion."""
    motions = rigid_fields(CORNERS + TOOL, CORNERS.mean(axis=0), 4000.0).reshape(-1, 6)
    flat = deviation_um.ravel()
    return np.asarray(flat - motions @ np.linalg.lstsq(motions, flat, rcond=None)[0])


@pytest.mark.parametrize("name", ["isg-volcomp", "gcode-csv"])
def test_controllers_get_the_field_of_the_model(name: str) -> None:
    """ISG's kernel gets error motions with its own lever arms, the others get grids."""
    rng = np.random.default_rng(6)
    unit = [2e-3 if parameter.unit == "mm" else 2e-6 for parameter in MODEL.parameters]
    parameters = rng.normal(0.0, 1.0, MODEL.size) * unit
    expected = aligned_um(1e3 * exact_deviation(MODEL, CORNERS, TOOL, parameters))
    assert np.abs(expected).max() > 5.0
    source = source_of(MODEL, parameters, np.diag(np.square(unit)), (200.0, 100.0, 100.0), TOOL)
    added = RULES[name](FORMATS[name].export(source, ExportOptions({}, False)).files)(CORNERS)
    assert aligned_um(-1e3 * added) == pytest.approx(expected, abs=2e-2)
