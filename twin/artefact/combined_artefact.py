"""Combination of several artefacts of one kind, each with its own certificate, in one estimate.

A position contains balls of one artefact only and has its own pose, so the artefacts are independent. Their balls are
listed one artefact after the other, each in its own frame, and their certificates are uncorrelated.

The artefacts are made of one material. The error of its expansion coefficient is assumed common to all, as for bars
from one melt. If the errors differ, this assumption is still cautious for the scales of the machine, because a common
strain changes the scales, whereas strains of opposite sign cancel.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from twin.artefact.artefact import Artefact
from twin.errors import DataError

KIND_FIELDS = (
    "ball_diameter_mm",
    "reference_temperature_c",
    "cte_per_k",
    "cte_standard_uncertainty_per_k",
    "holder_length_mm",
    "sag_mm",
)


def combine_artefacts(artefacts: Sequence[Artefact]) -> Artefact:
    """Combine the balls of all artefacts in the given order.

    Raises DataError if there are no artefacts or if their kinds differ.
    """
    if not artefacts:
        raise DataError("no artefact given")
    first = artefacts[0]
    for other in artefacts[1:]:
        _require_one_kind(first, other)
    covariance = np.zeros((sum(3 * a.count for a in artefacts),) * 2)
    at = 0
    for artefact in artefacts:
        size = 3 * artefact.count
        covariance[at : at + size, at : at + size] = artefact.covariance
        at += size
    return replace(
        first,
        name=" + ".join(dict.fromkeys(a.name for a in artefacts)),
        certificate="; ".join(a.certificate for a in artefacts),
        balls=np.concatenate([a.balls for a in artefacts]),
        covariance=covariance,
        members=tuple(number for number, a in enumerate(artefacts) for _ in range(a.count)),
    )


def _require_one_kind(first: Artefact, other: Artefact) -> None:
    if other.count != first.count:
        raise DataError(
            f"'{other.name}' has {other.count} balls, '{first.name}' has {first.count}",
            hint="all artefacts of one run must be of the same kind",
        )
    for name in KIND_FIELDS:
        if getattr(other, name) != getattr(first, name):
            raise DataError(
                f"'{other.name}' has {name} = {getattr(other, name):g}, '{first.name}' has {getattr(first, name):g}",
                hint="all artefacts of one run must be of one kind; only ball centres and certificates may differ",
            )
