"""One machine that warms, as a row of the result."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Row:
    """One machine. True VCE, aligned, µm: with the run's table at `constant` temperature (20 °C), `settled` at 23 °C,
    and `warm`, while it warms from the one to the other; `ratio` of the last two. By the ball centres of the warm run,
    `undrifted` without the machine's drift, `untold` with no temperature known at all. `late`: warm, at the end of the
    whole run; `bare`: then without any table."""

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
