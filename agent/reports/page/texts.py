"""Every text of the report that is not data, by key, so that another language is another mapping.

Values in braces are filled in by the section that shows the text. Units, ISO names and numbers are no texts.
"""

from __future__ import annotations

from collections.abc import Mapping

Texts = Mapping[str, str]

ENGLISH: Texts = {
    "language": "en",
    "note": "Please note",
    "page": "page",
    "of": "of",
    # headings
    "summary": "Before and after",
    "validity": "What the result holds for",
    "verification": "Verification by fresh measurements",
    "night": "What the night found",
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
    "null_space": "What the measurement does not see",
    "gates": "Gates and decisions",
    "consents": "What people were asked",
    "table": "Compensation table",
    "inputs": "Input files and settings",
    "events": "Events",
    "parameters": "All parameters",
    "signatures": "Signatures",
    # figures at the top
    "tile_before": "volumetric error of the bare machine, aligned",
    "tile_after": "predicted after compensation, aligned",
    "tile_held_out": "measured after compensation, held-out balls",
    "tile_chi2": "normalised χ² of the fit",
    "tile_seen": "parameters seen by the measurement",
    "tile_balls": "ball centres measured",
    "tile_minutes": "machine time",
    "tile_touches": "touches",
    "tile_state": "how the run ended",
    "tile_ve_now": "volumetric error now, acting table, expected",
    "tile_ve_before": "the same as the last accepted night left it",
    # captions and notes
    "summary_note": (
        "The volumetric error is the rms length of the tool point's deviation over a regular grid of the whole "
        "workspace. Aligned means that the best rigid motion of the workspace is taken out: no free artefact can "
        "see it, and it is no fault of the machine. Uncertainties are expanded, k = 2 (about 95 %)."
    ),
    "verification_note": (
        "Held-out positions, measured before and again with the new table active, and not used for the estimate. "
        "The line is twice the rms that the estimate, its misfit, the certificate and the touches lead one to "
        "expect."
    ),
    "night_note": "VE with a table active, expected from all that is known, rigidly aligned. Against: run {since}.",
    "trend_note": (
        "Every run of this machine up to this one. Dots: values with expanded uncertainty (k = 2); line: weighted"
        " regression with its 95 % band, steps set apart; dashed: tolerance."
    ),
    "curves_note": (
        "Errors of the bare machine with their ±2σ bands. Rows are the axes X, Y, Z; columns the errors of ISO "
        "230-1: displacements along X, Y, Z in µm, rotations about X, Y, Z in µrad. A wide band means that the "
        "measured positions say little about this function; it holds what the family of the machine allows."
    ),
    "squareness_note": (
        "Rotation of the direction of travel of the second-named axis about the lettered one, right-handed."
    ),
    "cross_note": "Added to EYZ and EAZ at full overhang of Y, over the height Z.",
    "map_note": (
        "Bare machine as estimated: length of the tool point's deviation, rigid motion taken out. Contour lines "
        "at even steps."
    ),
    "uncertainty_map_note": (
        "Standard deviation of what is left once the estimate is compensated (VCE by place). Its colour scale is "
        "its own. Dots are the measured balls nearest to each plane."
    ),
    "distribution_note": (
        "Left: a ball that stands out over all positions points at its calibrated value or at dirt. Right: dots "
        "on the line mean that the noise is as assumed (what the fit takes up is allowed for); a bent end is a "
        "heavy tail."
    ),
    "none_rejected": "No ball was rejected.",
    "qualification_note": (
        "Every touch of the qualification against the sphere through all of them. Three waves around the stylus "
        "are the lobes of a probe on three seats. Lines, where there are any, are the pretravel map that was "
        "taken off every touch."
    ),
    "parameters_note": (
        "Legendre coefficients on the axis ranges normalised to [-1, 1]; σ is the standard uncertainty."
    ),
    "inputs_note": "SHA-256 of the files as they were when the run began.",
    "gates_informative": "For information: there is no machine here that the gates would have to protect.",
    "no_estimate": (
        "The run did not come to an estimate. What had been measured by then is kept in the journal; the table "
        "that acted before the run acts still, unless an event below says otherwise."
    ),
    "prediction_only": (
        "Nothing was measured with the table active: what is said about the time after is a prediction."
    ),
    "extrapolated": "{share} % of the table's nodes lie outside the measured region.",
    "scale_at_bounds": "A scale ran into its bounds. {text}.",
    "signatures_note": "Without a signature this is a record, not a release.",
    "footer": "volcal {software}, run {run}. This page is complete in itself and needs no network.",
    # column heads
    "quantity": "quantity",
    "before": "before",
    "after": "after",
    "value": "value",
    "gate": "gate",
    "asks": "what it asks",
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
    "asked": "asked",
    "answer": "answer",
    "performed_by": "performed by",
    "checked_by": "checked by",
    "released_by": "released by",
    "place_date": "place, date",
    "signature": "signature",
    # rows
    "ve_aligned": "VE estimated, VCE predicted; aligned",
    "ve_raw": "the same as defined, not aligned",
    "held_out": "rms at held-out balls, measured",
    "held_out_head": "rms at the held-out balls",
    "held_out_before": "before (as found)",
    "held_out_after": "after (new table active)",
    "held_out_predicted": "expected from the estimate, rms",
    "at_position": "{label}: before, after",
    "of_value": "{value} of {all}",
    "gates_failed": "{state}, {gates} not passed",
    "yes": "yes",
    "no": "no: {error}",
    "open": "no answer",
}
