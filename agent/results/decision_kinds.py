"""Names of the kinds of decision with which the journal records the results of a run.

The names are in a module of their own. The history of runs can therefore import them without loading the modules that
compute the results.
"""

from __future__ import annotations

INPUTS, PROBE, IDENTIFIED, HELD_OUT, OUTCOME = "inputs", "probe", "identified", "held-out", "outcome"
CONFIRMED, PROOF = "confirmed", "proof"
TRIAL = "try"
