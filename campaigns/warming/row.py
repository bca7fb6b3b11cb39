"""Row of results for one machine, with and without warming."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class WarmingRow:
    """Results of one machine; errors are true VCE, rigidly aligned, in µm.

    With the table written by the run: `constant` at 20 °C throughout, `settled` at 23 °C throughout, and `warm` while
    machine and bar warm from 20 °C to 23 °C, evaluated at the last ball of the set; `ratio` is warm over settled.
    With a table identified from the same ball centres as `warm`: `undrifted` without a drift of the machine, `untold`
    also without the bar's temperature (20 °C is assumed). At the end of the whole warm run: `late` with its table,
    `bare` without a table. `predicted_…` are the agent's own predictions.
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
