"""Sums of polynomial fields over a grid of axis positions, computed from far fewer points.

The derivatives of the tool point deviation with respect to the model parameters (the columns of a deviation basis) are
polynomials in the axis positions. Let d be their degree in the position of one axis. The sum of a polynomial of degree
2 d + 1 over the grid points of this axis is computed exactly from d + 1 nodes. The nodes are the Gauss nodes of the
discrete measure that has weight 1 at every grid point (Golub and Welsch 1969). For example, 60×20×20 points reduce to
7×7×7 nodes. A field that is not a polynomial is projected onto the nodes with the Lagrange polynomials of the nodes.
The sum of the products of the projected field with columns of degree d is then the same as on the grid.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin.arrays import Array


@dataclass(frozen=True, eq=False)
class GridQuadrature:
    """Quadrature rule that replaces a sum over `count` points (axis positions of a grid) by a weighted sum over m
    nodes.

    For two vector fields a and b, the sum of a(X)ᵀ b(X) over all points X is replaced by the sum of w a(N)ᵀ b(N) over
    all nodes N with their weights w. Both sums are equal if a and b are polynomials up to the given degrees. `nodes`
    (m, 3) contains the nodes in mm, and `weights` (m,) contains their weights. `lagrange` contains, for each axis, the
    values of the Lagrange polynomials of the nodes at the points, with shape (points, nodes). It is None if the nodes
    are the points themselves.
    """

    count: int
    nodes: Array
    weights: Array
    lagrange: tuple[Array, ...] | None

    @classmethod
    def for_points(cls, points: Array, degrees: tuple[int, int, int]) -> GridQuadrature:
        """Return the quadrature rule for points (n, 3) in mm and for polynomials up to the given degrees in x, y and z.

        If the points do not form a grid, the nodes are the points themselves, each with weight 1.
        """
        lines = _lines(points)
        if lines is None:
            return cls(len(points), points, np.ones(len(points)), None)
        rules = [_gauss(line, degree) for line, degree in zip(lines, degrees, strict=True)]
        # Tensor product: the rule of each axis is exact in its coordinate, so their product is exact in all three.
        nodes = np.stack(np.meshgrid(*(rule[0] for rule in rules), indexing="ij"), axis=-1).reshape(-1, 3)
        weights = np.einsum("i,j,k->ijk", *(rule[1] for rule in rules)).reshape(-1)
        return cls(len(points), nodes, weights, tuple(rule[2] for rule in rules))

    def gather(self, field: Array) -> Array:
        """Return the projection g (m, 3), onto the m nodes of the quadrature rule, of a field f (n, 3) that is given at
        the n points of the sum.

        Let a field a be a polynomial up to the degrees of the rule. The sum of a(X)ᵀ f(X) over all points X is then
        equal to the sum of a(N)ᵀ g(N) over all nodes N.
        """
        if self.lagrange is None:
            return field
        gathered = field.reshape(*(len(polynomials) for polynomials in self.lagrange), 3)
        for polynomials in self.lagrange:  # each takes the leading axis and puts its nodes last
            gathered = np.tensordot(gathered, polynomials, axes=(0, 0))
        return np.moveaxis(gathered, 0, -1).reshape(-1, 3)


def _lines(points: Array) -> tuple[Array, Array, Array] | None:
    """Return the nodes along x, y and z of the grid that the points (n, 3) form, or None if they do not form a grid.

    In the list of points, x must vary slowest and z fastest.
    """
    x, y, z = points.T
    # the points before y or x first changes are one line along z, those before x changes are one plane
    deep = int(np.argmax(np.append(y != y[0], True) | np.append(x != x[0], True)))
    plane = int(np.argmax(np.append(x != x[0], True)))
    if plane % deep or len(points) % plane:
        return None
    lines = x[::plane], y[:plane:deep], z[:deep]
    grid = points.reshape(*(len(line) for line in lines), 3)
    ascending = all((np.diff(line) > 0.0).all() for line in lines)
    same = all((grid[..., k] == np.expand_dims(lines[k], [a for a in range(3) if a != k])).all() for k in range(3))
    return lines if ascending and same else None


def _gauss(line: Array, degree: int) -> tuple[Array, Array, Array]:
    """Return the Gauss rule of one axis for n points and polynomials up to `degree`, which is called d. The rule
    consists of nodes (d + 1,), weights (d + 1,), and the values (n, d + 1) of the Lagrange polynomials at the points.

    If there are at most d + 1 points, the nodes are the points themselves.
    """
    if len(line) <= degree + 1:
        return line, np.ones(len(line)), np.eye(len(line))
    middle, half = 0.5 * (line[0] + line[-1]), 0.5 * (line[-1] - line[0])
    # Golub-Welsch: with orthonormal p_0 ... p_d on the points, the eigenvalues of the matrix of x in this basis
    # (the Jacobi matrix) are the nodes.
    at = (line - middle) / half
    orthonormal = np.linalg.qr(np.polynomial.legendre.legvander(at, degree))[0]
    nodes, vectors = np.linalg.eigh(orthonormal.T @ (at[:, None] * orthonormal))
    # column j of `vectors` is p_k(node j) times the square root of its weight; p_0 is the same at every point
    roots = vectors[0] / orthonormal[0, 0]
    return middle + half * nodes, roots**2, orthonormal @ (vectors * roots)
