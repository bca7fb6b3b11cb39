"""Which Legendre order the measurements speak for.

The evidence of an order is its marginal likelihood: poses projected out, parameters, certificate, strain and misfit
integrated out, scales at their likeliest values times their own priors. Every order is asked about the same ball
centres, so what only these say is the same for all and left out; the size of a model against what it explains is in
its determinants. Outliers are therefore looked for once, with the highest order, before any order is compared.

What a low order leaves, its misfit explains nearly as well; but a table holds the parameters and not the misfit. So of
all orders against which there is no very strong evidence the highest is taken: its prior keeps it from following noise.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from twin.artefact.artefact import Artefact
from twin.artefact.observations import Observations
from twin.errors import DataError
from twin.identification.estimate import Estimate
from twin.identification.evidence import OrderEvidence
from twin.identification.identify import accepted_rows, identify_accepted
from twin.identification.normal import Scales
from twin.identification.options import Options
from twin.identification.problem import build_problem
from twin.identification.solution import log_evidence_and_scales
from twin.machine.machine_population import Family

ORDERS = tuple(range(3, 10))
_VERY_STRONG = 5.0  # ln of the Bayes factor, Kass and Raftery 1995


def identify_by_evidence(
    family_of: Callable[[int], Family],
    observations: Observations,
    artefact: Artefact,
    options: Options | None = None,
    candidates: Sequence[int] = ORDERS,
) -> Estimate:
    """`identify` with the order for which the measurements speak; `family_of` gives the family for a Legendre order.

    The order is judged by ball centres with full weights, whatever the formulation of the estimate, and the evidence
    of all candidates is in `order_evidence` of the result. Raises DataError where there is nothing to compare (prior
    off, or an estimate carried over, whose order is given).
    """
    options = options or Options()
    if not options.use_prior or options.carried_over is not None:
        raise DataError("orders are compared with the family as prior, not without it", hint="give the order")
    if not candidates:
        raise DataError("no order to compare")
    judged = replace(options, formulation="centres", weights="full")
    accepted = accepted_rows(family_of(max(candidates)), observations, artefact, judged)
    seen = observations.where(accepted)
    evidence = {
        order: log_evidence_and_scales(build_problem(family_of(order), seen, artefact, judged), judged)
        for order in sorted(candidates)
    }
    table = _judged(evidence)
    chosen = next(entry.order for entry in table if entry.chosen)
    return replace(
        identify_accepted(family_of(chosen), observations, artefact, options, accepted),
        order_evidence=table,
    )


def _judged(evidence: dict[int, tuple[float, Scales]]) -> tuple[OrderEvidence, ...]:
    best = max(log for log, _ in evidence.values())
    chosen = max(order for order, (log, _) in evidence.items() if log > best - _VERY_STRONG)
    return tuple(OrderEvidence(order, log - best, scales, order == chosen) for order, (log, scales) in evidence.items())
