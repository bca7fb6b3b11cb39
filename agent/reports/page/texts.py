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
    # head of the document
    "report": "Report",
    "report_number": "Report number",
    "customer": "Customer",
    "machine_maker": "Machine, maker",
    "machine_model": "Machine, model",
    "machine_serial": "Machine, serial number",
    "place": "Place",
    "operator": "Operator",
    "not_stated": "not stated",
    "instrument": "instrument",
    "instrument_probe": "Probe",
    "instrument_sensor": "Sensor",
    "instrument_artefact": "Artefact",
    "instrument_thermometer": "Thermometer",
    "instrument_other": "Instrument",
    "serial_number": "serial number",
    "certificate": "certificate",
    "calibrated": "calibrated",
    "due": "next due",
    "calibration_overdue": (
        "{instrument} ({said}): the calibration was due on {due}, before this measurement of {measured}."
    ),
    "calibrated_later": "{instrument} ({said}): the calibration of {day} is later than this measurement of {measured}.",
    "convention": (
        "All uncertainties in this report are expanded uncertainties U with the coverage factor k = 2, for a coverage "
        "probability of about 95 %. Where a distribution is not symmetrical, its 95 % limits stand instead. A "
        "repeatability is twice a standard deviation. An rms is a size, not an uncertainty."
    ),
    "document_unread": "The section [report] of the settings of this run cannot be read and is left out: {error}.",
    # method and standards
    "method": "Method and standards",
    "method_measured": (
        "The centres of the balls of the artefact were measured with the probe of the machine in several positions of "
        "the artefact, each centre from several touches."
    ),
    "method_identified": (
        "The geometric errors were identified from all centres together by least squares. The pose of the artefact in "
        "each position is unknown."
    ),
    "method_weights": "The centres were weighted with the covariances of touches, certificate and temperature.",
    "method_family": "The known spread of machines of this kind (machine family) determines what the positions do not.",
    "method_verified": (
        "The new table was then checked by measurements at positions that the estimate does not use; the result is in "
        "the section Verification."
    ),
    "standard_names": "ISO 230-1: names and signs of the geometric errors",
    "standard_compensation": "ISO/TR 16907: numerical compensation, volumetric error",
    "standard_probe": "ISO 230-10: checks of the probe on the machine",
    "standard_temperature": "ISO 1: reference temperature of 20 °C",
    "standard_uncertainty": "JCGM 100 (GUM): expression of uncertainty",
    "standard_decision": "ISO 14253-1: decision rule for the tolerances",
    "not_an_acceptance_test": "This is not an acceptance test after ISO 230-2, ISO 230-4 or ISO 230-6.",
    # headings
    "instruments": "Instruments",
    "map_pair": "Error map, without and with the table",
    "budget": "Budget of uncertainty",
    "acceptance": "Predicted figures of acceptance tests",
    "figure": "figure",
    "standard": "standard",
    "value_without": "without table / µm",
    "limits_without": "U or limits, without",
    "value_with": "with table / µm",
    "limits_with": "U or limits, with",
    "run": "The run",
    "summary": "Before and after",
    "validity": "Validity of the result",
    "verification": "Verification by new measurements",
    "night": "Result of the night",
    "trend": "Trend",
    "errors": "The 21 geometric errors",
    "cross": "Cross-effect",
    "map": "Error maps at three heights",
    "residuals": "Residuals at the balls",
    "rejected": "Rejected balls",
    "temperatures": "Temperatures",
    "probe": "Probe and stylus",
    "fit": "Fit",
    "joined": "Readings of other instruments",
    "calibration": "Artefact as measured by this run",
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
    "acceptance_note": (
        "What a laser, a level and a ballbar will show at the middle of the travel, predicted from the estimate. "
        "Squarenesses and angles are in µm over 1000 mm, which is µrad; a table does not change angles. Ranges cannot "
        "be negative and have 95 % limits instead of U (k = 2). A, E, R and B contain the lost motion and the "
        "repeatability that this run measured at one place; all other figures are those of the geometry alone."
    ),
    "joined_note": (
        "Each instrument is tested against the ball centres and the other instruments. The probability is that of such "
        "a χ² or such a largest difference, at most, if all are right. The largest difference is that of one reading, "
        "in its own standard uncertainty, after the set-up has been fitted."
    ),
    "calibration_note": (
        "Ball centres at the reference temperature, estimated together with the errors of the machine, with U (k = "
        "2). This is not a certificate of calibration. artefact.toml and artefact-covariance.csv beside this report "
        "hold them with all correlations."
    ),
    "summary_note": (
        "The volumetric error (VE) is the rms length of the deviation of the tool point over a regular grid of the"
        " whole workspace. Aligned: the best-fit rigid motion of the workspace is removed; a free artefact cannot "
        "determine it, and it is not an error of the machine."
    ),
    "verification_note": (
        "Held-out positions, measured before and again with the new table active, and not used for the estimate. "
        "The line is the limit, twice the rms expected from estimate, misfit, certificate and touch repeatability."
    ),
    "night_note": "Expected VCE with the active table, rigidly aligned. Reference: run {since}.",
    "trend_note": (
        "All runs of this machine up to this one. Points: values with expanded uncertainty (k = 2). Line: weighted"
        " regression with its 95 % band, separate sections at steps. Dashed: tolerance."
    ),
    "curves_note": (
        "Errors of the machine without table, with bands of ±U (k = 2). Rows: axes X, Y, Z. Columns: errors of ISO "
        "230-1, displacements along X, Y, Z in µm and rotations about X, Y, Z in µrad. A wide band means that the "
        "measured positions hardly determine this function; it then follows the machine family."
    ),
    "squareness_note": (
        "Machine without table. Size: range of the error over the travel (largest difference between two points; a "
        "straightness relative to a straight line), or the value of a squareness (right-handed rotation of the "
        "direction of travel of the axis in the last letter about the axis of the first letter). U: k = 2."
    ),
    "cross_note": (
        "Added to these error motions with the other axes at the upper ends of their ranges (a ram fully extended)."
    ),
    "travel_note": (
        "VE estimated and VCE predicted, aligned over the whole travel, with 95 % limits. Outside the measured region "
        "no ball was measured: there the values rest on the machine family and on the form of the error model."
    ),
    "map_pair_note": (
        "Expected error of the tool point (root of its expected square, rigid motion removed) at mid-height. Without "
        "table: the identified error and what remains unknown. With table: what remains unknown. Dots: measured balls "
        "nearest to this height."
    ),
    "map_note": "As on the summary, at the lower end, the middle and the upper end of the Z travel, on one scale.",
    "error": "error",
    "meaning": "meaning",
    "size": "size",
    "expanded": "U",
    "tolerance": "tolerance",
    "conformity": "statement",
    "conforms": "conforms",
    "does_not_conform": "does not conform",
    "undecided": "neither proven",
    "not_determined": "not determined by this run",
    "no_conformity": "No conformity with a tolerance is stated, because of how the run ended.",
    "table_not_active": "the new table is not active",
    "tolerated_ve": "VE without table",
    "tolerated_vce": "VCE with table, predicted",
    "value_um": "value / µm",
    "lower": "lower limit / µm",
    "upper": "upper limit / µm",
    "limits": "Tolerances of the volumetric error",
    "decision_rule": (
        "Decision rule after ISO 14253-1 with a guard band of U (k = 2), or of the 95 % limits: it conforms if its "
        "size and U together are within the tolerance, and does not conform if its size less U is beyond it. In "
        "between, neither is proven. For positioning and straightness, U is widened by the waves that are too short "
        "for the error model; tilts and rolls are judged without such waves."
    ),
    "budget_note": (
        "VCE: rms error that each influence leaves after compensation. Other columns: contribution to U (k = 2) of "
        "the VE without table, to first order, of the ranges of the positioning errors, and of the squarenesses. The "
        "squares of a column add up. Temperature, expansion, certificate and sag are what would vanish if they were "
        "known, in this order; the stated thermometer, certificate and artefact file determine them."
    ),
    "influence": "influence",
    "budget_vce": "VCE / µm",
    "budget_ve": "U(VE) / µm",
    "combined": "combined",
    "influence centres": "ball centres (touches, drift within the run)",
    "influence centres and prior": "ball centres and earlier knowledge",
    "influence centres, joined": "ball centres and other instruments",
    "influence centres and prior, joined": "ball centres, other instruments and earlier knowledge",
    "influence certificate": "certificate of the artefact",
    "influence temperature": "temperature of the artefact",
    "influence expansion": "expansion coefficient of the artefact",
    "influence sag": "sag of the artefact",
    "influence undetermined": "errors the positions do not determine",
    "influence form": "errors found that a table of these 21 errors cannot express",
    "influence short waves": "short waves along the axes",
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
    "parameters_note": (
        "Legendre coefficients on the axis ranges normalised to [-1, 1]; U is the expanded uncertainty (k = 2)."
    ),
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
    "measured_by": "Measured by",
    "approved_by": "Approved by",
    "signature_line": "place, date, signature",
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
