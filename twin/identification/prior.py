"""Unknowns of an identification and their units. Both are taken from the family and the certificate of the artefact, or
from an earlier estimate."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from twin.arrays import Array, as_vector
from twin.artefact.artefact import Artefact
from twin.artefact.certificate import has_certificate
from twin.artefact.observations import Observations
from twin.errors import DataError
from twin.identification.misfit import MisfitModes, misfit_modes
from twin.identification.options import Options
from twin.identification.unknowns import ArtefactErrors, Sag, Unknowns
from twin.machine.machine_population import Family
from twin.thermal.machine_drift import MachineDrift


def unknowns_of(family: Family, artefact: Artefact, seen: Observations, options: Options) -> Unknowns:
    """Return the unknowns of an identification. Their units are the standard deviations of the family or, if an earlier
    estimate is carried over as the prior, the units of this estimate.

    Raise DataError if the prior is zero, has the wrong shape or belongs to a different model, or if the weights are
    equal although the artefact has no certificate.
    """
    if options.weights == "unit" and not has_certificate(artefact.balls, artefact.covariance):
        raise DataError(
            f"equal weights take the balls of the artefact '{artefact.name}' as exact, but it has no certificate",
            hint="use full weights: they estimate the centres together with the machine",
        )
    errors, carried = _artefact_errors(artefact, options), options.carried_over
    scale = _scale(family, options) if carried is None else carried.unknowns.scale
    drift, noise_mm2 = _drift(family, seen, options, scale), seen.coordinate_variance_mm2
    if carried is None:
        modes = _modes(family, seen) if options.misfit_mm > 0.0 else None
        return Unknowns(family.model, scale, errors, modes, options.misfit_mm, drift, noise_mm2)
    old = carried.unknowns
    if old.model != family.model:
        raise DataError("the carried-over estimate belongs to another model", hint="identify with its model")
    if old.artefact.matches(artefact):
        thermometer = options.temperature_standard_uncertainty_k
        if thermometer is None:
            thermometer = old.artefact.thermometer_standard_uncertainty_k
        errors = replace(old.artefact, thermometer_standard_uncertainty_k=thermometer, sag=errors.sag)
    if old.modes is None and options.misfit_mm > 0.0:
        return Unknowns(old.model, old.scale, errors, _modes(family, seen), options.misfit_mm, drift, noise_mm2)
    return Unknowns(old.model, old.scale, errors, old.modes, old.misfit_mm, drift, noise_mm2)


def _drift(family: Family, seen: Observations, options: Options, scale: Array) -> MachineDrift | None:
    regressor_count = seen.thermal_regressors.shape[1]
    if options.drift is None or regressor_count == 0:
        return None
    return options.drift.unknowns(family.model, regressor_count, scale > 0.0)


def _scale(family: Family, options: Options) -> Array:
    model, scale = family.model, options.prior_standard_deviation
    if scale is None:
        scale = family.prior_standard_deviation
    scale = as_vector(scale, model.size, "prior standard deviation")
    if (scale < 0.0).any():
        raise DataError("a prior standard deviation is negative", parameter=model.names[int(np.argmin(scale))])
    if not scale.any():
        raise DataError(
            "every prior standard deviation is zero, so there is nothing to identify",
            hint="give the machine's family half-widths above zero ([model.family])",
        )
    return scale


def _artefact_errors(artefact: Artefact, options: Options) -> ArtefactErrors:
    return ArtefactErrors(
        balls=artefact.balls,
        cte_per_k=artefact.cte_per_k,
        certificate=_certificate_factor(artefact.covariance),
        cte_standard_uncertainty_per_k=artefact.cte_standard_uncertainty_per_k,
        thermometer_standard_uncertainty_k=options.temperature_standard_uncertainty_k or 0.0,
        uncertified=artefact.uncertified,
        sag=Sag.of(artefact),
    )


def _certificate_factor(covariance: Array) -> Array:
    """Return a matrix L (3N, m) with L Lᵀ equal to the covariance of the certificate. Directions in which the
    certificate has no uncertainty are left out."""
    diagonal = np.diagonal(covariance)
    if np.count_nonzero(covariance) == np.count_nonzero(diagonal):
        factor = np.diag(np.sqrt(diagonal))
    else:
        factor = _symmetric_factor(covariance, "the covariance of the certificate")
    return factor[:, np.abs(factor).max(axis=0) > 0.0]


def _modes(family: Family, seen: Observations) -> MisfitModes:
    main_tool = int(np.bincount(seen.tool).argmax())
    x, y, z = seen.tool_offsets[main_tool].tolist()
    return misfit_modes(family.model, (x, y, z))


def _symmetric_factor(covariance: Array, name: str) -> Array:
    """Return a matrix L with L Lᵀ = covariance. Raise DataError if the matrix is not positive semi-definite."""
    scale = np.sqrt(np.maximum(np.diagonal(covariance), 0.0))
    scale = np.where(scale > 0.0, scale, 1.0)
    values, vectors = np.linalg.eigh(covariance / np.multiply.outer(scale, scale))
    if values[0] < -1e-9 * max(values[-1], 1.0):
        raise DataError(f"{name} is not positive semi-definite")
    factor: Array = scale[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))
    return factor
