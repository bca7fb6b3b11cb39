"""An estimate that an earlier version stored, before lever arms began at the lower ends of the axis ranges.

That version wrote `golden/former-estimate.json` (format `volcal estimate 2`) for a machine whose ranges do not begin at
zero. `golden/former-estimate-answers.json` contains the deviations of that estimate at the corners of the workspace, as
that version computed them, and those after it had fused the estimate with a second night.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from twin.formats.estimate_file import StoredEstimate, parse_estimate
from twin.machine.error_model import ErrorModel
from twin.machine.forward_model import exact_deviation
from twin.machine.rigid_motion import rigid_fields

GOLDEN = Path(__file__).parent / "golden"
TEXT = (GOLDEN / "former-estimate.json").read_text()
_ANSWERS = json.loads((GOLDEN / "former-estimate-answers.json").read_text())
CORNERS = np.array(_ANSWERS["points_mm"])
PARAMETERS = np.array([parameter["value"] for parameter in json.loads(TEXT)["parameters"]])
TOOL = np.array([0.0, 250.0, 0.0])


def stored() -> StoredEstimate:
    return parse_estimate(TEXT, "estimate.json")


def changed(**changes: object) -> str:
    return json.dumps({**json.loads(TEXT), **changes})


def two_tools() -> str:
    """Return the text of an estimate that cannot be converted."""
    return changed(tool_offsets_mm=[[0.0, 250.0, 0.0], [0.0, 250.0, -100.0]])


def aligned_um(deviation_um: np.ndarray) -> np.ndarray:
    """Return deviations at the corners without their best-fitting rigid motion."""
    motions = rigid_fields(CORNERS + TOOL, CORNERS.mean(axis=0), 4000.0).reshape(-1, 6)
    flat = deviation_um.ravel()
    return np.asarray(flat - motions @ np.linalg.lstsq(motions, flat, rcond=None)[0])


def expected_um(answer: str) -> np.ndarray:
    """Return the aligned deviations of the former version, for `estimate` or `fused`."""
    return aligned_um(np.array(_ANSWERS[answer]["deviation_um"]))


def assert_field(model: ErrorModel, parameters: np.ndarray, answer: str) -> None:
    """Compare with the field of the former version; the limit of 0.1 nm is for the terms of second order."""
    expected = expected_um(answer)
    assert np.abs(expected).max() > 5.0
    assert aligned_um(1e3 * exact_deviation(model, CORNERS, TOOL, parameters)) == pytest.approx(expected, abs=1e-4)
