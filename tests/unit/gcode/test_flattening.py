"""Parameters, expressions, O-words, subprograms and canned cycles: the plain blocks, and what is refused."""

from __future__ import annotations

from collections.abc import Iterable
from operator import add, mul, sub, truediv

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gcode.correction import correct_program
from gcode.flattening import flattener
from gcode.setup import CorrectionOptions, PartSetup
from gcode.setup_file import parse_part_setup
from twin.compensation.table import CompensationTable, regular_nodes
from twin.errors import FormatError
from twin.machine.anchor import Anchor

NODES = regular_nodes(((-1000.0, 1000.0),) * 3, (1000.0,) * 3)
NOTHING = CompensationTable(
    *NODES, np.zeros((3, 3, 3, 3)), np.zeros(3), Anchor(np.zeros(3)), np.zeros((3, 3, 3), dtype=bool)
)
OPTIONS = CorrectionOptions(max_chord_error_mm=0.01, decimals=3)


def flat(
    program: str, parameters: dict[str, float] | None = None, files: dict[str, str] | None = None, **setup: object
) -> list[str]:
    """Return the blocks of a program that is corrected with a table of zeros."""
    known = {"work_offsets": {"G54": (0.0, 0.0, 0.0)}, **setup}
    start = PartSetup(start=(0.0, 0.0, 0.0), parameters=parameters or {}, **known)  # type: ignore[arg-type]
    written: list[str] = []

    def found(name: str) -> Iterable[str] | None:
        return files[name].splitlines() if files and name in files else None

    correct_program(program.splitlines(), NOTHING, start, OPTIONS, written.append, files=found)
    return [block.strip() for block in "".join(written).splitlines()]


def number(expression: str) -> float:
    """Return the value of an expression."""
    (block,) = flat(f"G4 P[{expression}]")
    return float(block.removeprefix("G4 P"))


@pytest.mark.parametrize(
    ("expression", "value"),
    [
        ("1 + 2 * 3", 7.0),
        ("2 ** 3 ** 2", 64.0),  # from left to right
        ("-2 ** 2", 4.0),  # the sign belongs to the number
        ("-7 mod 3", 2.0),
        ("10 / 4 * 2", 5.0),
        ("1 eq 1.00005", 1.0),
        ("1 ne 1.0002", 1.0),
        ("1 or 0 and 0", 0.0),  # the same precedence
        ("1 xor 1", 0.0),
        ("2 + 3 gt 4 and 1", 1.0),
        ("round[-2.5]", -3.0),
        ("fix[-1.5]", -2.0),
        ("fup[-1.5]", -1.0),
        ("atan[1]/[-1]", 135.0),
        ("sqrt[16] + abs[-1]", 5.0),
        ("sin[30]", 0.5),
        ("exists[#<missing>]", 0.0),
        ("- [3]", -3.0),
    ],
)
def test_values_are_those_of_linuxcnc(expression: str, value: float) -> None:
    assert number(expression) == pytest.approx(value, abs=1e-9)


OPERATORS = {"+": add, "-": sub, "*": mul, "/": truediv}


@settings(deadline=None, max_examples=50)
@given(st.floats(-100.0, 100.0), st.floats(0.5, 100.0), st.sampled_from(sorted(OPERATORS)))
def test_arithmetic(left: float, right: float, operator: str) -> None:
    left, right = round(left, 4), round(right, 4)
    found = number(f"[{left:.4f}] {operator} [{right:.4f}]")
    assert found == pytest.approx(OPERATORS[operator](left, right), abs=1e-8)


def test_assignments_take_effect_after_their_line() -> None:
    assert flat("#1=2\n#1=3 G1 X#1 F100\nX#1\n##1=7 #<a b>=[#1+1]\nY#3 Z#<AB>") == [
        "G1 X2.000 F100",
        "X3.000",
        "Y7.000 Z4.000",
    ]


def test_a_plain_program_stays_as_it_is() -> None:
    lines = ["%", "O0001", "G21 (roughing, #2 OR 3)", "G0 X1.000", "M30", "%"]
    assert flat("\n".join(lines)) == lines


def test_loops_and_conditions() -> None:
    program = """#1=0
o1 while [#1 lt 5]
  #1=[#1+1]
  o2 if [#1 eq 2]
    o1 continue
  o2 elseif [#1 eq 4]
    o1 break
  o2 else
    M8
  o2 endif
  G4 P#1
o1 endwhile
o3 do
  #1=[#1-1]
o3 while [#1 gt 2]
o4 repeat [#1]
  G4 P[10*#1]
o4 endrepeat
M2
"""
    assert flat(program) == ["M8", "G4 P1", "M8", "G4 P3", "G4 P20", "G4 P20", "M2"]


def test_subroutines_have_their_own_parameters_and_return_a_value() -> None:
    program = """o<twice> sub
  #<local>=[2*#1] #2=99
o<twice> endsub [#<local>]
#1=1 #2=5 #<local>=8
o<twice> call [21]
G4 P#<_value>
G4 P[#1+#2+#<local>]
o[50+50] call [4]
G4 P#<_value>
M2
"""
    library = {"100": "o100 sub\no1 if [#1 gt 0]\n  o100 return [#1*#1]\no1 endif\nM0\no100 endsub\nM2\n"}
    assert flat(program, files=library) == ["G4 P42", "G4 P14", "G4 P16", "M2"]


def test_numbered_subprograms() -> None:
    program = "%\nO1\n#1=1\nM98 P20 L2\nM98 P30\nM30\nO20\nG4 P#1\n#1=[#1+1]\nM99\nO30\nM98 P20\nM99\n%\n"
    assert flat(program) == ["%", "O1", "G4 P1", "G4 P2", "G4 P3", "M30", "%"]


POLAR_START = "G90 G0 X20 Y0 Z0"


@pytest.mark.parametrize(
    ("before", "block", "end"),
    [
        ("", "G91 G1 @-1 ^30 F100", (16.4545, 9.5, 0.0)),
        ("", "@-1 ^30 F100 G1 G91", (16.4545, 9.5, 0.0)),
        ("G91", "G90 G1 @10 ^90 F100", (0.0, 10.0, 0.0)),
        ("", "G91 G0 ^[60 - 30]", (17.3205, 10.0, 0.0)),
        ("", "G55 G1 @10 ^0 F100", (15.0, -5.0, 0.0)),
        ("", "G20 G1 @1 ^90 F100", (0.0, 25.4, 0.0)),
        ("", "G43.1 Z3\nG49 G1 @10 F100 Z4", (10.0, 0.0, 4.0)),
        ("", "G91 G3 @0 ^90 I-20 J0 F100", (0.0, 20.0, 0.0)),
    ],
)
def test_polar_coordinates_belong_to_the_modes_of_their_own_block(
    before: str, block: str, end: tuple[float, float, float]
) -> None:
    program = f"{POLAR_START}\n{before}\n{block}\nG21 G54 G90\nG4 P#5420\nG4 P#5421\nG4 P#5422\n"
    blocks = flat(program, work_offsets={"G54": (0.0, 0.0, 0.0), "G55": (5.0, -5.0, 0.0)})
    assert [float(line.removeprefix("G4 P")) for line in blocks[-3:]] == pytest.approx(end, abs=1e-3)


@pytest.mark.parametrize(
    ("block", "reason"),
    [
        ("G53 G0 @10 ^30", "G53 cannot use them"),
        ("G28 @10 ^30", "a code that uses the axis words"),
        ("G92 @10 Z3", "a code that uses the axis words"),
        ("G1 @10 X3 F100", "X or Y together"),
        ("G18 G1 @10 F100", "need G17"),
        ("G0 X0 Y0\nG1 @10 F100", "has no angle"),
        ("G0 X0 Y0\nG91 G1 @10 ^30 F100", "has no angle"),
        ("@10 @20", "occurs twice"),
        ("G80 @10", "none of G0 to G3"),
    ],
)
def test_polar_coordinates_that_are_no_motion_are_refused(block: str, reason: str) -> None:
    with pytest.raises(FormatError, match=reason):
        flat(f"{POLAR_START}\n{block}\n")


def test_canned_cycles_become_moves() -> None:
    blocks = flat("G61 G0 X1 Y1 Z10\nG99 G81 X5 Z-2 R1 F100\nY3\nG98 X7\nG80\nG0 X0")
    first, second = ["G0 X5.000", "G0 Z1.000", "G1 Z-2.000", "G0 Z1.000"], ["G0 Y3.000", "G1 Z-2.000", "G0 Z1.000"]
    third = ["G0 X7.000", "G1 Z-2.000", "G0 Z10.000"]
    assert blocks == ["G61 G0 X1.000 Y1.000 Z10.000", "F100", *first, *second, *third, "G80", "G0 X0.000"]


@pytest.mark.parametrize(
    ("program", "reason"),
    [
        ("o1 while [1]\no1 endwhile", "5040 lines and blocks of canned cycles were executed.*of 2 lines.*line [12]"),
        ("o1 while [1]\nG99 G81 Z-1 R0 L1000\no1 endwhile", "5060 lines and blocks.*of 3 lines.*line 2"),
        ("G99 G81 Z-1 R0 L10000", "5020 lines and blocks.*of 1 lines.*line 1"),
        ("G99 G83 Z-1 R0 Q0.0001 L9", "5020 lines and blocks.*line 1"),
        ("o1 sub\no1 call\no1 endsub\no1 call", "more than 100 deep"),
        ("o1 if [1]\nM2", "not closed.*line 1"),
        ("o1 if [1]\no2 endif", "no open o<2> if.*line 2"),
        ("o1 break", "not in a loop"),
        ("o1 sub\no1 endsub\no1 sub\no1 endsub", "defined twice"),
        ("o1 endsub", "no open"),
        ("G1 X[1/0]", "not a finite number"),
        ("G1 X[sqrt[-1]]", "SQRT is not a finite"),
        ("G1 X[10**400]", "finite"),
        ("G1 X" + "[" * 60 + "1" + "]" * 60, "nested more than 50"),
        ("G1 X#<_hal[a]>", "known only to the controller"),
        ("#5061=1", "belongs to the controller"),
        ("G1 X#5061", "known only to the controller"),
        ("/#1=5", "block delete"),
        ("/o1 if [1]\no1 endif", "block delete"),
        ("M99", "repeats it for ever"),
        ("M98 P7", "no file 7.ngc"),
        ("G81 X1 Z-1", "needs the word R"),
        ("G83 Z-1 R1", "needs the word Q"),
        ("G83 Z-1 R1 Q0", "depth of a peck"),
        ("G81 Z1 R0", "below the bottom"),
        ("G81 Z-1 R0 L0", "number of repetitions"),
        ("G93 F1\nG81 Z-1 R0", "inverse-time"),
        ("G86 Z-1 R0 P1", "turning spindle"),
        ("#1=1 (abort, stop)", "the program stops here"),
        ("G1 X[1", "is expected at the end"),
        ("G1 Xfoo[1]", "is expected before"),
        ("o1 whale [1]", "not the keyword"),
        ("G64 P0.1\nM70\nM72\nM72\no1 sub\nM72\no1 endsub\no1 call", "none was saved"),
    ],
)
def test_what_cannot_be_executed_is_refused_with_its_line(
    program: str, reason: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(flattener, "_MOST_EXECUTED", 5000)
    with pytest.raises(FormatError, match=f"(?s){reason}") as error:
        flat(program)
    assert "line" in error.value.where


def test_a_loop_that_neither_moves_nor_ends_is_refused_soon() -> None:
    with pytest.raises(FormatError, match="100000 lines were executed one after the other without a block") as error:
        flat("#1 = 1\no1 while [#1 lt 30]\n#1 = #1\no1 endwhile")
    assert "line" in error.value.where
    longest = "#1 = 0\no1 while [#1 lt 30000]\n#1 = [#1 + 1]\no1 endwhile\nG1 X[#1 / 100]\n"
    assert flat(longest * 2)[-1] == "G1 X300.000"


@pytest.mark.parametrize("in_file", [False, True])
def test_a_long_program_may_execute_more_than_a_short_one(in_file: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(flattener, "_MOST_EXECUTED", 50)
    loop = "o2 repeat [50]\nG99 G81 X1 Z-1 R0\no2 endrepeat"
    comments = "\n".join(["(a long program)"] * 10)
    with pytest.raises(FormatError, match="lines and blocks"):
        flat(f"G61\n{loop}\nM2")
    if in_file:
        blocks = flat("G61\no<a> call\nM2", files={"a": f"o<a> sub\n{comments}\n{loop}\no<a> endsub"})
    else:
        blocks = flat(f"G61\n{comments}\n{loop}\nM2")
    assert blocks.count("G1 Z-1.000") == 50


def test_an_error_in_a_subprogram_file_names_the_file_and_its_line() -> None:
    with pytest.raises(FormatError) as error:
        flat("o<a> call\nM2", files={"a": "o<a> sub\nG1 X5000 F1\no<a> endsub"})
    assert error.value.where == {"line": "2", "file": "a.ngc"}


def test_values_in_the_controller_can_be_given() -> None:
    assert flat("G4 P[#100 + #<_depth>]", parameters={"100": 2.0, "_depth": 0.5}) == ["G4 P2.5"]


def test_the_hint_after_a_tool_change() -> None:
    with pytest.raises(FormatError, match="--tool-change stays"):
        flat("T1 M6\nG1 X1 F100")
    with pytest.raises(FormatError, match="--tool-change stays"):
        flat("T1 M6\nG81 X1 Z-1 R1")


def test_levels_of_a_canned_cycle_belong_to_one_frame() -> None:
    cycle = "G98 G0 X0 Y0 Z10\nG81 X1 Z-3 R2 F100"
    for change in ("G20", "G18", "G92 Z5", "G43.1 Z3", "G10 L20 P1 Z1"):
        with pytest.raises(FormatError, match="has changed during a canned cycle"):
            flat(f"{cycle}\n{change}\nX2")
        # After G80 the levels are those of the new block.
        flat(f"{cycle}\nG80\n{change}\nG81 X2 Y-9 Z-9 R-8")


def test_a_tool_length_is_no_canned_cycle() -> None:
    blocks = flat("G61 G99 G0 X0 Y0 Z10\nG81 X1 Z-3 R2 F100\nG43.1 X4\nG80")
    assert blocks[-2:] == ["G43.1 X4", "G80"]


def test_pecks_return_to_r_and_reaming_feeds_to_r() -> None:
    peck = flat("G61 G98 G0 X0 Y0 Z10\nG83 Z-2 R2 Q3 F100")
    assert peck[-6:] == ["G0 Z2.000", "G1 Z-1.000", "G0 Z2.000", "G0 Z-0.746", "G1 Z-2.000", "G0 Z10.000"]
    assert flat("G61 G98 G0 X0 Y0 Z10\nG85 Z-2 R2 F100")[-3:] == ["G1 Z-2.000", "G1 Z2.000", "G0 Z10.000"]


@pytest.mark.parametrize(("retract", "last"), [("G98", "G0 Z10.000"), ("G99", "G0 Z2.000")])
def test_the_level_to_which_a_cycle_returns_must_be_known(retract: str, last: str) -> None:
    program = "G61 G0 X0 Y0 Z10\nG81 X1 Z-3 R2 F100"
    with pytest.raises(FormatError, match="initial level or to R"):
        flat(program)
    assert flat(program, retract=retract)[-1] == last
    other = "G98" if retract == "G99" else "G99"
    assert flat(f"{retract}\nM70\n{other}\nM72\n{program}")[-1] == last
    # Both are the same from R.
    assert flat("G61 G0 X0 Y0 Z2\nG81 X1 Z-3 R2 F100")[-1] == "G0 Z2.000"


def test_the_setup_file_states_the_level_to_which_cycles_return() -> None:
    assert parse_part_setup('retract = "G99"', "setup.toml").retract == "G99"
    assert parse_part_setup("", "setup.toml").retract is None
    with pytest.raises(FormatError, match="retract"):
        parse_part_setup('retract = "G97"', "setup.toml")


def test_repeated_holes_at_a_polar_place_are_at_one_place() -> None:
    blocks = flat("G61 G99 G0 X10 Y0 Z5\nG81 @-10 Z-1 R5 L2 F100")
    assert [block for block in blocks if "X" in block] == ["G61 G99 G0 X10.000 Y0.000 Z5.000", "G0 X-10.000"]


@pytest.mark.parametrize(
    ("program", "reason"),
    [
        ("G91 G10 L2 P1 X5", "G10 L2 with G91"),
        ("G64 P0.01 G99 G82 Z-1 R0 F100", "may belong to either"),
    ],
)
def test_what_controllers_interpret_differently_is_refused(program: str, reason: str) -> None:
    with pytest.raises(FormatError, match=reason):
        flat(program)


def test_a_tolerance_of_the_path_is_no_number_of_a_reference_point() -> None:
    blocks = flat("G64 P0.01 G30 X1\nG0 X0\nG4 P#5420", reference_points={"G30": (7.0, 0.0, 0.0)})
    assert blocks[-1] == "G4 P0"


def test_saved_states_are_restored_with_plain_codes() -> None:
    program = """G21 G90 F100
o1 sub
  M73
  G20 G91 F50 M8
  G1 X1
o1 endsub
o1 call
G1 X0
M2
"""
    assert flat(program)[1:] == ["G20 G91 F50 M8", "G1 X1.0000", "G21 G90", "F100", "M9", "G1 X0.000", "M2"]


def test_work_offsets_are_set() -> None:
    program = "G10 L2 P1 X10\nG0 X5 Y0 Z0\nG4 P#5420\nG10 L20 P1 X2\nG4 P#5420\nG4 P#5221"
    assert flat(program) == [
        "G10 L2 P1 X10",
        "G0 X5.000 Y0.000 Z0.000",
        "G4 P5",
        "G10 L20 P1 X2.000",
        "G4 P2",
        "G4 P13",
    ]
