"""Unknowns that all positions of an identification share, each in units of its prior standard deviation."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from twin.arrays import Array
from twin.artefact.artefact import Artefact
from twin.artefact.artefact_calibration import ArtefactCalibration, artefact_calibration
from twin.artefact.certificate import has_certificate
from twin.identification.misfit import MisfitModes
from twin.identification.scales import Scales
from twin.machine.error_model import ErrorModel
from twin.thermal.machine_drift import MachineDrift

_COVARIANCE_TOLERANCE = 1e-9  # of both standard deviations: tolerance for two covariances of the same certificate

Indices = np.ndarray[Any, np.dtype[np.int64]]


@dataclass(frozen=True, eq=False)
class UnknownBlocks:
    """Slices that select each kind of unknown from the vector z of all unknowns of an identification.

    The slice `misfit` is divided into the consecutive slices `kinds`, one for each kind of misfit. `drifting` is the
    number of unknowns of the machine's drift, and `shifting` that of the shifts of the balls. Both describe only this
    measurement and form the last two blocks.
    """

    parameters: slice
    certificate: slice
    strain: slice
    sag: slice
    misfit: slice
    kinds: tuple[slice, ...] = ()
    drifting: int = 0
    shifting: int = 0

    @classmethod
    def of(
        cls,
        parameters: int,
        certificate: int,
        strain: int,
        misfit: Sequence[int] = (),
        *,
        sag: int = 0,
        drift: int = 0,
        shifts: int = 0,
    ) -> UnknownBlocks:
        """Return consecutive blocks of the given sizes (numbers of unknowns). `misfit` contains the block size of each
        kind of misfit."""
        ends = np.cumsum([parameters, certificate, strain, sag, *misfit]).tolist()
        parts = (slice(start, end) for start, end in zip([0, *ends[:-1]], ends, strict=True))
        first, second, third, fourth, *kinds = parts
        return cls(first, second, third, fourth, slice(fourth.stop, ends[-1]), tuple(kinds), drift, shifts)

    @property
    def drift(self) -> slice:
        return slice(self.misfit.stop, int(self.misfit.stop) + self.drifting)

    @property
    def shifts(self) -> slice:
        return slice(self.drift.stop, self.size)

    @property
    def size(self) -> int:
        return int(self.misfit.stop) + self.drifting + self.shifting


@dataclass(frozen=True)
class Sag:
    """Stated sag of a bar with its standard uncertainty, both in mm: the distance by which its ends hang below its
    middle. Other artefacts have none."""

    stated_mm: float = 0.0
    standard_uncertainty_mm: float = 0.0

    @classmethod
    def of(cls, artefact: Artefact) -> Sag:
        return cls(artefact.sag_mm, artefact.sag_standard_uncertainty_mm if artefact.is_single_bar else 0.0)


@dataclass(frozen=True, eq=False)
class ArtefactErrors:
    """Uncertain quantities of one artefact with N balls, and its identity.

    `balls` (N, 3) in mm and `cte_per_k` are the certified values. `certificate` (3N, m) is a matrix L in mm; the
    covariance of the certified ball centres is L Lᵀ. The number of columns m is 0 for a perfect certificate. A standard
    uncertainty of 0 means that the coefficient of thermal expansion (CTE), the thermometer or the sag is exact.
    `uncertified` contains the numbers of the balls whose centres are nominal values without a certificate.
    """

    balls: Array
    cte_per_k: float
    certificate: Array
    cte_standard_uncertainty_per_k: float
    thermometer_standard_uncertainty_k: float
    uncertified: tuple[int, ...] = ()
    sag: Sag = Sag()

    @property
    def strain_names(self) -> tuple[str, ...]:
        """Names of the thermal unknowns, in the order in which they appear in the vector z of all unknowns."""
        doubts = (
            ("cte", self.cte_standard_uncertainty_per_k),
            ("thermometer", self.thermometer_standard_uncertainty_k),
        )
        return tuple(name for name, doubt in doubts if doubt > 0.0)

    @property
    def has_certificate(self) -> bool:
        """True if the shape of the artefact is certified, and not known only roughly."""
        return has_certificate(self.balls, self.certificate @ self.certificate.T)

    def strain_rows(self, warmer_k: Array) -> Array:
        """Return the strain (n, s) of the artefact in n rows (measured balls) per unit of each of the s thermal
        unknowns. `warmer_k` (n,) is the temperature of the artefact in each row minus the reference temperature, in K.
        """
        columns = {
            "cte": self.cte_standard_uncertainty_per_k * warmer_k,
            "thermometer": np.full(len(warmer_k), self.cte_per_k * self.thermometer_standard_uncertainty_k),
        }
        chosen = [columns[name] for name in self.strain_names]
        return np.stack(chosen, axis=1) if chosen else np.zeros((len(warmer_k), 0))

    def matches(self, artefact: Artefact) -> bool:
        """Return True if `artefact` has the same balls, coefficient of thermal expansion and certificate as the
        artefact described here."""
        if self.balls.shape != artefact.balls.shape or not np.array_equal(self.balls, artefact.balls):
            return False
        doubt = (self.cte_per_k, self.cte_standard_uncertainty_per_k)
        difference = np.abs(self.certificate @ self.certificate.T - artefact.covariance)
        deviation = np.sqrt(np.maximum(np.diagonal(artefact.covariance), 0.0))
        # uncertified balls have far larger variances than the others, so each element has its own tolerance
        allowed = _COVARIANCE_TOLERANCE * np.multiply.outer(deviation, deviation)
        return bool(
            doubt == (artefact.cte_per_k, artefact.cte_standard_uncertainty_per_k) and (difference <= allowed).all()
        )


@dataclass(frozen=True)
class BallShift:
    """Shift of the balls of all positions that is an unknown of an identification, such as the lost motion of an axis.
    `name` names it, and `size_mm` is the standard deviation of its size beforehand."""

    name: str
    size_mm: float


@dataclass(frozen=True, eq=False)
class Unknowns:
    """Meaning of each element of the vector z (P,) of the P unknowns of an identification. The vector consists of
    seven consecutive blocks.

    The first block gives the parameters of `model`: each parameter in mm or rad is its element of z multiplied by its
    element of `scale` (p,). The second and third blocks give the certificate errors and the thermal strain of
    `artefact`, the next one the error of its stated sag, which is empty if the sag is exact. The fifth block contains
    the coefficients of the modes `modes` of the misfit; the misfit field in mm is the sum of all modes, each multiplied
    by its coefficient and by `misfit_mm`. The sixth block gives the drift of the machine during the measurement, as
    defined by `drift`. It is empty if `drift` is None, as in a stored estimate. The last block gives the sizes of the
    shifts of the balls `shifts`, which a stored estimate does not contain either.

    `stated_noise_mm2` is the stated variance, in mm², of one coordinate of a measured ball centre, as a mean over the
    rows.
    """

    model: ErrorModel
    scale: Array
    artefact: ArtefactErrors
    modes: MisfitModes | None
    misfit_mm: float
    drift: MachineDrift | None = None
    stated_noise_mm2: float = 0.0
    shifts: tuple[BallShift, ...] = ()

    @property
    def blocks(self) -> UnknownBlocks:
        misfit = () if self.modes is None else self.modes.sizes
        drift = 0 if self.drift is None else self.drift.size
        certificate, strains = self.artefact.certificate.shape[1], len(self.artefact.strain_names)
        sag = int(self.artefact.sag.standard_uncertainty_mm > 0.0)
        return UnknownBlocks.of(
            self.model.size, certificate, strains, misfit, sag=sag, drift=drift, shifts=len(self.shifts)
        )

    def name(self, index: int) -> str:
        """Return a readable name of an unknown, such as `EXX[1]`, `certificate 3`, `strain cte` or `misfit 12`."""
        blocks = self.blocks
        names = (
            *self.model.names,
            *_numbered("certificate", blocks.certificate),
            *(f"strain {name}" for name in self.artefact.strain_names),
            *("sag" for _ in range(blocks.size)[blocks.sag]),
            *_numbered("misfit", blocks.misfit),
            *_numbered("drift", blocks.drift),
            *(shift.name for shift in self.shifts),
        )
        return names[index]

    def parameters(self, z: Array) -> Array:
        """Return the p model parameters (p,) in mm or rad from the vector z (P,) of all unknowns."""
        return np.asarray(self.scale * z[self.blocks.parameters])

    def artefact_calibration(self, z: Array, z_covariance: Array) -> ArtefactCalibration | None:
        """Return the calibration of the artefact that follows from the vector z (P,) of all unknowns with its
        covariance (P, P), or None if the ball centres are not among the unknowns."""
        block, errors = self.blocks.certificate, self.artefact
        return artefact_calibration(errors.balls, errors.certificate, z[block], z_covariance[block, block])

    def unresolved_mm2(self, scales: Scales) -> float:
        """Return the variance, in mm² for each direction, of errors of the machine whose wavelength is too short for
        the modes of the misfit. It is 0 if no misfit is estimated.

        One ball centre cannot tell such an error from the noise of its touches. The estimated variance of the noise
        therefore contains it. What the estimated variance exceeds the stated one by is counted as error of the machine
        (it stays after compensation), unless the misfit leaves out more at its own scales.
        """
        if self.modes is None:
            return 0.0
        left_out = self.misfit_mm**2 * float(self.modes.left_out @ np.square(scales.kinds))
        return max(left_out, self.scatter_mm2(scales))

    def scatter_mm2(self, scales: Scales) -> float:
        """Return the variance, in mm² for each direction, by which the ball centres scatter beyond their stated
        noise."""
        return max(scales.noise**2 - 1.0, 0.0) * self.stated_noise_mm2

    def physical_covariance(self, unit: Array) -> Array:
        """Return the covariance (p, p) of the parameters in mm and rad. `unit` (p, p) is the covariance of the same
        parameters in units of `scale`."""
        return np.asarray(unit * np.multiply.outer(self.scale, self.scale))


def _numbered(kind: str, block: slice) -> Iterable[str]:
    return (f"{kind} {number}" for number in range(block.stop - block.start))
