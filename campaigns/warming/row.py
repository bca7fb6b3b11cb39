"""Row of results for one machine that warms."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class WarmingRow:
    """Results of one machine: true VCE, aligned, in µm.

    With the run's table: `constant` at 20 °C, `settled` at 23 °C, and `warm` while it warms from the one to the other;
    `ratio` is warm over settled. From the ball centres of the warm run: `undrifted` without the machine's drift,
    `untold` without any known temperature. `late`: warm, at the end of the whole run; `bare`: the same without any
    table.
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
