"""Information state after measuring some positions, and the gain of each further one.

With the covariance C of the unknowns, the criterion's form Q and a position's factor W, measuring it lowers trace(Q C)
by

    trace((1 + W C Wᵀ)⁻¹ W C Q C Wᵀ)

(Woodbury), so a search needs only two small matrices per candidate. Measuring a position changes C by a matrix U Uᵀ of
the position's rank, and the small matrices of all candidates are updated from one product of their factors with U and C
Q U, without recomputing them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg.lapack import dpotrf, dtrtrs

from twin.arrays import Array
from twin.design.candidates import Indices


@dataclass(frozen=True, eq=False)
class InformationState:
    """Information state of a selection.

    `factors` (n, r, P) of the candidates considered; `form` Q and `covariance` C (P, P); `spread` W C Wᵀ and `weight` W
    C Q C Wᵀ (n, r, r); `value` trace(Q C) in mm².
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
        """Return the same state for a subset of the candidates."""
        return replace(
            self, factors=self.factors[candidates], spread=self.spread[candidates], weight=self.weight[candidates]
        )

    def gains(self) -> Array:
        """Return the decrease (n,) of the value in mm² if each candidate is measured (again)."""
        return _ratios(np.eye(self.spread.shape[1]) + self.spread, self.weight)

    def losses(self, measured: Indices) -> Array:
        """Return the increase (m,) of the value in mm² if each of the `measured` positions is removed."""
        return _ratios(np.eye(self.spread.shape[1]) - self.spread[measured], self.weight[measured])

    def after_adding(self, factor: Array) -> InformationState:
        """Return the state after measuring a position with `factor` (r, P)."""
        return self._changed(factor, -1.0)

    def after_removing(self, factor: Array) -> InformationState:
        """Return the state without a measured position with `factor` (r, P)."""
        return self._changed(factor, 1.0)

    def _changed(self, factor: Array, sign: float) -> InformationState:
        """Return the state with C + sign U Uᵀ, where U = C Wᵀ chol(1 - sign W C Wᵀ)⁻ᵀ."""
        carried = factor @ self.covariance
        root, _ = dpotrf(np.eye(len(factor)) - sign * (carried @ factor.T), lower=1)
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
    """Return trace(below⁻¹ above) (n,) of symmetric matrices (n, r, r)."""
    return np.asarray(np.einsum("nij,nij->n", np.linalg.inv(below), above))
