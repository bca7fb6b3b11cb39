"""Texts of the report, as a mapping from keys to English texts. A report in another language is rendered with a
different mapping.

Values in braces are filled in by the section that shows the text. Units, ISO names and numbers are not part of the
mapping.
"""

from __future__ import annotations

from collections.abc import Mapping

Texts = Mapping[str, str]

ENGLISH: Texts = {
    "language": "en",
    "note": "Notes",
    "page": "page",
    "of": "of",
    # headings
    "summary": "Before and after",
    "validity": "Validity of the result",
    "verification": "Verification by new measurements",
    "night": "Result of the night",
    "trend": "Trend",
    "errors": "The 21 geometric errors",
    "squareness": "Squareness",
    "cross": "Cross-effect of ram and column",
    "map": "Error map of the workspace",
    "uncertainty_map": "Predicted error after compensation",
    "residuals": "Residuals at the balls",
    "rejected": "Rejected balls",
    "temperatures": "Temperatures",
    "probe": "Probe and stylus",
    "fit": "Fit",
    "calibration": "Certificate of the artefact by this run",
    "null_space": "Undetermined parameter combinations",
    "gates": "Gates and decisions",
    "consents": "Questions to the operator",
    "table": "Compensation table",
    "inputs": "Input files and settings",
    "events": "Events",
    "parameters": "All parameters",
    "signatures": "Signatures",
    # figures at the top
    "tile_before": "VE without table, aligned",
    "tile_after": "VCE with table, aligned",
    "tile_held_out": "measured after compensation, held-out balls",
    "tile_chi2": "normalised χ² of the fit",
    "tile_seen": "parameters determined by the measurement",
    "tile_balls": "ball centres measured",
    "tile_minutes": "machine time",
    "tile_touches": "touches",
    "tile_state": "end of the run",
    "tile_ve_now": "VCE with table, expected now, aligned",
    "tile_ve_before": "VCE after the last accepted night",
    # captions and notes
    "calibration_note": (
        "Ball centres at the reference temperature, estimated together with the errors of the machine, and their "
        "expanded uncertainties, k = 2. artefact.toml and artefact-covariance.csv beside this report hold them with "
        "all correlations."
    ),
    "summary_note": (
        "The volumetric error (VE) is the rms length of the deviation of the tool point over a regular grid of the"
        " whole workspace. Aligned: the best-fit rigid motion of the workspace is removed; a free artefact cannot "
        "determine it, and it is not an error of the machine. Uncertainties are expanded, k = 2 (about 95 %)."
    ),
    "verification_note": (
        "Held-out positions, measured before and again with the new table active, and not used for the estimate. "
        "The line is twice the rms expected from estimate, misfit, certificate and touch repeatability."
    ),
    "night_note": "Expected VCE with the active table, rigidly aligned. Reference: run {since}.",
    "trend_note": (
        "All runs of this machine up to this one. Points: values with expanded uncertainty (k = 2). Line: weighted"
        " regression with its 95 % band, separate sections at steps. Dashed: tolerance."
    ),
    "curves_note": (
        "Errors of the machine without table, with ±2σ bands. Rows: axes X, Y, Z. Columns: errors of ISO 230-1, "
        "displacements along X, Y, Z in µm and rotations about X, Y, Z in µrad. A wide band means that the "
        "measured positions hardly determine this function; it then follows the machine family."
    ),
    "squareness_note": (
        "Right-handed rotation of the direction of travel of the axis in the last letter about the axis of the "
        "first letter."
    ),
    "cross_note": "Added to EYZ and EAZ at full overhang of Y, over the height Z.",
    "travel_note": (
        "VE estimated and VCE predicted, aligned over the whole travel, with 95 % limits. Outside the measured region "
        "no ball was measured: there the values rest on the machine family and on the form of the error model."
    ),
    "map_note": (
        "Machine without table as identified: length of the deviation of the tool point, rigid motion removed. "
        "Contour lines at equal intervals."
    ),
    "uncertainty_map_note": (
        "Standard deviation of the error that remains after compensation of the estimate (VCE by location). The "
        "colour scale differs from that above. Dots: measured balls nearest to each plane."
    ),
    "distribution_note": (
        "Left: a ball that stands out over all positions indicates a wrong calibrated value or dirt. Right: points"
        " on the line mean that the noise is as assumed (allowing for the degrees of freedom of the fit); curved "
        "ends indicate heavy tails."
    ),
    "none_rejected": "No ball was rejected.",
    "qualification_note": (
        "Every touch of the qualification relative to the sphere fitted to all of them. Three waves around the "
        "stylus are the lobes of a probe with a three-point seat. Lines, if any, are the pretravel map subtracted "
        "from every touch."
    ),
    "parameters_note": "Legendre coefficients on the axis ranges normalised to [-1, 1]; σ is the standard uncertainty.",
    "inputs_note": "SHA-256 of the files at the start of the run.",
    "no_estimate": (
        "This run has no estimate. Its measurements are stored in the journal. The table that "
        "was active before the run is still active, unless an event below states otherwise."
    ),
    "prediction_only": "No measurement was made with the table active: values after compensation are predictions.",
    "extrapolated": "{share} % of the nodes of the table are outside the measured region.",
    "scale_at_bounds": "A scale factor reached its bounds. {text}.",
    "signatures_note": "Without signatures this is a record, not a release.",
    "footer": "volcal {software}, run {run}. This page is self-contained and needs no network.",
    # column heads
    "quantity": "quantity",
    "before": "before",
    "after": "after",
    "value": "value",
    "gate": "gate",
    "asks": "criterion",
    "limit": "limit",
    "result": "result",
    "passed": "passed",
    "not_passed": "not passed",
    "name": "name",
    "unit": "unit",
    "file": "file",
    "digest": "SHA-256",
    "time": "time (UTC)",
    "kind": "kind",
    "event": "event",
    "minute": "minute",
    "asked": "question",
    "answer": "answer",
    "role": "role",
    "performed_by": "performed by",
    "checked_by": "checked by",
    "released_by": "released by",
    "place_date": "place, date",
    "signature": "signature",
    # rows
    "ve_aligned": "VE without table, VCE with table; aligned",
    "travel": "part of the travel",
    "travel_measured": "inside the measured region ({share} %)",
    "travel_unmeasured": "outside the measured region ({share} %)",
    "held_out": "rms at held-out balls, measured",
    "held_out_head": "rms at the held-out balls",
    "held_out_before": "before (initial state)",
    "held_out_after": "after (new table active)",
    "held_out_predicted": "expected from the estimate, rms",
    "held_out_choice": "choice of the positions",
    "held_out_least_known": "where the table is least known",
    "held_out_listed": "as listed in the settings",
    "at_position": "{label}: before, after",
    "of_value": "{value} of {all}",
    "gates_failed": "{state}, {gates} not passed",
    "yes": "yes",
    "no": "no: {error}",
    "open": "no answer",
}
