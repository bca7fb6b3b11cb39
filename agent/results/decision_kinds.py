"""Kinds of the decision records with the results of a run, as named in the journal.

A module of its own, because the history reads them without the mathematics that computes the results.
"""

from __future__ import annotations

INPUTS, PROBE, IDENTIFIED, HELD_OUT, OUTCOME = "inputs", "probe", "identified", "held-out", "outcome"
