"""Cross-effects derived from beams, against textbook formulas, a beam of many elements and statics by hand."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from many_elements import deflected_beam
from measured_set import RANGES, TOOL, bar, measured

from benchmarks.family import AMPLITUDES
from twin.errors import ModelError
from twin.formats.estimate_file import format_estimate, parse_estimate
from twin.identification import identify
from twin.machine.axis_polynomial import AxisPolynomial
from twin.machine.beam_flexibility import ENDS, beam_flexibility
from twin.machine.deviation_basis import deviation_basis
from twin.machine.error_model import ErrorModel
from twin.machine.forward_model import exact_deviation, linear_deviation
from twin.machine.kinematic_chain import parse_chain
from twin.machine.machine_population import family_from_amplitudes
from twin.machine.structure import BeamLoad, Crossbeam, DerivedTerm, StructuralBeam, derive_terms, own_axis_degrees
from twin.machine.volumetric import align_rigidly, evaluation_grid, rms

COLUMN_MACHINE = ErrorModel.uniform(parse_chain("tool-Y-Z-X-bed-workpiece"), RANGES, 5, ())
PORTAL_MACHINE = ErrorModel.uniform(parse_chain("tool-Z-Y-X-bed-workpiece"), RANGES, 5, ())
RAM = BeamLoad("ram", "Y", (0.0, 300.0, 0.0), mass_kg=2000.0)
COLUMN = StructuralBeam("column", "Z", "cantilever", (-500.0,), (RAM,), bending_n_mm2=4e15)
GRAVITY = 9.80665


def stated(derived: DerivedTerm) -> float:
    """Return the expected value of a term whose masses and stiffnesses are stated."""
    assert derived.expected is not None
    return derived.expected


def value(coefficients, s):
    return sum(coefficient * s**power for power, coefficient in enumerate(coefficients))


@pytest.mark.parametrize("ends", ENDS)
@pytest.mark.parametrize("at_mm", [150.0, 1000.0, 1999.0])
def test_the_response_under_the_load_is_that_of_many_elements(ends, at_mm):
    length, stiffness, force, moment = 2500.0, 3e13, 4000.0, -7e5
    given = beam_flexibility(ends, length)
    deflection = value(given.deflection_by_force, at_mm) * force + value(given.deflection_by_moment, at_mm) * moment
    slope = value(given.deflection_by_moment, at_mm) * force + value(given.slope_by_moment, at_mm) * moment
    wanted = deflected_beam(ends, length, at_mm, force, moment, stiffness)
    assert (deflection / stiffness, slope / stiffness) == pytest.approx(wanted, rel=1e-6)


def test_textbook_values():
    cantilever, supported, clamped = (beam_flexibility(ends, 2000.0) for ends in ENDS)
    assert value(cantilever.deflection_by_force, 900.0) == pytest.approx(900.0**3 / 3.0)  # P L³ / 3EI
    assert value(cantilever.deflection_by_moment, 900.0) == pytest.approx(900.0**2 / 2.0)  # M L² / 2EI
    assert value(supported.deflection_by_force, 1000.0) == pytest.approx(2000.0**3 / 48.0)  # P L³ / 48EI
    assert value(supported.slope_by_moment, 0.0) == pytest.approx(2000.0 / 3.0)  # M L / 3EI
    assert value(clamped.deflection_by_force, 1000.0) == pytest.approx(2000.0**3 / 192.0)  # P L³ / 192EI
    assert value(cantilever.twist_by_torque, 900.0) == pytest.approx(900.0)
    assert value(clamped.twist_by_torque, 500.0) == pytest.approx(500.0 * 1500.0 / 2000.0)


def test_a_beam_on_two_supports_needs_a_length():
    with pytest.raises(ModelError, match="positive length"):
        beam_flexibility("clamped")


def test_column_and_ram_are_the_published_cross_effect():
    derived = derive_terms([COLUMN], COLUMN_MACHINE)
    assert [(one.term.name, one.term.error, str(one.term.polynomial)) for one in derived] == [
        ("CROSS[b0]", "EYZ", "y"),
        ("CROSS[b1]", "EYZ", "y z"),
        ("CROSS[b2]", "EYZ", "y z²"),
        ("CROSS[c0]", "EAZ", "y"),
        ("CROSS[c1]", "EAZ", "y z"),
    ]
    assert [one.term.name for one in derived if not one.redundant] == ["CROSS[b1]", "CROSS[b2]", "CROSS[c1]"]
    # M = m g 1300 v at the height 500 + 1500 w: u = M h² / 2EI, slope -M h / EI
    per_stiffness = 2000.0 * GRAVITY * 1300.0 / 4e15
    by_hand = [500.0**2 / 2.0, 500.0 * 1500.0, 1500.0**2 / 2.0, -500.0, -1500.0]
    assert [one.expected for one in derived] == pytest.approx([per_stiffness * part for part in by_hand], rel=1e-12)


def test_a_structural_term_acts_as_the_term_of_column_and_ram():
    derived = derive_terms([COLUMN], COLUMN_MACHINE)
    own = tuple(replace(one.term, name=f"CROSS[own.{number}]") for number, one in enumerate(derived))
    points = np.random.default_rng(2).uniform(0.0, 1300.0, (40, 3))
    beams = deviation_basis(replace(COLUMN_MACHINE, structure=own), points, TOOL)
    paper = deviation_basis(replace(COLUMN_MACHINE, cross_effect=("b0", "b1", "b2", "c0", "c1")), points, TOOL)
    np.testing.assert_array_equal(beams, paper)


def test_a_column_that_hangs_from_above_leans_the_other_way():
    hanging = derive_terms([replace(COLUMN, supports_mm=(2000.0,))], COLUMN_MACHINE)
    v, w = np.random.default_rng(3).random((2, 20))
    found = {"EYZ": np.zeros(20), "EAZ": np.zeros(20)}
    for one in hanging:
        found[one.term.error] += stated(one) * one.term.polynomial.at([0.0 * v, v, w])
    moment, length = 2000.0 * GRAVITY * 1300.0 * v / 4e15, 2000.0 - 1500.0 * w
    np.testing.assert_allclose(found["EYZ"], -moment * length**2 / 2.0, rtol=1e-9)
    np.testing.assert_allclose(found["EAZ"], -moment * length, rtol=1e-9)


def test_a_reference_point_beside_the_beam_is_lifted_by_its_slope():
    derived = derive_terms([replace(COLUMN, reference_mm=(0.0, 200.0, 0.0))], COLUMN_MACHINE)
    by_name = {one.term.name: one for one in derived}
    slope = stated(by_name["CROSS[c1]"])
    assert by_name["CROSS[column.EZZ.1]"].expected == pytest.approx(200.0 * slope)
    # EAZ[1] turns the ram with its travel y, which lifts the tool by y z; a term in y alone is one of EZY
    assert by_name["CROSS[column.EZZ.1]"].redundant
    assert by_name["CROSS[column.EZZ.0]"].redundant


def test_loads_of_the_same_effect_are_one_parameter():
    head = BeamLoad("head", "Y", (0.0, 900.0, 0.0), 500.0)
    both = derive_terms([replace(COLUMN, loads=(RAM, head))], COLUMN_MACHINE)
    alone = derive_terms([COLUMN], COLUMN_MACHINE)
    assert [one.term for one in both] == [one.term for one in alone]
    assert [stated(one) for one in both] == pytest.approx([1.25 * stated(one) for one in alone])
    unknown = derive_terms([replace(COLUMN, loads=(RAM, replace(head, mass_kg=None)))], COLUMN_MACHINE)
    assert {one.expected for one in unknown} == {None}


def test_loads_of_different_effects_have_names_of_their_own():
    beams = portal_beams()
    ram = BeamLoad("ram", "Y", (-80.0, 200.0, 0.0), 700.0)
    fixed = BeamLoad("motor", "X", (300.0, 900.0, 0.0), 700.0)
    derived = derive_terms([replace(beam, loads=(*beam.loads, ram, fixed)) for beam in beams], PORTAL_MACHINE)
    names = [one.term.name for one in derived]
    assert len(set(names)) == len(names)
    of_loads = {f"CROSS[left.EBX.{load}]" for load in ("bridge", "ram", "motor")}
    # the motor has its place on the bridge, so that its share of the sag does not depend on Y
    assert of_loads | {"CROSS[left.EZX.bridge]", "CROSS[left.EZX.ram]"} <= set(names)
    assert "CROSS[left.EZX.motor]" not in names


def test_a_fixed_portal_has_no_cross_effect():
    fixed = ErrorModel.uniform(parse_chain("tool-Z-Y-bed-X-workpiece"), RANGES, 5, ())
    load = BeamLoad("saddle", "Z", (200.0, 0.0, -100.0), 1500.0)
    assert derive_terms([StructuralBeam("bridge", "Y", "clamped", (-200.0, 1500.0), (load,))], fixed) == ()


def test_a_knee_is_twisted_by_the_table():
    """C-frame: the knee is a cantilever in front of the machine, and the table moves sideways on it."""
    ranges = ((0.0, 800.0), (0.0, 500.0), (0.0, 400.0))
    model = ErrorModel.uniform(parse_chain("tool-Z-bed-Y-X-workpiece"), ranges, 4, ())
    table = BeamLoad("table", "X", (400.0, 0.0, 0.0), 500.0)
    knee = StructuralBeam("knee", "Y", "cantilever", (-300.0,), (table,), torsion_n_mm2=2e13)
    derived = derive_terms([knee], model)
    assert [(one.term.name, str(one.term.polynomial), one.redundant) for one in derived] == [
        ("CROSS[knee.EBY.0]", "x", True),
        ("CROSS[knee.EBY.1]", "x y", False),
    ]
    # The table stands at 400 - 800 x mm beside the knee, 300 + 500 y mm from its foot. Its torque about Y is
    # m g times that, and the tool errs against the workpiece's motion.
    assert derived[1].expected == pytest.approx(500.0 * GRAVITY * 800.0 * 500.0 / 2e13)


def test_a_crossrail_on_two_columns():
    """Portal with a vertically moving crossrail: the saddle hangs in front of the columns and bends them apart."""
    model = ErrorModel.uniform(parse_chain("tool-Y-Z-bed-X-workpiece"), RANGES, 5, ())
    saddle = BeamLoad("saddle", "Y", (250.0, 0.0, 0.0), 1800.0)
    beams = [
        StructuralBeam(name, "Z", "cantilever", (-600.0,), (saddle,), Crossbeam("Y", here, other), bending_n_mm2=3e15)
        for name, here, other in (("left", -100.0, 1500.0), ("right", 1500.0, -100.0))
    ]
    derived = derive_terms(beams, model)
    y, z = np.random.default_rng(4).random((2, 30))
    motions = crossrail_by_hand(1300.0 * y, 1500.0 * z)
    # what depends on Z alone belongs to the series of Z: the values at the lower end of Y are left out
    wanted = {error: motions[error] - crossrail_by_hand(0.0 * y, 1500.0 * z)[error] for error in motions}
    found = {error: np.zeros(30) for error in wanted}
    for one in derived:
        found[one.term.error] += stated(one) * one.term.polynomial.at([0.0 * y, y, z])
    assert set(found) == {"EXZ", "EBZ", "ECZ"}
    for error, values in wanted.items():
        np.testing.assert_allclose(found[error], values, atol=1e-9 * np.abs(values).max())


def crossrail_by_hand(y, z):
    """Return the error motions of the rail. The columns at -100 and 1500 mm share the moment m g e about Y, lean
    forwards and twist the rail; no force bends them."""
    moment, height, share = 1800.0 * GRAVITY * 250.0, 600.0 + z, (y + 100.0) / 1600.0
    left, right = (1.0 - share) * moment / 3e15, share * moment / 3e15
    lean_left, lean_right = left * height**2 / 2.0, right * height**2 / 2.0
    return {
        # where the lever arm of Z begins, at the lower end of Y
        "EXZ": (1500.0 * lean_left + 100.0 * lean_right) / 1600.0,
        "EBZ": ((1.0 - share) * left + share * right) * height,
        "ECZ": (lean_left - lean_right) / 1600.0,
    }


@cache
def rail_response() -> tuple[np.ndarray, np.ndarray]:
    """Positions X and the unit response (n, 2, 2) of a rail of many elements on two supports, 4800 mm apart: deflection
    and slope by 1 N and by 1 N mm, with EI = 1.5e15 N mm²."""
    places = np.linspace(0.0, 4000.0, 81)
    loads = ((1.0, 0.0), (0.0, 1.0))
    return places, np.array(
        [[deflected_beam("supported", 4800.0, x + 400.0, *load, 1.5e15) for load in loads] for x in places]
    )


def portal_truth(at, tool):
    """Deviation in mm of a portal on two rails at Y = -300 and 1600 mm: 3000 kg on the bridge, 150 mm in front."""
    places, response = rail_response()
    x, y, z = np.asarray(at).T
    unit = np.array([[np.interp(x, places, response[:, load, kind]) for kind in (0, 1)] for load in (0, 1)])
    share, weight = (y + 300.0) / 1900.0, 3000.0 * GRAVITY
    rails = []
    for part in (1.0 - share, share):
        down, about_y = -weight * part, weight * 150.0 * part
        # the slope dw/dx is a rotation about -Y
        sag = unit[0, 0] * down - unit[1, 0] * about_y
        rails.append((sag, -(unit[0, 1] * down - unit[1, 1] * about_y)))
    (sag_left, turn_left), (sag_right, turn_right) = rails
    about_x = (sag_right - sag_left) / 1900.0
    about_y = (1.0 - share) * turn_left + share * turn_right
    at_saddle = (1.0 - share) * sag_left + share * sag_right
    arm_x, arm_y, arm_z = tool[0], tool[1], tool[2] + z
    return np.stack((about_y * arm_z, -about_x * arm_z, at_saddle + about_x * arm_y - about_y * arm_x), axis=1)


def portal_beams():
    load = BeamLoad("bridge", "Y", (150.0, 0.0, 0.0), 3000.0)
    return [
        StructuralBeam(
            name, "X", "supported", (-400.0, 4400.0), (load,), Crossbeam("Y", here, other), bending_n_mm2=1.5e15
        )
        for name, here, other in (("left", -300.0, 1600.0), ("right", 1600.0, -300.0))
    ]


def test_the_derived_portal_is_the_one_of_many_elements():
    """Beyond what the error motions of single axes represent, the terms with their expected values are the truth."""
    derived = derive_terms(portal_beams(), PORTAL_MACHINE)
    model = replace(PORTAL_MACHINE, structure=tuple(one.term for one in derived))
    values = np.zeros(model.size)
    values[PORTAL_MACHINE.size :] = [stated(one) for one in derived]
    grid = evaluation_grid(RANGES, (9, 5, 5))
    rest = align_rigidly(grid + TOOL, portal_truth(grid, TOOL) - linear_deviation(model, grid, TOOL, values))
    series = deviation_basis(PORTAL_MACHINE, grid, TOOL).reshape(-1, PORTAL_MACHINE.size)
    series = np.stack([align_rigidly(grid + TOOL, column.reshape(-1, 3)).ravel() for column in series.T], axis=1)
    unexplained = rest.ravel() - series @ np.linalg.lstsq(series, rest.ravel(), rcond=1e-10)[0]
    truth = align_rigidly(grid + TOOL, portal_truth(grid, TOOL))
    without = truth.ravel() - series @ np.linalg.lstsq(series, truth.ravel(), rcond=1e-10)[0]
    assert np.sqrt(np.mean(without**2)) > 1e-3
    assert np.sqrt(np.mean(unexplained**2)) < 2e-5


def test_a_portal_is_corrected_better_with_its_beams():
    derived = derive_terms(portal_beams(), PORTAL_MACHINE)
    active = tuple(one for one in derived if not one.redundant)
    sizes: dict[str, float | list[float]] = {
        one.term.name: (1e3 if one.term.unit == "mm" else 1e6) * abs(stated(one)) for one in active
    }
    artefact, rng = bar(7), np.random.default_rng(5)
    grid = evaluation_grid(RANGES, (12, 6, 6))
    seen = measured("S3", 3, artefact, portal_truth, rng, sigma_mm=5e-4)
    truth, left = portal_truth(grid, TOOL), {}
    for structure in ((), tuple(one.term for one in active)):
        model = replace(PORTAL_MACHINE, structure=structure)
        found = identify(model, seen, artefact, family_from_amplitudes(model, AMPLITUDES | sizes))
        error = truth - linear_deviation(model, grid, TOOL, found.parameters)
        left[len(structure)] = rms(align_rigidly(grid + TOOL, error))
    without, with_beams = left.values()
    assert with_beams < 0.4 * without
    # the terms are stored with the estimate
    assert parse_estimate(format_estimate(found, {}), "estimate.json").model == found.model == model


def test_exact_and_linear_deviation_agree():
    derived = derive_terms(portal_beams(), PORTAL_MACHINE)
    model = replace(PORTAL_MACHINE, structure=tuple(one.term for one in derived))
    values = np.zeros(model.size)
    values[PORTAL_MACHINE.size :] = [stated(one) for one in derived]
    points = evaluation_grid(RANGES, (4, 4, 3))
    exact = exact_deviation(model, points, TOOL, values)
    np.testing.assert_allclose(exact, linear_deviation(model, points, TOOL, values), atol=5e-6)
    assert np.abs(exact).max() > 5e-3


@pytest.mark.parametrize(
    ("beam", "says"),
    [
        (replace(COLUMN, supports_mm=(-500.0, 2000.0)), "one support, not 2"),
        (replace(COLUMN, supports_mm=(200.0,)), "inside the range of Z"),
        (replace(COLUMN, ends="clamped"), "two supports, not 1"),
        (replace(COLUMN, ends="supported", supports_mm=(0.0, 900.0)), "do not enclose the range of Z"),
        (replace(COLUMN, loads=(replace(RAM, carried_by="X"),)), "does not carry the load 'ram', which X moves"),
        (replace(COLUMN, crossbeam=Crossbeam("X", 0.0, 4000.0)), "does not carry the axis X"),
        (replace(COLUMN, crossbeam=Crossbeam("Y", 0.0, 900.0)), "do not enclose the range of Y"),
    ],
)
def test_a_beam_that_does_not_suit_the_machine(beam, says):
    with pytest.raises(ModelError, match=says) as caught:
        derive_terms([beam], COLUMN_MACHINE)
    assert caught.value.where["beam"] == "column"


def test_polynomials_by_hand():
    y, z = AxisPolynomial.linear(1, 2.0, 3.0), AxisPolynomial.linear(2, -1.0, 1.0)
    product = y * z + y * -2.0
    at = [np.array([0.7]), np.array([0.5]), np.array([0.25])]
    assert product.at(at) == pytest.approx((2.0 + 1.5) * (-0.75) - 2.0 * 3.5)
    assert y.inserted_into([1.0, 0.0, 2.0]).at(at) == pytest.approx(1.0 + 2.0 * 3.5**2)
    assert (product.degrees, product.axes) == ((0, 1, 1), (1, 2))
    assert str(AxisPolynomial.of([((0, 1, 2), 1.0), ((0, 1, 0), -0.5)])) == "- 0.5 y + y z²"
    assert str(AxisPolynomial()) == "0"
    shape, largest = AxisPolynomial.of([((1, 0, 0), 4.0), ((2, 0, 0), -8.0)]).normalised()
    assert largest == -4.0
    assert shape.at([np.ones(1)] * 3) == pytest.approx(1.0)
    assert AxisPolynomial.of([((1, 0, 0), 0.1), ((1, 0, 0), 0.2), ((1, 0, 0), -0.3)]) == AxisPolynomial()


def test_no_value_within_the_ranges_exceeds_that_of_the_normalised_polynomial():
    """EBX of the gantry is s b (b - s) in x, largest at 0.5 ± √3/6 of the length of its rails."""
    polynomials = [one.term.polynomial for one in derive_terms(portal_beams(), PORTAL_MACHINE)]
    clamped = [replace(beam, ends="clamped") for beam in portal_beams()]
    polynomials += [one.term.polynomial for one in derive_terms(clamped, PORTAL_MACHINE)]
    x, y = (part.ravel() for part in np.meshgrid(np.linspace(0.0, 1.0, 1501), np.linspace(0.0, 1.0, 41)))
    largest = [np.abs(polynomial.at([x, y, 0.0 * x])).max() for polynomial in polynomials]
    assert len(largest) >= 6
    np.testing.assert_allclose(largest, 1.0, rtol=0.0, atol=2e-6)
    assert max(largest) < 1.0 + 1e-9


def test_the_sign_of_an_antisymmetric_polynomial_does_not_depend_on_rounding():
    # x (1 - x) (1 - 2 x) is ± √3/18 at 0.5 ± √3/6
    for tiny in (-1e-13, 0.0, 1e-13):
        shape, largest = AxisPolynomial.of([((1, 1, 0), 1.0), ((2, 1, 0), -3.0), ((3, 1, 0), 2.0 + tiny)]).normalised()
        assert largest == pytest.approx(np.sqrt(3.0) / 18.0, rel=1e-9)
        assert shape.at([np.array([0.5 - np.sqrt(3.0) / 6.0]), np.ones(1), np.zeros(1)]) == pytest.approx(1.0)


@pytest.mark.parametrize(("ends", "displacement", "by_moment"), [("supported", 4, 3), ("clamped", 6, 5)])
def test_the_degree_in_the_axis_of_the_beam_alone(ends, displacement, by_moment):
    """The deflection under a force that moves is s²b², or s³b³ of a clamped beam, and the slope its half derivative."""
    degrees = own_axis_degrees([replace(beam, ends=ends) for beam in portal_beams()], PORTAL_MACHINE)
    assert (degrees["EZX"], degrees["EAX"], degrees["EBX"]) == (displacement, displacement, by_moment)
    # the ram of the column is at the lower end of Y 300 mm in front of the column: u = M h² / 2EI
    assert own_axis_degrees([COLUMN], COLUMN_MACHINE) == {"EYZ": 2, "EAZ": 1}


def test_an_estimate_without_other_beams_and_instruments_is_stored_as_before():
    """A run that is resumed after an update compares its estimate with the one that it stored before."""
    artefact = bar(4)
    seen = measured("S3", 1, artefact, portal_truth, np.random.default_rng(6), sigma_mm=5e-4)
    model = ErrorModel.uniform(parse_chain("tool-Z-Y-X-bed-workpiece"), RANGES, 2, ())
    text = format_estimate(identify(model, seen, artefact, family_from_amplitudes(model, AMPLITUDES)), {})
    document = json.loads(text)
    assert "instruments" not in document
    assert set(document["model"]) == {"chain", "ranges_mm", "orders", "cross_effect"}
    assert parse_estimate(text, "estimate.json").instruments == ()
