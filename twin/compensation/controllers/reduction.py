"""Reduction of a compensation table to functions that controllers support. These are functions of one axis position,
and products of two such functions.

On an evenly spaced grid, a field of corrections is a sum of several parts (analysis of variance). They are a mean, a
main effect of each axis, an interaction of each pair of axes, and a remainder that depends on all three axes. All these
parts are orthogonal to each other. If some parts are omitted, the sum of the others is therefore still the best fit.
The remainder is always omitted.

A small rigid motion of the workspace consists only of means and main effects. The best reduction before the
best-fitting rigid motion is removed is therefore also the best after its removal.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from twin.arrays import Array
from twin.compensation.table import CompensationTable
from twin.machine.kinematic_chain import AXES

LEAST_RMS_MM = 2e-5
"""Smallest rms contribution in mm over the workspace for which a term is written."""

_PAIRS = ((0, 1), (0, 2), (1, 2))


@dataclass(frozen=True, eq=False)
class Profile:
    """Function of the position of one axis, given by n values at n nodes. `axis` is the number of the axis.

    The function is linear between the nodes and constant beyond the first and the last node.
    """

    axis: int
    nodes: Array
    values: Array

    def at(self, axis_positions: Array) -> Array:
        return np.interp(axis_positions[:, self.axis], self.nodes, self.values)


@dataclass(frozen=True, eq=False)
class Term:
    """Term of a reduced compensation table, which corrects the axis with the number `output`. The correction is
    `profile` in mm, or the product of `profile` and `factor`. `factor` is a dimensionless profile whose values are at
    most 1.
    """

    output: int
    profile: Profile
    factor: Profile | None
    rms_mm: float

    def at(self, axis_positions: Array) -> Array:
        values = self.profile.at(axis_positions)
        return values if self.factor is None else values * self.factor.at(axis_positions)


def own_axis_profiles(table: CompensationTable, reference: Array) -> tuple[Profile, Profile, Profile]:
    """Return for each axis its correction as a function of its own position. The correction is averaged over the
    positions of the other two axes.

    Each of these functions (profiles) is zero at the reference point `reference` (3,).
    """
    x, y, z = (_zeroed(_main_effect(table, axis, axis), reference) for axis in range(3))
    return x, y, z


def cross_axis_profiles(table: CompensationTable, reference: Array) -> tuple[tuple[Profile, ...], ...]:
    """Return the correction of every axis as a function of the position of every axis. The element `[input][output]` of
    the result is the correction of the axis `output` as a function of the position of the axis `input`.

    Each of these functions (profiles) is zero at the reference point `reference` (3,).
    """
    return tuple(
        tuple(_zeroed(_main_effect(table, source, output), reference) for output in range(3)) for source in range(3)
    )


def select_terms(
    table: CompensationTable, most_tables: int, reference: Array, *, tables_per_product: int | None
) -> tuple[Term, ...]:
    """Select the main effects (functions of one axis position) and products of two such functions that reduce the error
    most, relative to the number of controller tables they need. A main effect needs one table, and a product needs
    `tables_per_product`. If this is None, no product is selected.

    These terms are considered in descending order of the mean square error that they remove per table. A term is
    omitted if its rms is below `LEAST_RMS_MM`. It is also omitted if it needs more tables than are left of the
    `most_tables` permitted tables.

    Interactions of two axes are decomposed into products by a singular value decomposition. No other set of the same
    number of products leaves a smaller error. If an axis has a main effect, the sum of all its terms is zero at the
    reference point `reference` (3,).
    """
    found = [_as_term(_main_effect(table, source, output), output) for source in range(3) for output in range(3)]
    if tables_per_product is not None:
        for first, second in _PAIRS:
            found += [term for output in range(3) for term in _products(table, first, second, output)]

    def tables(term: Term) -> int:
        return 1 if term.factor is None else tables_per_product or 1

    chosen, used = [], 0
    # The terms are orthogonal, so the mean squares that they remove add up, and the best choice is by mean square per
    # table.
    for term in sorted(found, key=lambda each: -(each.rms_mm**2) / tables(each)):
        if term.rms_mm >= LEAST_RMS_MM and used + tables(term) <= most_tables:
            chosen.append(term)
            used += tables(term)
    return _zero_at(tuple(chosen), reference)


def sum_of_terms(kept: tuple[Term, ...], axis_positions: Array) -> Array:
    """Return the sum (n, 3) of the corrections of all terms in `kept`, in mm, at n axis positions (n, 3)."""
    total = np.zeros_like(axis_positions)
    for term in kept:
        total[:, term.output] += term.at(axis_positions)
    return total


def sum_of_own_axis_profiles(profiles: Sequence[Profile], axis_positions: Array) -> Array:
    """Return the sum of own-axis profiles (corrections of an axis as a function of its own position), in mm, at n axis
    positions (n, 3), as an array (n, 3).
    """
    total = np.zeros_like(axis_positions)
    for profile in profiles:
        total[:, profile.axis] += profile.at(axis_positions)
    return total


def sum_of_cross_axis_profiles(by_input: tuple[tuple[Profile, ...], ...], axis_positions: Array) -> Array:
    """Return the sum of cross-axis profiles (corrections of an axis as functions of the position of each axis), in mm,
    at n axis positions (n, 3), as an array (n, 3).
    """
    total = np.zeros_like(axis_positions)
    for row in by_input:
        for output, profile in enumerate(row):
            total[:, output] += profile.at(axis_positions)
    return total


def describe_term(first: int, second: int | None, output: int) -> str:
    """Return a text such as `Y by Z` or `Y by Y·Z`. It names the corrected axis, and then the axes on whose positions
    the correction depends.
    """
    inputs = AXES[first] if second is None else f"{AXES[first]}·{AXES[second]}"
    return f"{AXES[output]} by {inputs}"


def _zero_at(kept: tuple[Term, ...], reference: Array) -> tuple[Term, ...]:
    """Shift the first main effect of each output axis so that the sum of its terms is zero at the reference point."""
    # A constant is a rigid translation, so it may be moved between the terms of an axis without any loss.
    there, shifted_axes, result = sum_of_terms(kept, reference[None, :])[0], set(), []
    for term in kept:
        if term.factor is None and term.output not in shifted_axes:
            shifted_axes.add(term.output)
            shifted = replace(term.profile, values=term.profile.values - there[term.output])
            result.append(replace(term, profile=shifted))
        else:
            result.append(term)
    return tuple(result)


def _as_term(profile: Profile, output: int) -> Term:
    return Term(output, profile, None, float(np.sqrt(np.mean(profile.values**2))))


def _main_effect(table: CompensationTable, source: int, output: int) -> Profile:
    field = table.corrections[..., output]
    others = tuple(axis for axis in range(3) if axis != source)
    return Profile(source, table.nodes[source], field.mean(axis=others) - field.mean())


def _products(table: CompensationTable, first: int, second: int, output: int) -> list[Term]:
    field = table.corrections[..., output]
    third = 3 - first - second
    plane = field.mean(axis=third) - field.mean()
    plane = plane - plane.mean(axis=0, keepdims=True) - plane.mean(axis=1, keepdims=True)
    # interaction = plane minus its main effects; its singular triplets are the best products f(first) g(second)
    left, sizes, right = np.linalg.svd(plane, full_matrices=False)
    found = []
    for size, one, other in zip(sizes.tolist(), left.T, right, strict=True):
        # The factor is normalised to the largest value 1, and the profile takes the size.
        peak = float(other[np.argmax(np.abs(other))])
        profile = Profile(first, table.nodes[first], size * peak * one)
        factor = Profile(second, table.nodes[second], other / peak)
        # The singular vectors have the length 1, so the rms of a product over the n nodes of the plane is σ / √n.
        found.append(Term(output, profile, factor, size / float(np.sqrt(plane.size))))
    return found


def _zeroed(profile: Profile, reference: Array) -> Profile:
    return replace(profile, values=profile.values - profile.at(reference[None, :])[0])


def round_profile(profile: Profile, decimals: int) -> Profile:
    """Return the profile with its values rounded to `decimals` decimals, as in the exported file. A value of -0 becomes
    0.
    """
    return replace(profile, values=np.round(profile.values, decimals) + 0.0)
