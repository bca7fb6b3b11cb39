"""Cross-effects of a machine's structure, derived from the beams of which it consists.

The carriage of a linear axis moves along a beam and loads it with the weight of the masses that it carries. The beam
bends and twists where the carriage stands. This is an error of the carriage, and it depends on the position of the
carriage on the beam and on the positions of those axes that move the masses relative to the carriage.

Example: the column of a moving-column machine is a cantilever along Z with its foot h below the lower end of Z. The
carriage of Z carries a ram of mass m, whose centre of gravity Y moves. The moment of its weight is M = m g (r + y), so

    E_YZ = M (h + z)² / 2EI     E_AZ = -M (h + z) / EI

As polynomials in y and z these are the terms b0, b1, b2 and c0, c1 of the column and ram. Terms in z alone belong to
the Legendre series of EYZ and EAZ.

Three rules make parameters of a derived polynomial. Its terms that contain only the axis of the beam itself are left
out, since they belong to the Legendre series of the same error motion. The series represents them if its order is at
least their degree, at most 3 for a cantilever, 4 for a supported and 6 for a clamped beam (`own_axis_degrees`); of a
series of a lower order the rest is lost. The other terms of a cantilever are divided by
powers of the position along the beam, and each power has a parameter of its own: joints at the foot and the true height
of the foot change the ratios of the powers. The polynomial of a beam on two supports stays whole. At last, a parameter
whose deviation the error motions of the model can represent up to a rigid motion of the workspace is redundant; it is
derived and shown, but not identified.

Frames and signs are those of `twin.machine.error_model`: the errors are those of the tool relative to the workpiece,
and an axis on the workpiece side moves against its axis position. Gravity acts along -Z.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from twin.arrays import Array
from twin.errors import ModelError
from twin.machine.axis_polynomial import (
    AxisPolynomial,
    PolynomialVector,
    constant_vector,
    polynomial_vector,
    unit_vector,
    vector_product,
    vector_sum,
)
from twin.machine.beam_flexibility import Ends, beam_flexibility
from twin.machine.cross_term import COLUMN_AND_RAM, CROSS, CrossTerm
from twin.machine.deviation_basis import deviation_basis
from twin.machine.error_model import DIRECTIONS, ErrorModel, Ranges
from twin.machine.kinematic_chain import AXES, Chain
from twin.machine.rigid_motion import rigid_fields

GRAVITY_N_PER_KG = 9.80665

Triple = tuple[float, float, float]

_ZERO = AxisPolynomial()
_REDUNDANT = 1e-7  # share of a term's deviation that the model lacks: below it, only rounding
_POINTS = 500
_TOOL_SHARE = np.array([0.31, -0.43, 0.23])  # tool offset in ranges: no lever arm is zero or equal to another


@dataclass(frozen=True)
class BeamLoad:
    """Mass that loads a beam. It is fixed to the part that the axis `carried_by` moves.

    `centre_mm` is the vector from the carriage on the beam to the centre of gravity if all axes are at the lower ends
    of their ranges. With a crossbeam, it begins at the carriage of the crossbeam. `mass_kg` is None if unknown.
    """

    name: str
    carried_by: str
    centre_mm: Triple
    mass_kg: float | None = None


@dataclass(frozen=True)
class Crossbeam:
    """Rigid crossbeam one end of which rests on a beam, at the position `here_mm` of `axis`, while another beam carries
    the other end, at `other_mm`. The carriage of `axis` moves along the crossbeam. The ends are hinged, so they hand on
    forces across the crossbeam and the torque about it."""

    axis: str
    here_mm: float
    other_mm: float

    def share(self, at: AxisPolynomial) -> AxisPolynomial:
        """Return the share of a load at the position `at` (mm) that the beam carries."""
        length = self.other_mm - self.here_mm
        return at * (-1.0 / length) + AxisPolynomial.constant(self.other_mm / length)


@dataclass(frozen=True)
class StructuralBeam:
    """Beam along the linear axis `axis`, whose carriage moves along the beam.

    `supports_mm` contains the axis positions at which the carriage would stand at the foot, or at both supports.
    `reference_mm` is the vector from the axis of the beam at the carriage to the point where the lever arm of the axis
    begins: on the tool side the reference point of the ram if all axes are at the lower ends of their ranges.
    `bending_n_mm2` is EI and `torsion_n_mm2` GJ; None if unknown.
    """

    name: str
    axis: str
    ends: Ends
    supports_mm: tuple[float, ...]
    loads: tuple[BeamLoad, ...]
    crossbeam: Crossbeam | None = None
    reference_mm: Triple = (0.0, 0.0, 0.0)
    bending_n_mm2: float | None = None
    torsion_n_mm2: float | None = None


@dataclass(frozen=True)
class DerivedTerm:
    """Term of the cross-effect derived from the beams called `beams`.

    `expected` is the value of its parameter in mm or rad if masses and stiffnesses are as stated; None if one of them
    is unknown. `redundant` is True if the error motions of the model can represent the term.
    """

    term: CrossTerm
    beams: tuple[str, ...]
    expected: float | None
    redundant: bool = False


@dataclass(frozen=True)
class _Part:
    """One contribution to an error motion of a beam's axis.

    `size` is the factor of `polynomial`, the weight of the load over the stiffness of the beam; None if unknown.
    `cause` names the load, and the twist of the beam if it is one.
    """

    error: str
    polynomial: AxisPolynomial
    size: float | None
    cause: str


def derive_terms(beams: Sequence[StructuralBeam], model: ErrorModel) -> tuple[DerivedTerm, ...]:
    """Return the terms of the cross-effect of `beams` on a machine with the chain, ranges and orders of `model`; the
    cross-effect of `model` itself is ignored. Terms that are equal for two loads or beams are added up.

    Raises ModelError, with the name of the beam, if a beam does not suit the machine.
    """
    found: dict[tuple[str, AxisPolynomial], DerivedTerm] = {}
    for beam in beams:
        try:
            _check(beam, model.chain, model.ranges_mm)
        except ModelError as error:
            raise error.at(beam=beam.name) from None
        for name, error_name, polynomial, expected in _named(beam, model.chain, model.ranges_mm):
            key = (error_name, polynomial)
            known = found.get(key)
            if known is None:
                found[key] = DerivedTerm(CrossTerm(name, error_name, polynomial), (beam.name,), expected)
            else:
                total = None if known.expected is None or expected is None else known.expected + expected
                found[key] = replace(known, beams=(*known.beams, beam.name), expected=total)
    return _marked_redundant(tuple(found.values()), model)


def own_axis_degrees(beams: Sequence[StructuralBeam], model: ErrorModel) -> dict[str, int]:
    """Return, for each error motion that beams cause, the highest power of the axis of the beam alone. The Legendre
    series of the error motion represents these terms if its order is at least this high. The beams suit the machine."""
    degrees: dict[str, int] = {}
    for beam in beams:
        axis = AXES.index(beam.axis)
        for part in (part for load in beam.loads for part in _parts(beam, load, model.chain, model.ranges_mm)):
            alone = [powers[axis] for powers, _ in part.polynomial.terms if powers[axis] == sum(powers)]
            degrees[part.error] = max(degrees.get(part.error, 0), *alone, 0)
    return degrees


def _check(beam: StructuralBeam, chain: Chain, ranges_mm: Ranges) -> None:
    low, high = ranges_mm[AXES.index(beam.axis)]
    if beam.ends == "cantilever":
        if len(beam.supports_mm) != 1:
            raise ModelError(f"a cantilever has one support, not {len(beam.supports_mm)}")
        if low < beam.supports_mm[0] < high:
            raise ModelError(f"the support at {beam.supports_mm[0]:g} mm is inside the range of {beam.axis}")
    else:
        if len(beam.supports_mm) != 2:
            raise ModelError(f"a {beam.ends} beam has two supports, not {len(beam.supports_mm)}")
        first, second = beam.supports_mm
        if not first <= low < high <= second:
            raise ModelError(
                f"the supports at {first:g} and {second:g} mm do not enclose the range of {beam.axis}, {low:g} to "
                f"{high:g} mm",
                hint="Write the lower support first",
            )
    carried = _carried(chain, beam.axis)
    bridge = beam.crossbeam
    if bridge is not None:
        crossing = bridge.axis
        if crossing not in carried:
            raise ModelError(f"the carriage of {beam.axis} does not carry the axis {crossing} of the crossbeam")
        if bridge.axis == "Z":
            raise ModelError("a crossbeam is horizontal, so its axis is X or Y")
        cross_low, cross_high = ranges_mm[AXES.index(bridge.axis)]
        if not min(bridge.here_mm, bridge.other_mm) <= cross_low < cross_high <= max(bridge.here_mm, bridge.other_mm):
            raise ModelError(
                f"the ends of the crossbeam at {bridge.here_mm:g} and {bridge.other_mm:g} mm do not enclose the range "
                f"of {crossing}, {cross_low:g} to {cross_high:g} mm"
            )
    for load in beam.loads:
        if load.carried_by != beam.axis and load.carried_by not in carried:
            known = ", ".join((beam.axis, *carried))
            raise ModelError(
                f"the carriage of {beam.axis} does not carry the load '{load.name}', which {load.carried_by} moves",
                hint=f"It carries what is moved by: {known}",
            )


def _carried(chain: Chain, axis: str) -> tuple[str, ...]:
    """Return the axes that the carriage of `axis` carries, the nearest first."""
    if axis in chain.tool_side:
        return chain.tool_side[: chain.tool_side.index(axis)][::-1]
    return chain.workpiece_side[chain.workpiece_side.index(axis) + 1 :]


def _named(
    beam: StructuralBeam, chain: Chain, ranges_mm: Ranges
) -> Iterator[tuple[str, str, AxisPolynomial, float | None]]:
    """Yield name, error motion, normalised polynomial and expected parameter of each term of one beam."""
    axis = AXES.index(beam.axis)
    merged: dict[tuple[str, AxisPolynomial], tuple[float | None, str, str]] = {}
    for part in (part for load in beam.loads for part in _parts(beam, load, chain, ranges_mm)):
        for suffix, polynomial in _separated(beam.ends, axis, part.polynomial):
            shape, factor = polynomial.normalised()
            if not shape.terms:
                continue
            size = None if part.size is None else part.size * factor
            known = merged.get((part.error, shape))
            if known is not None:
                size = None if size is None or known[0] is None else size + known[0]
            merged[part.error, shape] = (size, suffix, known[2] if known else part.cause)
    own_names = {(term.error, term.polynomial): term.name for term in COLUMN_AND_RAM.values()}
    stems = [f"{beam.name}.{error}{suffix}" for (error, _), (_, suffix, _) in merged.items()]
    for (error, shape), (size, suffix, cause) in merged.items():
        stem = f"{beam.name}.{error}{suffix}"
        name = f"{CROSS}[{stem}]" if stems.count(stem) == 1 else f"{CROSS}[{stem}.{cause}]"
        yield own_names.get((error, shape), name), error, shape, size


def _separated(ends: Ends, axis: int, polynomial: AxisPolynomial) -> Iterator[tuple[str, AxisPolynomial]]:
    """Yield the parts of a polynomial that get a parameter each, with the ends of their names."""
    if ends == "cantilever":
        for power in range(polynomial.degrees[axis] + 1):
            yield f".{power}", polynomial.only(axis, power)
    else:
        yield "", polynomial.only(axis)


def _parts(beam: StructuralBeam, load: BeamLoad, chain: Chain, ranges_mm: Ranges) -> Iterator[_Part]:
    """Yield the errors of the beam's axis by the weight of one load, separately by bending and by torsion."""
    axis = AXES.index(beam.axis)
    sense = 1.0 if beam.axis in chain.tool_side else -1.0
    force, moment = _load_on_beam(beam, load, chain, ranges_mm)
    low, high = ranges_mm[axis]
    foot = beam.supports_mm[0]
    outwards = 1.0 if foot <= low else -1.0
    distance = AxisPolynomial.linear(axis, outwards * (low - foot), outwards * (high - low))
    length = beam.supports_mm[1] - foot if len(beam.supports_mm) == 2 else 0.0
    flexibility = beam_flexibility(beam.ends, length)
    by_force, by_moment, slope, twist = (
        distance.inserted_into(coefficients)
        for coefficients in (
            flexibility.deflection_by_force,
            flexibility.deflection_by_moment,
            flexibility.slope_by_moment,
            flexibility.twist_by_torque,
        )
    )
    # The beam leads from its foot in the direction `along` of the machine axis. A slope is the derivative in this
    # direction, and a rotation about q turns p's neighbour: with (a, p, q) right-handed, θ_q = du_p/da and
    # θ_p = -du_q/da.
    along = AxisPolynomial.constant(sense * outwards)
    p, q = (axis + 1) % 3, (axis + 2) % 3
    moved, turned = [_ZERO] * 3, [_ZERO] * 3
    moved[p] = by_force * force[p] + along * by_moment * moment[q]
    moved[q] = by_force * force[q] + along * by_moment * moment[p] * -1.0
    turned[q] = along * by_moment * force[p] + slope * moment[q]
    turned[p] = along * by_moment * force[q] * -1.0 + slope * moment[p]
    twisted = [_ZERO] * 3
    twisted[axis] = twist * moment[axis]
    weight = None if load.mass_kg is None else load.mass_kg * GRAVITY_N_PER_KG
    kinds: tuple[tuple[list[AxisPolynomial], list[AxisPolynomial], float | None, str], ...] = (
        (moved, turned, beam.bending_n_mm2, load.name),
        ([_ZERO] * 3, twisted, beam.torsion_n_mm2, f"{load.name}.twist"),
    )
    for displacement, rotation, stiffness, cause in kinds:
        size = None if weight is None or stiffness is None else sense * weight / stiffness
        at_carriage, about = _of_carriage(
            beam, polynomial_vector(displacement), polynomial_vector(rotation), chain, ranges_mm
        )
        at_reference = vector_sum(at_carriage, vector_product(about, constant_vector(beam.reference_mm)))
        for direction, polynomial in zip(DIRECTIONS, (*at_reference, *about), strict=True):
            if polynomial.terms:
                yield _Part(f"E{direction}{beam.axis}", polynomial, size, cause)


def _load_on_beam(
    beam: StructuralBeam, load: BeamLoad, chain: Chain, ranges_mm: Ranges
) -> tuple[PolynomialVector, PolynomialVector]:
    """Return force and moment on the beam by 1 N of the load's weight."""
    carried = _carried(chain, beam.axis)
    moving = carried[: carried.index(load.carried_by) + 1] if load.carried_by in carried else ()
    sense = 1.0 if beam.axis in chain.tool_side else -1.0
    arm = [AxisPolynomial.constant(value) for value in load.centre_mm]
    for letter in moving:
        axis = AXES.index(letter)
        low, high = ranges_mm[axis]
        arm[axis] += AxisPolynomial.linear(axis, 0.0, sense * (high - low))
    force = constant_vector((0.0, 0.0, -1.0))
    moment = vector_product(polynomial_vector(arm), force)
    bridge = beam.crossbeam
    if bridge is None:
        return force, moment
    # Balance of moments about the other end of the crossbeam, whose direction is m: the beam carries
    # P = share F + m × M / D with the moment M of the weight about the carriage at the lower end of its range, and the
    # share of the torque about m at the place of the load.
    across = AXES.index(bridge.axis)
    direction = unit_vector(across)
    at_low = AxisPolynomial.constant(ranges_mm[across][0])
    length = sense * (bridge.other_mm - bridge.here_mm)
    shared = tuple(bridge.share(at_low) * part for part in force)
    by_moment = tuple(part * (1.0 / length) for part in vector_product(direction, moment))
    place = at_low + arm[across] * sense
    torque = [_ZERO] * 3
    torque[across] = bridge.share(place) * moment[across]
    return vector_sum(polynomial_vector(shared), polynomial_vector(by_moment)), polynomial_vector(torque)


def _of_carriage(
    beam: StructuralBeam, moved: PolynomialVector, turned: PolynomialVector, chain: Chain, ranges_mm: Ranges
) -> tuple[PolynomialVector, PolynomialVector]:
    """Return the error motions of the beam's axis: displacement and rotation of its carriage. With a crossbeam, one end
    of which follows the beam, they are the displacement of the crossbeam where its carriage stands at the lower end of
    the range, since the lever arm of the rotation contains the travel from there, and the rotation at the carriage."""
    bridge = beam.crossbeam
    if bridge is None:
        return moved, turned
    across = AXES.index(bridge.axis)
    low, high = ranges_mm[across]
    at_carriage = bridge.share(AxisPolynomial.linear(across, low, high - low))
    at_low = bridge.share(AxisPolynomial.constant(low))
    sense = 1.0 if beam.axis in chain.tool_side else -1.0
    length = sense * (bridge.other_mm - bridge.here_mm)
    # a crossbeam that is displaced by u at this end only has the slope -u / D along its direction m: rotation m × -u/D
    slope = polynomial_vector([_ZERO if axis == across else part * (-1.0 / length) for axis, part in enumerate(moved)])
    rotation = list(vector_product(unit_vector(across), slope))
    rotation[across] = at_carriage * turned[across]
    return polynomial_vector(
        [_ZERO if axis == across else at_low * part for axis, part in enumerate(moved)]
    ), polynomial_vector(rotation)


def _marked_redundant(terms: Sequence[DerivedTerm], model: ErrorModel) -> tuple[DerivedTerm, ...]:
    """Return the terms, marked as redundant if the error motions, rigid motions and the terms before them represent
    their deviation."""
    if not terms:
        return ()
    whole = ErrorModel(model.chain, model.ranges_mm, model.orders, (), tuple(_apart(terms)))
    low, high = np.array(model.ranges_mm).T
    points = low + np.random.default_rng(0).random((_POINTS, 3)) * (high - low)
    tool = _TOOL_SHARE * (high - low)
    columns = deviation_basis(whole, points, tool).reshape(-1, whole.size)
    rigid = rigid_fields(points, points.mean(axis=0), float((high - low).max())).reshape(-1, 6)
    plain = whole.size - len(terms)
    known = _orthonormal(np.concatenate((rigid, columns[:, :plain]), axis=1))
    marked = []
    for derived, column in zip(terms, columns[:, plain:].T, strict=True):
        rest = column
        for _ in range(2):  # the second pass removes the rounding errors of the first
            rest = rest - known @ (known.T @ rest)
        redundant = bool(np.linalg.norm(rest) <= _REDUNDANT * np.linalg.norm(column))
        if not redundant:
            known = np.concatenate((known, (rest / np.linalg.norm(rest))[:, None]), axis=1)
        marked.append(replace(derived, redundant=redundant))
    return tuple(marked)


def _apart(terms: Sequence[DerivedTerm]) -> Iterator[CrossTerm]:
    """Yield the terms with names that a model accepts beside those of column and ram."""
    for number, derived in enumerate(terms):
        yield replace(derived.term, name=f"{CROSS}[{number}]")


def _orthonormal(columns: Array) -> Array:
    scaled = columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    left, sizes, _ = np.linalg.svd(scaled, full_matrices=False)
    used: Array = left[:, sizes > 1e-10 * sizes[0]]
    return used
