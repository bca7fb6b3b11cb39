"""Search for a design (selection) of 24 artefact positions on a 15° grid at four stations, compared with direct
evaluation of its criterion.

The criterion is the expected volumetric error after compensation (VCE). At every step of the search, and for every
candidate position, the direct evaluation computes the full covariance of all unknowns of the identification with that
candidate added to the positions already chosen. From that covariance it computes the criterion as a trace. The direct
evaluation is timed on a sample of candidates and extrapolated to all candidates of all steps.

Search and direct evaluation start from the same information factors of the candidates. A factor F gives the information
matrix FᵀF that a candidate adds. The time to compute these factors and the time to predict the machine time of each
candidate are measured separately.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from time import perf_counter

import numpy as np

from agent.planning.case_file import CASE_STUDY, load_case
from agent.planning.design.design_problem import DesignProblem
from agent.runs.kinds.calibrate import calibration_of
from twin.design.candidates import CandidatePositions
from twin.design.goals import PositionCountGoal
from twin.design.search import ExchangeSearch, Selection

GRID_DEG = 15.0
POSITIONS = 24
SAMPLE = 40


def plain_value(candidates: CandidatePositions, precision: np.ndarray, index: int) -> float:
    factor = candidates.factors[index]
    covariance = np.linalg.inv(precision + factor.T @ factor)
    return float(np.vdot(candidates.form.aligned, covariance))


def plain_seconds(candidates: CandidatePositions, chosen: tuple[int, ...]) -> float:
    """Return the mean time in s of one direct evaluation of the criterion (the expected volumetric error after
    compensation) for one candidate position.

    The function also asserts that direct evaluation and search give the same criterion value for `chosen`, the selected
    positions.
    """
    precision = candidates.precision.copy()
    sample = np.linspace(0, candidates.count - 1, SAMPLE).astype(int)
    start = perf_counter()
    for index in sample:
        plain_value(candidates, precision, int(index))
    seconds = (perf_counter() - start) / SAMPLE
    for index in chosen:
        precision += candidates.factors[index].T @ candidates.factors[index]
    plain = float(np.trace(candidates.form.aligned @ np.linalg.inv(precision)))
    carried = candidates.vce(chosen).aligned_mm ** 2 - candidates.form.unresolved_mm2
    assert abs(plain / carried - 1.0) < 1e-9, "the two do not compute the same"
    return seconds


def greedy(search: ExchangeSearch) -> tuple[int, ...]:
    start = Selection.of(search.candidates)
    *_, last = search.grow(
        start, lambda chosen: np.full(search.candidates.count, len(chosen) < POSITIONS), per_minute=False
    )
    return last.chosen


def run() -> dict[str, float]:
    job = load_case(CASE_STUDY)
    problem = DesignProblem({job.settings.tool: job}, GRID_DEG, calibration_of)
    start = perf_counter()
    candidates = problem.candidates
    built = perf_counter()
    search = problem.search
    priced = perf_counter()
    grown = greedy(search)
    greedily = perf_counter()
    chosen = PositionCountGoal(POSITIONS).select(search)
    done = perf_counter()
    one = plain_seconds(candidates, chosen)
    evaluations = POSITIONS * candidates.count - POSITIONS * (POSITIONS - 1) // 2
    return {
        "candidates": candidates.count,
        "unknowns": candidates.factors.shape[2],
        "building_candidates_s": built - start,
        "pricing_candidates_s": priced - built,
        "greedy_to_24_s": greedily - priced,
        "search_to_24_with_exchange_s": done - greedily,
        "plain_evaluation_ms": 1e3 * one,
        "plain_greedy_extrapolated_s": one * evaluations,
        "plain_greedy_over_greedy": one * evaluations / (greedily - priced),
        "plain_greedy_over_whole_search": one * evaluations / (done - greedily),
        "expected_vce_of_greedy_um": candidates.vce(grown).aligned_um,
        "expected_vce_um": candidates.vce(chosen).aligned_um,
    }


def main() -> None:
    for name, figure in run().items():
        print(f"{name:36s} {figure:14.6g}")


if __name__ == "__main__":
    main()
