"""Row of results for one machine, with and without warming."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class WarmingRow:
    """Results of one machine; errors are true VCE in µm, after the best-fitting rigid motion is removed.

    Three errors are those with the table written by the run: `constant` at 20 °C throughout, `settled` at 23 °C
    throughout, and `warm` while machine and bar warm from 20 °C to 23 °C, evaluated at the last ball of the set.
    `ratio` is `warm` divided by `settled`. Two errors are those with tables identified from the same ball centres as
    `warm`: `undrifted` assumes that the machine does not drift, and `untold` assumes in addition that the bar is at
    20 °C. Two errors are evaluated at the end of the whole warm run: `late` with its table, and `bare` without a table.
    The `predicted_…` fields are the agent's own predictions.
    """

    seed: int
    minutes: float
    machine_k: float
    artefact_k: float
    bare: float
    constant: float
    settled: float
    warm: float
    late: float
    ratio: float
    undrifted: float
    untold: float
    predicted_constant: float
    predicted_settled: float
    predicted_warm: float
