"""Choice of the Legendre order of the error model by evidence.

The evidence of an order is its marginal likelihood multiplied by the priors of the scales. The poses of the artefact
are eliminated by projection, and the parameters, certificate errors, thermal strain and misfit are integrated out. The
scales have their likeliest values. All orders are compared on the same ball centres, so factors common to all orders
are omitted. The determinants in the evidence balance the size of a model against the part of the data that the model
explains. Outliers are rejected once, with the highest order, before any comparison. All orders therefore use the same
ball centres.

The misfit can explain errors of high order almost as well as a model of high order can, but a compensation table
contains only the parameters and not the misfit. Therefore the highest order is chosen among all orders without very
strong evidence against them. The prior of the parameters prevents the chosen order from following noise.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

from twin.artefact.artefact import Artefact
from twin.artefact.observations import Observations
from twin.errors import DataError
from twin.identification.checks.shift_pattern import with_ball_shifts
from twin.identification.checks.wrong_balls import with_free_balls
from twin.identification.estimate import Estimate
from twin.identification.evidence import OrderEvidence
from twin.identification.identify import accepted_rows, identify_accepted
from twin.identification.options import Options
from twin.identification.roll import build_measured_problem
from twin.identification.scales import Scales
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
    """Estimate the parameters with the Legendre order that the measurements favour. The function `family_of` returns
    the family for a given order.

    Orders are compared on ball centres that are weighted by their covariances, whatever the formulation of the
    estimate. `order_evidence` of the result contains the evidence (marginal likelihood) of all candidate orders. Raise
    DataError if no comparison is possible, because the prior is off or because an estimate with a fixed order is
    carried over.
    """
    options = options or Options()
    if not options.use_prior or options.carried_over is not None:
        raise DataError("comparing orders requires the family as prior", hint="give the order explicitly")
    if not candidates:
        raise DataError("there is no order to compare")
    judged = replace(options, formulation="centres", weights="full")
    accepted = accepted_rows(family_of(max(candidates)), observations, artefact, judged)
    seen = observations.select(accepted.mask)

    def evidence_of(order: int) -> tuple[float, Scales]:
        problem = build_measured_problem(family_of(order), seen, artefact, judged)
        problem = with_ball_shifts(problem, accepted.shifts, problem.layout.order)
        return log_evidence_and_scales(with_free_balls(problem, accepted.free, judged), judged)

    evidence = {order: evidence_of(order) for order in sorted(candidates)}
    table = _compare(evidence)
    chosen = next(entry.order for entry in table if entry.chosen)
    return replace(
        identify_accepted(family_of(chosen), observations, artefact, options, accepted),
        order_evidence=table,
    )


def likeliest_order(log_evidence: Mapping[int, float]) -> int:
    """Return the highest of the orders that no other order beats by very strong evidence. `log_evidence` maps each
    order to its log evidence."""
    best = max(log_evidence.values())
    return max(order for order, log in log_evidence.items() if log > best - _VERY_STRONG)


def _compare(evidence: dict[int, tuple[float, Scales]]) -> tuple[OrderEvidence, ...]:
    best = max(log for log, _ in evidence.values())
    chosen = likeliest_order({order: log for order, (log, _) in evidence.items()})
    return tuple(OrderEvidence(order, log - best, scales, order == chosen) for order, (log, scales) in evidence.items())
