"""One part of a machine as an elastic solid, with quadratic hexahedra of scikit-fem.

A part stands on elastic pads and is loaded through rails. A rail is a weight w on the surface of the part. Six rigid
motions r_i about a point carry the load and the answer of a rail (the load is distributed, the surface is not
stiffened):

    G_ij = ∫ w r_i·r_j dS      b_i = ∫ w r_i·v dS      B = b G⁻¹

A wrench q at the point is the load vector B q, and the motion of the rail in the least-squares sense is Bᵀ u. The
flexibility Bᵀ K⁻¹ B is therefore symmetric, as Maxwell's reciprocity demands.

Lengths are in mm, forces in N, stresses in N/mm². Motions are three displacements in mm and three rotations in rad,
wrenches three forces in N and three moments in N mm, both about a stated point and in machine axes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.linalg import splu
from skfem import Basis, ElementHex2, ElementVector, LinearForm, MeshHex

from agent.finite_elements.hollow_box import HollowBox
from agent.finite_elements.pads import PadPoints, Pads
from drivers.errors import InputError
from twin.arrays import Array

GRAVITY_MM_PER_S2 = 9806.65
_IN_ELEMENTS = 5  # three points along each edge: exact for a box
_ON_FACE = 1e-6
_WORST_CONDITION = 1e10
_LOST_AREA = 0.05  # largest share of a pad beside the face on which it stands


@dataclass(frozen=True)
class Material:
    """Isotropic elastic material: E in N/mm², Poisson's ratio, density in t/mm³."""

    youngs_n_mm2: float
    poisson: float
    density_t_mm3: float


@dataclass(frozen=True)
class ElasticPads:
    """Pads on which a part stands. Each pad has the stiffnesses across and along its face, in N/mm."""

    pads: Pads
    normal_n_mm: float
    tangential_n_mm: float


class ElasticPart:
    """Elastic solid on elastic pads.

    The stiffness matrix is assembled and factorised when a motion is asked for the first time.
    """

    def __init__(self, box: HollowBox, material: Material, supports: Sequence[ElasticPads]) -> None:
        mesh = MeshHex.init_tensor(*box.lines())
        centres = mesh.p[:, mesh.t].mean(axis=1)
        self._mesh = mesh.restrict(np.flatnonzero(box.is_solid(centres)))
        self._material = material
        self._supports = tuple(supports)
        self._element = ElementVector(ElementHex2())
        self._basis = Basis(self._mesh, self._element, intorder=_IN_ELEMENTS)

    @property
    def unknowns(self) -> int:
        return int(self._basis.N)

    @cached_property
    def mass_t(self) -> float:
        """Mass of the part in t."""
        return float(self._material.density_t_mm3 * np.sum(self._basis.dx))

    @cached_property
    def centre_mm(self) -> Array:
        """Centre of gravity (3,) in mm."""
        place = np.asarray(self._basis.global_coordinates())
        weighed: Array = np.sum(place * self._basis.dx, axis=(1, 2)) / np.sum(self._basis.dx)
        return weighed

    @cached_property
    def own_weight(self) -> Array:
        """Load vector (n,) of the part's weight, along -Z."""
        pull = -self._material.density_t_mm3 * GRAVITY_MM_PER_S2
        load: Array = LinearForm(lambda v, _: pull * v[2]).assemble(self._basis)
        return load

    def rail(self, pads: Pads, about_mm: Array) -> Array:
        """Return the load vectors (n, 6) of unit wrenches on a rail about the point `about_mm` (3,)."""
        surface = self._surface(pads, PadPoints.joined(self._pad_points(pads)))
        arm = surface.places - about_mm[:, None, None]
        zero, one = np.zeros_like(arm[0]), np.ones_like(arm[0])
        motions = [
            np.stack(rows)
            for rows in (
                (one, zero, zero),
                (zero, one, zero),
                (zero, zero, one),
                (zero, -arm[2], arm[1]),  # e × arm
                (arm[2], zero, -arm[0]),
                (-arm[1], arm[0], zero),
            )
        ]
        gram = np.array([[np.sum(surface.measure * (a * b).sum(axis=0)) for b in motions] for a in motions])
        loads = [surface.load(motion, self.unknowns) for motion in motions]
        # a moment is a length times a force: scaled by the size of the rail, the matrix is well conditioned
        size = np.sqrt(np.diag(gram))
        if not size.min() > 0.0:
            raise _undetermined(pads)
        even = gram / np.outer(size, size)
        if np.linalg.cond(even) > _WORST_CONDITION:
            raise _undetermined(pads)
        return np.asarray(np.linalg.solve(even, np.stack(loads) / size[:, None]).T / size)

    def displacements(self, loads: Array) -> Array:
        """Return the displacements (n, m) of all unknowns in mm under m load vectors (n, m)."""
        found: Array = self._factorised.solve(np.ascontiguousarray(loads))
        if not np.isfinite(found).all():
            raise _unsolvable()
        return found

    @cached_property
    def _factorised(self) -> Any:
        symmetric = {"SymmetricMode": True}
        try:
            return splu(self._stiffness(), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=symmetric)
        except RuntimeError:  # the matrix is singular
            raise _unsolvable() from None

    def _stiffness(self) -> Any:
        """Return the sparse stiffness matrix (n, n), with the elastic pads."""
        shear = self._material.youngs_n_mm2 / (2.0 * (1.0 + self._material.poisson))
        lame = 2.0 * shear * self._material.poisson / (1.0 - 2.0 * self._material.poisson)
        gradients = np.stack([field[0].grad for field in self._basis.basis])  # (81, 3, 3, elements, points)
        normal = [gradients[:, i, i] for i in range(3)]
        sheared = [gradients[:, i, j] + gradients[:, j, i] for i, j in ((1, 2), (2, 0), (0, 1))]
        elasticity = np.diag([2.0 * shear] * 3 + [shear] * 3)
        elasticity[:3, :3] += lame
        strains, dofs = np.stack(normal + sheared, axis=1), np.asarray(self._basis.element_dofs).T
        matrix = _assembled(dofs, self.unknowns, strains, elasticity, np.asarray(self._basis.dx))
        for support in self._supports:
            matrix = matrix + self._spring(support)
        return matrix

    def _spring(self, support: ElasticPads) -> Any:
        """Return the stiffness of elastic layers under the pads, each with the stiffness of one pad."""
        stiffness = np.full(3, support.tangential_n_mm)
        stiffness[support.pads.axis] = support.normal_n_mm
        each = [replace(pad, measure=pad.measure / pad.area) for pad in self._pad_points(support.pads)]
        surface = self._surface(support.pads, PadPoints.joined(each))
        return _assembled(surface.dofs, self.unknowns, surface.fields, np.diag(stiffness), surface.measure)

    def _pad_points(self, pads: Pads) -> tuple[PadPoints, ...]:
        """Return the quadrature points of each pad. Raises InputError if a pad does not lie on the part."""
        low, high = self._rectangles(pads)[1:]
        if not len(low):
            raise _off_the_part(pads)
        found, stated = pads.points(low, high), pads.stated_area(low, high)
        for pad in found:
            if not pad.area > 0.0 or (stated is not None and abs(pad.area - stated) > _LOST_AREA * stated):
                raise _off_the_part(pads)
        return found

    def _rectangles(self, pads: Pads) -> tuple[NDArray[np.intp], Array, Array]:
        """Return the facets (n,) of the face of the pads, with their lower and upper corners (n, 3) in mm."""
        facets = self._mesh.facets_satisfying(
            lambda x: np.abs(x[pads.axis] - pads.at_mm) < _ON_FACE, boundaries_only=True
        )
        corners = self._mesh.p[:, self._mesh.facets[:, facets]]  # (3, 4, n)
        return facets, corners.min(axis=1).T, corners.max(axis=1).T

    def _surface(self, pads: Pads, points: PadPoints) -> _Surface:
        elements = self._mesh.f2t[0, self._rectangles(pads)[0][points.facets]]
        mapping = self._basis.mapping
        inside = mapping.invF(points.places, elements)
        count = np.asarray(self._basis.element_dofs).shape[0]
        fields = [np.asarray(self._element.gbasis(mapping, inside, i, elements)[0]) for i in range(count)]
        dofs = np.asarray(self._basis.element_dofs)[:, elements].T
        return _Surface(dofs, np.stack(fields), points.places, points.measure)


@dataclass(frozen=True)
class _Surface:
    """Values of the basis functions on a surface: unknowns (k, 81) of the element at each of k rectangles, functions
    `fields` (81, 3, k, p), `places` (3, k, p) in mm, and the weights `measure` (k, p) of the points."""

    dofs: NDArray[np.intp]
    fields: Array
    places: Array
    measure: Array

    def load(self, pull: Array, unknowns: int) -> Array:
        """Return the load vector (unknowns,) of a pressure `pull` (3, k, p)."""
        local = np.einsum("ickp,ckp,kp->ki", self.fields, pull, self.measure)
        load: Array = np.bincount(self.dofs.ravel(), local.ravel(), minlength=unknowns).astype(np.float64)
        return load


def _off_the_part(pads: Pads) -> InputError:
    where = ", ".join(f"{centre:g}" for centre in pads.centres_mm) or "its face"
    hint = "check the places and the lengths of the pads, and the length of the part"
    return InputError(f"the pads of {pads.length_mm:g} mm at {where} do not lie on the part", hint=hint)


def _undetermined(pads: Pads) -> InputError:
    hint = "make the pads longer or move them apart"
    return InputError(f"pads of {pads.length_mm:g} mm do not determine the motion of what they carry", hint=hint)


def _unsolvable() -> InputError:
    hint = "check walls, ribs and stiffnesses: they must not differ by many orders of magnitude"
    return InputError("the equations of the solid model cannot be solved", hint=hint)


def _assembled(dofs: NDArray[np.intp], unknowns: int, strains: Array, law: Array, measure: Array) -> Any:
    """Return the matrix of the energy ½ ∫ εᵀ law ε, where ε (functions, k, elements, points) belongs to each basis
    function and `measure` (elements, points) is the weight of each quadrature point. `dofs` (elements, functions) are
    the unknowns.

    The forms of scikit-fem call Python once for each pair of the 81 functions of an element; here each element is one
    matrix product.
    """
    functions, kinds, elements, points = strains.shape
    columns = strains.transpose(2, 3, 1, 0)  # (elements, points, k, functions)
    weighted = (law @ columns) * measure[:, :, None, None]
    flat = (elements, points * kinds, functions)
    local = np.matmul(columns.reshape(flat).transpose(0, 2, 1), weighted.reshape(flat))
    rows = np.broadcast_to(dofs[:, :, None], local.shape)
    found = coo_matrix((local.ravel(), (rows.ravel(), rows.transpose(0, 2, 1).ravel())), shape=(unknowns, unknowns))
    return found.tocsc()
