"""Which Legendre order the measurements speak for: the one of greatest evidence.

The evidence of an order is its marginal likelihood: poses projected out, parameters, certificate, strain and misfit
integrated out, scales at their likeliest values times their own priors. Every order is asked about the same ball
centres, so what only these say is the same for all and left out; what differs, the size of the model against what it
explains, is what the determinants are about. Outliers are therefore looked for once, with the highest order, before
any order is compared.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from twin.artefact import Artefact
from twin.errors import DataError
from twin.family import Family
from twin.identification.estimate import Estimate
from twin.identification.evidence import OrderEvidence
from twin.identification.identify import identify_kept, kept_rows
from twin.identification.options import Options
from twin.identification.problem import build_problem
from twin.identification.solution import evidence_of
from twin.observations import Observations

Orders = tuple[int, int, int]
ORDERS: tuple[Orders, ...] = tuple((order, order, order) for order in range(3, 10))


def identify_by_evidence(
    family_of: Callable[[Orders], Family],
    observations: Observations,
    artefact: Artefact,
    options: Options | None = None,
    candidates: Sequence[Orders] = ORDERS,
) -> Estimate:
    """`identify` with the likeliest of the candidates; `family_of` gives the family for Legendre orders of X, Y, Z.

    The order is judged by ball centres with full weights, whatever the formulation of the estimate. Raises DataError
    where the options leave no evidence to compare (prior off, or an estimate carried over, whose order is given).
    """
    options = options or Options()
    if not options.use_prior or options.carried_over is not None:
        raise DataError("only orders with the family as prior can be compared", hint="give the order")
    if not candidates:
        raise DataError("no order to compare")
    judged = replace(options, formulation="centres", weights="full")
    largest = family_of(max(candidates, key=sum))
    kept = kept_rows(largest, observations, artefact, judged)
    seen = observations.where(kept)
    found = []
    for orders in candidates:
        problem = build_problem(family_of(orders), seen, artefact, judged)
        evidence, scales = evidence_of(problem, judged)
        found.append((evidence, orders, scales))
    found.sort(key=lambda entry: -entry[0])
    best = found[0]
    estimate = identify_kept(family_of(best[1]), observations, artefact, options, kept)
    table = tuple(OrderEvidence(orders, evidence - best[0], scales) for evidence, orders, scales in found)
    return replace(estimate, order_evidence=table)
