"""Design criterion: expected mean square of the error field that remains after compensation. The criterion is a
quadratic form of the unknowns z that all measured positions of the artefact share."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from twin.arrays import Array, as_points, as_vector
from twin.identification.scales import Scales
from twin.identification.unknowns import Indices, Unknowns
from twin.machine.forward_model import deviation_basis
from twin.machine.grid_quadrature import GridQuadrature
from twin.machine.rigid_motion import rigid_fields
from twin.machine.volumetric import VolumetricRms

_CHUNK = 2000  # grid points whose fields are held in memory at a time


@dataclass(frozen=True, eq=False)
class Criterion:
    """Design criterion as two quadratic forms, `raw` and `aligned`, each (P, P) in mm², of the P unknowns z that all
    measured positions share.

    Let the error of z have mean zero and the covariance C. The expected mean square, over a grid, of the error field
    that remains after compensation is then trace(`raw` · C). The form `aligned` gives the expected mean square after
    the best-fitting rigid motion has been removed from the field. The unknowns of the certificate and of the thermal
    strain do not contribute to the field. `unresolved_mm2` is the mean square of the part of the misfit whose
    wavelength is too short for the modes that represent the misfit; this part is the same for every position set.
    """

    raw: Array
    aligned: Array
    unresolved_mm2: float = 0.0

    @classmethod
    def build(cls, unknowns: Unknowns, axis_positions: ArrayLike, tool_offset: ArrayLike) -> Criterion:
        """Build the criterion for a grid of axis positions (n, 3) in mm and a tool offset (3,) in mm."""
        grid, offset = as_points(axis_positions, "axis positions"), as_vector(tool_offset, 3, "tool offset")
        fields = _Fields(unknowns, offset)
        sums = GridQuadrature.for_points(grid, fields.degrees)
        roots = np.sqrt(sums.weights)[:, None, None]
        middle, size_mm = grid.mean(axis=0) + offset, max(float(np.ptp(grid, axis=0).max()), 1.0)
        gram, shared, motion = np.zeros((fields.size, fields.size)), np.zeros((6, fields.size)), np.zeros((6, 6))
        for start in range(0, len(sums.nodes), _CHUNK):
            rows = slice(start, start + _CHUNK)
            nodes, weights = sums.nodes[rows], roots[rows]
            field = (weights * fields.at(nodes)).reshape(-1, fields.size)
            rigid = (weights * rigid_fields(nodes + offset, middle, size_mm)).reshape(-1, 6)
            # FᵀF, GᵀF and GᵀG, summed over chunks so that the fields of all grid points need not be in memory at once
            gram += field.T @ field
            shared += rigid.T @ field
            motion += rigid.T @ rigid
        # remove the best rigid motion G: FᵀF - FᵀG (GᵀG)⁻¹ GᵀF
        aligned = gram - shared.T @ np.linalg.lstsq(motion, shared, rcond=1e-12)[0]
        return cls(
            raw=fields.embed(gram / len(grid)),
            aligned=fields.embed(0.5 * (aligned + aligned.T) / len(grid)),
            unresolved_mm2=fields.unresolved_mm2,
        )

    def expected(self, covariance: Array) -> VolumetricRms:
        """Return the expected error in mm before (raw) and after (aligned) removal of the best-fitting rigid motion, if
        the error of the unknowns z has `covariance` (P, P). Each value is the root of the expected mean square of the
        error field, including `unresolved_mm2`."""
        raw, aligned = (float(np.vdot(form, covariance)) + self.unresolved_mm2 for form in (self.raw, self.aligned))
        return VolumetricRms(float(np.sqrt(max(raw, 0.0))), float(np.sqrt(max(aligned, 0.0))))


@dataclass(frozen=True, eq=False)
class _Fields:
    """Fields in mm of the unknowns that contribute to the error field: the parameters and the misfit."""

    unknowns: Unknowns
    offset: Array

    @property
    def indices(self) -> Indices:
        blocks = self.unknowns.blocks
        every = np.arange(blocks.size)
        return np.concatenate((every[blocks.parameters], every[blocks.misfit]))

    @property
    def size(self) -> int:
        return len(self.indices)

    @property
    def degrees(self) -> tuple[int, int, int]:
        """Upper bounds of the polynomial degrees of the fields in x, y and z. The fields are Legendre series with lever
        arms, cross-effect terms and misfit modes."""
        unknowns = self.unknowns
        highest = np.array(unknowns.model.field_degrees)
        if unknowns.modes is not None:
            highest = np.maximum(highest, np.array(unknowns.modes.degrees).max(axis=0))
        x, y, z = highest.tolist()
        return x, y, z

    @property
    def unresolved_mm2(self) -> float:
        """Variance in mm² of the unresolved misfit, summed over the three directions, if all scales are 1."""
        return 3.0 * self.unknowns.unresolved_mm2(Scales())

    def at(self, points: Array) -> Array:
        """Return the fields (n, 3, size) in mm per unit of each unknown."""
        unknowns = self.unknowns
        basis = deviation_basis(unknowns.model, points, self.offset)
        fields = basis * unknowns.scale
        if unknowns.modes is None:
            return np.asarray(fields)
        # The modes are given free of what the parameters explain for their tool, for which they need the same basis.
        at_hand = basis if (self.offset == unknowns.modes.tool_offset).all() else None
        return np.concatenate((fields, unknowns.misfit_mm * unknowns.modes.at(points, at_hand)), axis=2)

    def embed(self, form: Array) -> Array:
        """Insert a form (size, size) into a form (P, P) of all unknowns."""
        full = np.zeros((self.unknowns.blocks.size,) * 2)
        full[np.ix_(self.indices, self.indices)] = form
        return full
