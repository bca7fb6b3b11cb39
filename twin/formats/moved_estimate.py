"""Estimate file of a machine that has changed since it was measured, as predicted by its temperatures."""

from __future__ import annotations

import json
from collections.abc import Mapping

import numpy as np

from twin.errors import DataError
from twin.formats.prior_section import KEY, carried_over_document
from twin.identification import CarriedOverPrior


def moved_estimate(text: str, moved: CarriedOverPrior, provenance: Mapping[str, str]) -> str:
    """Return the text of an estimate file with the parameters, covariances and unknowns of `moved`.

    `text` is the file of the estimate from which `moved` was made. What it says of the measurements (χ², rank, rejected
    balls) stays; the volumetric errors, which have changed, are left out. `provenance` is added to that of the file.
    Raises DataError if the file has another number of parameters.
    """
    document = json.loads(text)
    unknowns, own = moved.unknowns, moved.unknowns.blocks.parameters
    values = unknowns.parameters(moved.mean)
    covariance = unknowns.physical_covariance(moved.covariance[own, own])
    if len(document["parameters"]) != len(values):
        raise DataError(f"the estimate has {len(document['parameters'])} parameters, not {len(values)}")
    for one, value, variance in zip(document["parameters"], values, np.diag(covariance), strict=True):
        one["value"], one["standard_uncertainty"] = float(value), float(np.sqrt(max(variance, 0.0)))
    document["covariance"] = covariance.tolist()
    document["volumetric"] = None
    document["provenance"] = {**document["provenance"], **provenance}
    before = document[KEY]
    section = carried_over_document(unknowns, moved.mean, moved.covariance, moved.drift_factor, moved.trend)
    document[KEY] = {**before, **section}
    return json.dumps(document, allow_nan=False, indent=1) + "\n"
