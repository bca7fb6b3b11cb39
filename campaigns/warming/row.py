"""Row of results of the warming trial for one machine."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class WarmingRow:
    """Results for one machine after three calibrations: at 20 °C, at 23 °C, and while it warmed from 20 °C to
    23 °C.

    The third calibration is called the warm run. `minutes` is the machine time of the warm run. `machine_k` and
    `artefact_k` are the temperature changes in K of the machine and the ball bar between the first and the last ball of
    the warm run before the verification.

    `constant`, `settled`, `warm`, `undrifted`, `untold`, `late` and `bare` are true volumetric errors in µm, after the
    best-fitting rigid motion is removed. `constant` is the error with the compensation table of the calibration at 20
    °C. `settled` is the error with the table of the calibration at 23 °C. `warm` is the error with the table of the
    warm run, for the machine as it was at the last ball before the verification. `ratio` is `warm` divided by
    `settled`.

    `undrifted` and `untold` are errors for the same state of the machine as `warm`, but with other tables. Both tables
    are identified from the ball centres of the warm run. For `undrifted`, the identification assumes that the machine
    does not drift. For `untold`, the identification assumes in addition that the bar has a temperature of 20 °C.

    `late` and `bare` are errors for the machine as it is at the end of the warm run. `late` is the error with the table
    of the warm run, and `bare` is the error without a table.

    `predicted_constant`, `predicted_settled` and `predicted_warm` are the errors in µm that the agent itself predicts
    after each of the three calibrations.
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
