"""Renewal of the posterior after one more measured position, with the choice of the next one, compared with the whole
identification of all measured positions.

Both use the same simulated measurements of the case study and compare the same orders. The renewal adds the normal
equations of one position and begins the search for the scales with those of the step before. The times are medians over
the positions from `FIRST` to `LAST`, in one thread.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from time import perf_counter

import numpy as np

from agent.planning.case_file import CASE_STUDY, load_case
from agent.planning.design.sequential_candidates import SequentialCandidates, standing_in
from twin.identification import Options, identify_by_evidence
from twin.uncertainty.random_machines import draw_random_machine

FIRST, LAST = 6, 16
TEMPERATURE_K = 0.1


def main() -> None:
    job = load_case(CASE_STUDY)
    candidates = SequentialCandidates(job)
    start = perf_counter()
    seen = candidates.nothing_seen()
    print(f"{len(candidates.positions)} candidates of {len(seen.models)} orders: {perf_counter() - start:.2f} s, once")
    rng = np.random.default_rng(1)
    planned = job.procedure.plan(candidates.positions).observations
    measured = draw_random_machine(job.machine, job.tool_offset_mm, "rails", rng).measure(planned, job.artefact, rng)
    options = Options(temperature_standard_uncertainty_k=TEMPERATURE_K)
    chosen: list[int] = []
    renewals, choices, whole = list[float](), list[float](), list[float]()
    while len(chosen) < LAST:
        start = perf_counter()
        done = [candidates.positions[index] for index in chosen]
        ranked = candidates.ranked(seen, standing_in(done[-1]) if done else None, done)
        choices.append(perf_counter() - start)
        chosen.append(candidates.positions.index(ranked[0]))
        start = perf_counter()
        seen = seen.after(measured.select(measured.position == chosen[-1]))
        renewals.append(perf_counter() - start)
        if len(chosen) >= FIRST:
            start = perf_counter()
            every = measured.select(np.isin(measured.position, chosen))
            identify_by_evidence(lambda order: job.machine.with_order(order).family, every, job.artefact, options)
            whole.append(perf_counter() - start)
    renewal, choice, identification = (
        1e3 * float(np.median(values)) for values in (renewals[FIRST - 1 :], choices[FIRST:], whole)
    )
    print(f"renewal {renewal:.0f} ms, choice {choice:.0f} ms; whole identification {identification:.0f} ms")
    print(f"ratio: {identification / (renewal + choice):.1f}")


if __name__ == "__main__":
    main()
