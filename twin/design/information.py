"""Information about the unknowns of an identification after some positions of the artefact have been measured, and the
gain of each further position.

Let C be the covariance of the unknowns, Q the quadratic form of the design criterion (trace(Q C) is the expected mean
square error after compensation), and W the information factor of a position (WᵀW is the information that the position
gives). Measuring this position lowers trace(Q C) by

    trace((1 + W C Wᵀ)⁻¹ W C Q C Wᵀ)

(Woodbury). For each candidate, a search therefore needs only the two small matrices W C Wᵀ and W C Q C Wᵀ. Measuring a
position subtracts from C a matrix U Uᵀ, whose rank is that of W. The small matrices of all candidates are then updated
instead of being recomputed. The update takes one product of the candidates' factors with U and C Q U.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg.lapack import dpotrf, dtrtrs

from twin.arrays import Array
from twin.design.candidates import Indices


@dataclass(frozen=True, eq=False)
class InformationState:
    """Covariance of the P unknowns of an identification after a selection of positions has been measured, and the
    quantities from which the gain of each candidate position follows.

    `factors` (n, r, P) contains the information factor W (r, P) of each of the n candidates considered; WᵀW is the
    information that the candidate gives. `form` (P, P) is the quadratic form Q of the design criterion in mm², and
    `covariance` (P, P) is the covariance C of the unknowns. `spread` (n, r, r) contains the matrix W C Wᵀ of each
    candidate, and `weight` (n, r, r) contains the matrix W C Q C Wᵀ of each candidate. `value` is trace(Q C), the
    expected mean square error after compensation in mm².
    """

    factors: Array
    form: Array
    covariance: Array
    spread: Array
    weight: Array
    value: float

    @classmethod
    def initial(cls, factors: Array, form: Array, covariance: Array) -> InformationState:
        carried = factors @ covariance
        return cls(
            factors=factors,
            form=form,
            covariance=covariance,
            spread=carried @ factors.transpose(0, 2, 1),
            weight=carried @ form @ carried.transpose(0, 2, 1),
            value=float(np.vdot(form, covariance)),
        )

    def restricted_to(self, candidates: Indices) -> InformationState:
        """Return the same state for a subset of the candidates, given by their indices."""
        return replace(
            self, factors=self.factors[candidates], spread=self.spread[candidates], weight=self.weight[candidates]
        )

    def gains(self) -> Array:
        """Return the gain (n,) in mm² of each candidate: the decrease of `value` (expected mean square error) if the
        candidate is measured one more time."""
        return _ratios(np.eye(self.spread.shape[1]) + self.spread, self.weight)

    def losses(self, measured: Indices) -> Array:
        """Return the loss (m,) in mm² of each of the m `measured` candidates: the increase of `value` (expected mean
        square error) if one measurement of the candidate is removed."""
        # Removal is an update with the information -WᵀW (Woodbury): 1 - W C Wᵀ, which is positive definite because C
        # already contains the position.
        return _ratios(np.eye(self.spread.shape[1]) - self.spread[measured], self.weight[measured])

    def after_adding(self, factor: Array) -> InformationState:
        """Return the state after one more position has been measured. The information that this position gives about
        the P unknowns is WᵀW, where W is the matrix `factor` (r, P)."""
        return self._changed(factor, -1.0)

    def after_removing(self, factor: Array) -> InformationState:
        """Return the state after a measured position has been removed. The information that this position gives about
        the P unknowns is WᵀW, where W is the matrix `factor` (r, P)."""
        return self._changed(factor, 1.0)

    def _changed(self, factor: Array, sign: float) -> InformationState:
        """Return the state with covariance C + sign U Uᵀ, where U = C Wᵀ chol(1 - sign W C Wᵀ)⁻ᵀ and W is `factor`."""
        carried = factor @ self.covariance
        root, _ = dpotrf(np.eye(len(factor)) - sign * (carried @ factor.T), lower=1)
        # U Uᵀ = C Wᵀ (1 - sign W C Wᵀ)⁻¹ W C by forward substitution, without an inverse
        u = dtrtrs(root, carried, lower=1)[0].T
        through = self.form @ u
        inner = u.T @ through
        size = u.shape[1]
        both = self.factors.reshape(-1, len(u)) @ np.concatenate((u, self.covariance @ through), axis=1)
        both = both.reshape(*self.factors.shape[:2], 2 * size)
        seen, drawn = both[:, :, :size], both[:, :, size:]
        # with C' = C + s U Uᵀ:  W C'Q C'Wᵀ = W C Q C Wᵀ + s (W C Q U)(W U)ᵀ + transpose + (W U)(UᵀQ U)(W U)ᵀ
        across = sign * (drawn @ seen.transpose(0, 2, 1))
        return replace(
            self,
            covariance=self.covariance + sign * (u @ u.T),
            spread=self.spread + sign * (seen @ seen.transpose(0, 2, 1)),
            weight=self.weight + across + across.transpose(0, 2, 1) + (seen @ inner) @ seen.transpose(0, 2, 1),
            value=self.value + sign * float(np.trace(inner)),
        )


def _ratios(below: Array, above: Array) -> Array:
    """Return trace(below⁻¹ above) as an array (n,), for symmetric matrices (n, r, r)."""
    return np.asarray(np.einsum("nij,nij->n", np.linalg.inv(below), above))
