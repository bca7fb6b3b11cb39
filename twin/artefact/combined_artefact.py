"""Combination of several artefacts of one kind in one estimate of the machine errors. Each artefact has its own
calibration certificate.

Each position contains the balls of only one artefact and has its own pose, so the artefacts are independent. The
combined list contains the balls of one artefact after the other, each in the frame of its artefact. The certificates
are assumed to be uncorrelated.

The artefacts are made of one material. The error of the expansion coefficient is assumed to be the same for all of
them, as for bars from one melt. A common error changes the estimated length scales of the machine axes, whereas errors
of opposite sign cancel. If the errors actually differ, the assumption therefore does not understate the uncertainty of
these scales.
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
    "sag_standard_uncertainty_mm",
)


def combine_artefacts(artefacts: Sequence[Artefact]) -> Artefact:
    """Combine several artefacts into one that contains all their balls, in the given order of the artefacts.

    Raises DataError if there are no artefacts or if the artefacts are not of the same kind, that is, differ in their
    number of balls or in their dimensions.
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
        uncertified=tuple(first.count * number + ball for number, a in enumerate(artefacts) for ball in a.uncertified),
        body=replace(first.body, feet_mm=None if first.body.feet_mm is None else first.body.feet_mm * len(artefacts)),
        members=tuple(number for number, a in enumerate(artefacts) for _ in range(a.count)),
    )


def _require_one_kind(first: Artefact, other: Artefact) -> None:
    if other.count != first.count:
        raise DataError(
            f"'{other.name}' has {other.count} balls, '{first.name}' has {first.count}",
            hint="all artefacts of one run must be of the same kind",
        )
    if other.body != first.body:
        raise DataError(
            f"the holders or the other solid parts of '{other.name}' differ from those of '{first.name}'",
            hint="all artefacts of one run must be of one kind; only ball centres and certificates may differ",
        )
    for name in KIND_FIELDS:
        if getattr(other, name) != getattr(first, name):
            raise DataError(
                f"'{other.name}' has {name} = {getattr(other, name):g}, '{first.name}' has {getattr(first, name):g}",
                hint="all artefacts of one run must be of one kind; only ball centres and certificates may differ",
            )
