"""Names that the journal uses for the kinds of decision that record the results of a run.

This module is separate so that the history can import it without the mathematics that computes the results.
"""

from __future__ import annotations

INPUTS, PROBE, IDENTIFIED, HELD_OUT, OUTCOME = "inputs", "probe", "identified", "held-out", "outcome"
