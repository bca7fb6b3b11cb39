"""Beams in a machine file: what they make of the error model and its prior, and what each mistake says."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from twin.errors import FormatError, ModelError
from twin.formats.machine_file import parse_machine
from twin.machine.axis_polynomial import AxisPolynomial
from twin.machine.cross_term import CrossTerm
from twin.machine.machine_population import family_from_amplitudes
from twin.uncertainty.residual_field_form import FieldForm, joint_model
from twin.uncertainty.truth_assumptions import TruthAssumptions

ROOT = Path(__file__).parents[3]
MACHINES = ROOT / "config" / "machines"
PLAIN = (MACHINES / "case-study.toml").read_text(encoding="utf-8")
REFERENCE = (ROOT / "docs" / "reference" / "files.md").read_text(encoding="utf-8")
COLUMN = "\n" + REFERENCE.split("```toml\n[[beams]]", 1)[1].split("```", 1)[0].join(("[[beams]]", ""))
TEXT = "\n".join(line for line in PLAIN.splitlines() if not line.startswith("cross_effect")) + COLUMN


def read_beside(name):
    return (MACHINES / name).read_text(encoding="utf-8")


def parse(text):
    return parse_machine(text, "m.toml", read_beside)


def test_a_column_and_a_ram_are_the_model_of_the_case_study():
    machine, plain = parse(TEXT), parse(PLAIN)
    assert machine.model == plain.model
    assert machine.model.names == plain.model.names
    assert [one.term.name for one in machine.derived_terms if one.redundant] == ["CROSS[b0]", "CROSS[c0]"]
    # m g L_y L_z² / 2EI, in mm: 1500 kg, 1300 mm and 1500 mm
    width = machine.family.half_widths[machine.model.index("CROSS[b2]")]
    assert width == pytest.approx(1500.0 * 9.80665 * 1300.0 * 1500.0**2 / (2.0 * 120e3 * 3.3e10))
    assert machine.with_order(3).family.half_widths[-2] == pytest.approx(width)


def test_without_a_mass_or_a_stiffness_the_family_of_the_kind_applies():
    for missing in ("mass_kg = 1500.0\n", "youngs_modulus_gpa = 120.0\nsecond_moment_mm4 = 3.3e10\n"):
        assert missing in TEXT
        machine = parse(TEXT.replace(missing, ""))
        assert all(one.expected is None for one in machine.derived_terms)
        assert machine.family.half_widths[machine.model.index("CROSS[b2]")] == pytest.approx(4.5e-3)


def test_a_half_width_of_zero_does_not_silently_hold_a_parameter_at_zero():
    """Machine files that `volcal init` writes for machines without a ram contain zeros."""
    zero = TEXT.replace("cross_displacement_um = 4.5", "cross_displacement_um = 0.0")
    zero = zero.replace("cross_rotation_urad = 3.0", "cross_rotation_urad = 0.0")
    assert zero.count(" = 0.0\n") == 2
    assert (parse(zero).family.half_widths[-3:] > 0.0).all()  # masses and stiffnesses are stated
    unknown = zero.replace("mass_kg = 1500.0\n", "")
    with pytest.raises(FormatError, match=r"the half-width of CROSS\[b1\] is 0, so this effect") as caught:
        parse(unknown)
    assert caught.value.where == {"file": "m.toml", "key": "model.family.cross_displacement_um", "beam": "column"}
    assert "masses and stiffnesses" in caught.value.hint
    with pytest.raises(FormatError, match=r"CROSS\[c1\]") as caught:
        parse(unknown.replace("cross_displacement_um = 0.0", "cross_displacement_um = 4.5"))
    assert caught.value.where["key"] == "model.family.cross_rotation_urad"


def test_the_beams_are_part_of_the_description():
    assert [beam.name for beam in parse(TEXT).beams] == ["column"]
    assert parse(PLAIN).beams == ()


@pytest.mark.parametrize(
    ("old", "new", "key", "says"),
    [
        ("supports_mm", "support_mm", "beams[0].support_mm", "Did you mean 'supports_mm'"),
        ('axis = "Z"', 'axis = "W"', "beams[0].axis", "'X', 'Y' or 'Z'"),
        ('ends = "cantilever"', 'ends = "welded"', "beams[0].ends", "'cantilever', 'supported' or 'clamped'"),
        ("[-500.0]", "[]", "beams[0].supports_mm", "at least 1 item"),
        ("[-500.0]", "[200.0]", "beams[0]", "the support at 200 mm is inside the range of Z"),
        ("= 120.0", "= -1.0", "beams[0].youngs_modulus_gpa", "greater than 0"),
        ("youngs_modulus_gpa = 120.0", "", "beams[0]", "second_moment_mm4 is stated alone"),
        ('name = "column"', 'name = "the column"', "beams[0].name", "match pattern"),
        ('carried_by = "Y"', 'carried_by = "X"', "beams[0]", "does not carry the load 'ram', which X moves"),
        ("mass_kg = 1500.0", "mass = 1500.0", "beams[0].loads[0].mass", "Did you mean 'mass_kg'"),
        ("centre_mm = [0.0, 250.0, 0.0]", "", "beams[0].loads[0].centre_mm", "is missing"),
        ("order = 5 ", "cross_effect = true\norder = 5 ", "model.cross_effect", "Remove cross_effect or the beams"),
        (
            'ends = "cantilever"',
            'ends = "cantilever"\ncrossbeam = { axis = "Y", here_mm = 1.0, other_mm = 1.0 }',
            "beams[0].crossbeam",
            "at the same position",
        ),
    ],
)
def test_each_mistake_names_the_key_and_what_is_wrong(old, new, key, says):
    assert old in TEXT
    with pytest.raises(FormatError) as caught:
        parse(TEXT.replace(old, new, 1))
    assert (caught.value.where["file"], caught.value.where["key"]) == ("m.toml", key)
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)


def test_names_are_distinct():
    with pytest.raises(FormatError, match="two beams are called 'column'"):
        parse(TEXT + COLUMN)
    load = COLUMN[COLUMN.index("[[beams.loads]]") :]
    with pytest.raises(FormatError, match="two loads are called 'ram'"):
        parse(TEXT + load)


TERM = CrossTerm("CROSS[rail.EZX]", "EZX", AxisPolynomial.of([((1, 1, 0), 0.25), ((2, 1, 0), -0.1)]))


def test_a_joint_model_contains_the_terms_of_both():
    plain = parse(PLAIN).model
    other = replace(TERM, name="CROSS[rail.EXX]", error="EXX")
    joint = joint_model(replace(plain, structure=(TERM,)), replace(plain, structure=(TERM, other)))
    assert joint.structure == (TERM, other)
    assert joint.names[-2:] == ("CROSS[rail.EZX]", "CROSS[rail.EXX]")


def test_a_joint_model_tells_terms_of_the_same_name_apart():
    """The true machines have a longer rail than the model: the same names, but other polynomials."""
    plain = parse(PLAIN)
    longer = replace(TERM, polynomial=AxisPolynomial.of([((1, 1, 0), 0.5), ((2, 1, 0), -0.3)]))
    other = replace(TERM, name="CROSS[rail.EXX]", error="EXX")
    model = replace(plain.model, structure=(TERM, other))
    truth = family_from_amplitudes(replace(plain.model, structure=(other, longer)), plain.amplitudes)
    joint = joint_model(model, truth.model)
    assert joint.names[-3:] == ("CROSS[rail.EZX]", "CROSS[rail.EXX]", "CROSS[rail.EZX (other)]")
    grid = [[x, y, 100.0] for x in (0.0, 900.0, 2000.0) for y in (50.0, 700.0)]
    form = FieldForm.build(model, TruthAssumptions(truth), grid, np.zeros(3))
    assert form.model_indices[-2:].tolist() == [form.size - 3, form.size - 2]
    assert form.true_indices[-2:].tolist() == [form.size - 2, form.size - 1]
    assert form.unmodelled[-2:].tolist() == [False, True]


@pytest.mark.parametrize(
    ("terms", "says"),
    [
        ((TERM, TERM), "listed twice"),
        ((replace(TERM, name="CROSS[b1]"),), "listed twice"),
        ((replace(TERM, error="EZW"),), "'EZW' is not an error motion"),
        ((replace(TERM, name="rail"),), "the name of a cross-effect must be"),
    ],
)
def test_a_model_refuses_terms_that_it_cannot_hold(terms, says):
    with pytest.raises(ModelError, match=says):
        replace(parse(PLAIN).model, structure=terms)


def test_the_values_of_the_terms_are_the_last_parameters():
    model = replace(parse(PLAIN).model, structure=(TERM,))
    values = np.arange(float(model.size))
    assert model.column_and_ram(values) == {"b0": 0.0, "b1": 87.0, "b2": 88.0, "c0": 0.0, "c1": 89.0}
    assert model.cross_values(values).tolist() == [87.0, 88.0, 89.0, 90.0]
    assert model.field_degrees == (6, 6, 6)
    assert replace(model.with_orders(dict.fromkeys(model.orders, 1)), structure=(TERM,)).field_degrees == (3, 3, 3)
