"""Calibration of the artefact as a result of a run: its files, its JSON object and its warning."""

from __future__ import annotations

from typing import Any

from twin.artefact.artefact import Artefact
from twin.artefact.artefact_calibration import ArtefactCalibration
from twin.artefact.certificate import TRACEABLE_PPM
from twin.formats.artefact_file import format_artefact
from twin.formats.estimate_file import calibration_document

CALIBRATED_ARTEFACT = "artefact.toml"
CALIBRATION_FILES = (CALIBRATED_ARTEFACT, "artefact-covariance.csv")


def calibration_texts(
    calibration: ArtefactCalibration | None, artefact: Artefact, run_id: str, timestamp: str, machine: str
) -> dict[str, str]:
    """Return the texts of the artefact file with the calibration and of the file of its covariance, by file name; empty
    if there is no calibration.

    `artefact` is the artefact as it was before the run `run_id` on `machine` at the UTC time `timestamp`.
    """
    if calibration is None:
        return {}
    origin = f"calibrated by the run {run_id} on {machine}, {timestamp}"
    notes = (f"{artefact.name}, {origin}. Standard uncertainties; U = 2 u.", *calibration.limits)
    texts = format_artefact(calibration.calibrated(artefact, origin), CALIBRATION_FILES[1], notes)
    return dict(zip(CALIBRATION_FILES, texts, strict=True))


def calibration_record(calibration: ArtefactCalibration | None) -> dict[str, Any] | None:
    """Return the calibration as the JSON object that docs/reference/json.md describes: that of the estimate file
    without the covariance."""
    document = calibration_document(calibration)
    return document and {key: value for key, value in document.items() if key != "covariance_um2"}


def calibration_warnings(calibration: ArtefactCalibration | None) -> tuple[str, ...]:
    """Return a warning if no length of the artefact was certified before the run."""
    if calibration is None or calibration.before.ppm <= TRACEABLE_PPM:
        return ()
    return (
        f"No length of the artefact is known better than {calibration.before.ppm:.2g} ppm: all lengths of machine and "
        "artefact may be wrong in that proportion. State end_length_mm in the artefact file.",
    )
