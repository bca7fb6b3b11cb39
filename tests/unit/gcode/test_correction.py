"""Correction of part programs: the exact text written, the lines left unchanged, and the refusals with their
reasons.
"""

from __future__ import annotations

import itertools
import tracemalloc
from typing import Any

import numpy as np
import pytest

from gcode import writer
from gcode.correction import correct_program
from gcode.correction_summary import CorrectionSummary
from gcode.setup import CorrectionOptions, PartSetup
from twin.compensation.table import CompensationTable
from twin.errors import DataError, FormatError
from twin.machine.anchor import Anchor

SETUP = PartSetup(
    work_offsets={"G54": (100.0, 100.0, 100.0), "G55": (0.0, 0.0, 0.0)},
    reference_points={"G28": (0.0, 0.0, 400.0)},
    tools={1: (0.0, 0.0, 50.0)},
)
START = "G0 X0 Y0 Z0\n"


def table(extrapolated: np.ndarray | None = None) -> CompensationTable:
    """Return a table that adds 10 µm to X, -20 µm to Y, and to Z 100 µm per metre of X.

    It is linear, so that no line need be divided.
    """
    x, y, z = np.linspace(0.0, 1000.0, 11), np.linspace(0.0, 500.0, 6), np.linspace(0.0, 400.0, 5)
    corrections = np.zeros((11, 6, 5, 3))
    corrections[..., 0], corrections[..., 1] = 0.010, -0.020
    corrections[..., 2] = 1e-4 * x[:, None, None]
    marks = np.zeros((11, 6, 5), dtype=bool) if extrapolated is None else extrapolated
    return CompensationTable(x, y, z, corrections, np.zeros(3), Anchor(np.zeros(3)), marks)


def run(text: str, setup: PartSetup = SETUP, **options: Any) -> tuple[list[str], CorrectionSummary]:
    parts: list[str] = []
    chosen = CorrectionOptions(**{"max_chord_error_mm": 0.002, **options})
    counts = correct_program(text.splitlines(True), table(), setup, chosen, parts.append)
    return "".join(parts).splitlines(), counts


def written(text: str, setup: PartSetup = SETUP, **options: Any) -> list[str]:
    """Return the lines after the rapid move to the start, which is put before `text`."""
    return run(START + text, setup, **options)[0][1:]


class TestWords:
    def test_the_correction_is_added_to_the_position_of_the_axes(self) -> None:
        assert run(START)[0] == ["G0 X0.0100 Y-0.0200 Z0.0100"]
        assert run("G55 G0 X500 Y10 Z20\n")[0] == ["G55 G0 X500.0100 Y9.9800 Z20.0500"]

    def test_other_axes_are_written_where_their_correction_changes(self) -> None:
        assert written("G1 X100 F500\nY50\n") == ["G1 X100.0100 Z0.0200 F500", "Y49.9800"]

    def test_incremental_words_add_up_to_the_absolute_ones(self) -> None:
        lines = written("G91 G1 X0.33333 F100\n" + "X0.33333\n" * 1999)
        assert sum(float(line.split("X")[1].split()[0]) for line in lines) == pytest.approx(666.66, abs=6e-5)

    def test_tool_length_counts_where_the_table_is_looked_up(self) -> None:
        assert written("G43 H1 Z-50\nG49 Z0\n") == ["G43 Z-49.9900 H1", "G49 Z0.0100"]
        assert written("G43.1 Z50\nG0 Z-50\n") == ["G43.1 Z50", "G0 Z-49.9900"]

    def test_inches_have_one_decimal_more(self) -> None:
        assert written("G20 G1 X10 F20\n") == ["G20 G1 X10.00039 Y-0.00079 Z0.00139 F20"]

    def test_machine_coordinates_are_corrected_as_such(self) -> None:
        assert written("G53 G0 X500 Z300\nX0\n") == ["G53 G0 X500.0100 Z300.0500", "X0.0100 Z200.0100"]

    def test_a_reference_point_is_reached_through_a_corrected_point(self) -> None:
        assert written("G91 G28 Z20\nG90 G0 X100\n") == ["G91 G28 Z20.0000", "G90 G0 X100.0100"]
        assert written("G28 X400 Y0 Z0\n") == ["G28 X400.0100 Y-0.0200 Z0.0500"]

    def test_g92_is_told_the_corrected_position(self) -> None:
        lines = written("G92 X0 Y0\nG1 X10 F100\nG92.2\nG0 X0\nG92.3\nX20\nG92.1\nX0\n")
        assert lines[0] == "G92 X0.0100 Y-0.0200"
        assert lines[1] == "G1 X10.0100 Z0.0110 F100"
        assert lines[4:] == ["G92.3", "G0 X20.0100 Z0.0120", "G92.1", "G0 X0.0100 Z0.0100"]

    def test_decimals(self) -> None:
        assert run(START, decimals=6, max_chord_error_mm=1e-3)[0] == ["G0 X0.010000 Y-0.020000 Z0.010000"]
        with pytest.raises(DataError, match="more decimals"):
            run(START, decimals=2, max_chord_error_mm=0.002)

    def test_arcs_become_lines_and_later_blocks_say_so(self) -> None:
        lines = written("G2 X20 Y20 J20 I0 F300 P1\nG1 X30\nX40\n")
        assert lines[0].startswith("G1 X")
        assert lines[0].endswith(" F300")
        assert all(line.startswith("X") and "I" not in line for line in lines[1:-2])
        assert lines[-2:] == ["G1 X30.0100 Z0.0130", "X40.0100 Z0.0140"]


class TestKept:
    @pytest.mark.parametrize(
        "line",
        [
            "",
            "%",
            "(a comment, with X1 and #2)",
            "; G41 in a comment",
            "M3 S8000",
            "T4",
            "G4 P0.5",
            "G4 X1.5",
            "G64 P0.01",
            "/ M8",
            "/N5 S100",
            "G1 F100",
            "N100 G17 G40 G49 G80",
            "D1",
            "g61",
        ],
    )
    def test_what_does_not_move_stays_as_it_is(self, line: str) -> None:
        assert written(f"{line}\n") == [line]

    def test_numbers_comments_and_other_words_stay_with_their_move(self) -> None:
        assert written("n7 g1 x 10. (cut) f100 s200 ; now\n") == ["N7 G1 X10.0100 Z0.0110 F100 S200 (cut) ; now"]

    def test_a_stop_comes_after_the_last_piece(self) -> None:
        lines = written("N5 G3 I10 F100 M8 M0\n")
        assert lines[0].startswith("N5 G1 X")
        assert lines[0].endswith("F100 M8")
        assert lines[-1].endswith(" M0")
        assert all("M" not in line for line in lines[1:-1])

    def test_a_stop_is_no_part_of_a_comment(self) -> None:
        assert written("G1 X10 F9 M0 ; wait\n") == ["G1 X10.0100 Z0.0110 F9 M0 ; wait"]
        lines = written("G3 I10 F9 M0 ; wait\n")
        assert (lines[0].endswith("F9 ; wait"), lines[-1].endswith(" M0")) == (True, True)

    def test_line_ends(self) -> None:
        parts: list[str] = []
        correct_program(["%\r\n", START.replace("\n", "\r\n")], table(), SETUP, CorrectionOptions(0.002), parts.append)
        assert "".join(parts) == "%\r\nG0 X0.0100 Y-0.0200 Z0.0100\r\n"

    def test_the_mark_stands_after_percent_and_program_number(self) -> None:
        parts: list[str] = []
        text = "%\nO1234 (part)\n\nG21\n"
        correct_program(text.splitlines(True), table(), SETUP, CorrectionOptions(0.002), parts.append, name="table x")
        assert "".join(parts) == "%\nO1234 (part)\n\n(volcal gcode correct: table x)\nG21\n"


class TestFromNowhere:
    def test_a_rapid_move_is_kept_until_all_axes_are_known(self) -> None:
        lines, counts = run("G0 X10 Y20\nG43 H1 Z5\nG1 X20 F100\n")
        assert lines == ["G0 X10 Y20", "G43 G0 X10.0100 Y19.9800 Z5.0110 H1", "G1 X20.0100 Z5.0120 F100"]
        assert counts.not_corrected == 1

    def test_nobody_knows_where_a_tool_change_ends(self) -> None:
        text = "T1 M6\nX10 Y0\nZ0\n"
        assert written(text) == ["T1 M6", "X10 Y0", "G0 X10.0100 Y-0.0200 Z0.0110"]
        stays = PartSetup(SETUP.work_offsets, tool_change_moves=False)
        assert written(text, stays) == ["T1 M6", "X10.0100 Y-0.0200 Z0.0110", "Z0.0110"]

    def test_a_start_that_is_known(self) -> None:
        setup = PartSetup(SETUP.work_offsets, start=(100.0, 100.0, 100.0))
        assert run("G1 X10 F100\n", setup)[0] == ["G1 X10.0100 Y-0.0200 Z0.0110 F100"]


class TestVolume:
    def test_outside_is_refused_with_axis_and_reach(self) -> None:
        with pytest.raises(FormatError, match=r"X is at machine position 1100.*0 to 1000 mm.*line 2"):
            run(f"{START}G0 X1000\n")

    def test_or_corrected_as_at_the_border(self) -> None:
        lines, counts = run(f"{START}X1000\n", outside="clamp")
        assert lines[1] == "X1000.0100 Z0.1000"
        assert counts.outside == 1
        assert counts.outside_mm == pytest.approx(100.0)

    def test_the_correction_leads_no_axis_out_of_the_volume(self) -> None:
        lines, counts = run("G55 G0 X1000 Y0 Z400\n")
        assert lines == ["G55 G0 X1000.0000 Y0.0000 Z400.0000"]
        assert counts.held == 1
        assert counts.held_mm == pytest.approx(0.1)

    def test_points_where_nothing_was_measured_are_counted(self) -> None:
        mask = np.zeros((11, 6, 5), dtype=bool)
        mask[10] = True
        field = table(extrapolated=mask)
        lines = [START, "G0 X799\n", "G0 X801\n"]
        counts = correct_program(lines, field, SETUP, CorrectionOptions(0.002), lambda _: None)
        assert counts.extrapolated == 1


@pytest.mark.parametrize(
    ("block", "reason"),
    [
        ("G41 D1 X10", "G41 cannot be corrected, cutter compensation"),
        ("G84 X1 Z-1 R1", "canned cycle"),
        ("G68 X0 Y0 R30", "rotated"),
        ("G52 X10", "coordinates that only the controller knows"),
        ("G10 L1 P1 X0", "only work offsets"),
        ("G38.2 Z-10", "probing"),
        ("G5 X1 I1 J1 P1 Q1", "spline"),
        ("G65 P9010", "macros"),
        ("M98 P1000", "the subprogram 1000 is not in this program"),
        ("M72", "none was saved by M70"),
        ("T1\nM61\nG43 Z1", "no tool was loaded"),
        ("G123", "G123 is not supported.*--keep G123"),
        ("G1.25 X1", "one decimal"),
        ("G1 X#1", "the value of #1 is not known.*--parameter 1="),
        ("G1 X[1+]", "is expected before '.'"),
        ("#5221=5", "belongs to the controller"),
        ("O100 CALL", "the subprogram 100 is not in this program"),
        ("O100", "runs into the number of a subprogram"),
        ("G1 A10", "axis A"),
        ("$H", r"\$"),
        ("G1 X1 X2", "X occurs twice"),
        ("G0 G1 X1", "two G codes for the motion"),
        ("G90 G91", "two G codes for the distance"),
        ("G1 X", "cannot be read"),
        ("G1 (open X1", "not closed"),
        ("/G1 X10", "block delete"),
        ("G1 X1 / Y2", "slash"),
        ("G80\nX1", "none of G0 to G3"),
        ("G2 X10", "centre|radius"),
        ("G2 X10 R2", "does not reach"),
        ("G2 R5", "cannot end where it begins"),
        ("G2 X10 I5 J0 R5", "not both"),
        ("G2 X10 I7 J0", "off its circle"),
        ("G2 X10 I5 K1", "not in the plane"),
        ("G2 X10 I5 P1.5", "turns"),
        ("G90.1 G2 X10 I5", "needs both I and J"),
        ("G1 X10 I5", "belong to arcs"),
        ("G91 G53 G0 X1", "G53"),
        ("G53 G2 X10 I5", "G53"),
        ("G93 G1 X10", "its own F"),
        ("G1 G92 X1", "two G codes use"),
        ("G1 G28 X1", "two G codes use"),
        ("G4 P1 X1", "dwell"),
        ("G92", "axis word"),
        ("G92.3", "not set in this program"),
        ("G43 H9", "tool 9 is not known.*--tool 9="),
        ("G43 Z1", "no tool was loaded"),
        ("G56 G0 X0", "G56 is not known.*--work-offset"),
        ("T1 M6 X1", "a tool change and a move"),
        ("M30\nG0 X1", "after the end of the program"),
        ("G3 I10 F1 E2.5", "has to be divided, and the effect of E"),
        ("G28 X1000", "X is at machine position 1100"),
        ("G1 X1\x07", "control character 7"),
        ("G3 I10 F1 M5", "has to be divided, and M5 takes effect before"),
        ("(volcal gcode correct: table 1)", "already corrected"),
        (f"G0 X{'9' * 200}", "the number after X has too many digits"),
        (f"G0 X{'9' * 200}.5 Y1", "the number after X has too many digits"),
    ],
)
def test_what_cannot_be_corrected_is_refused_with_line_and_reason(block: str, reason: str) -> None:
    with pytest.raises(FormatError, match=f"(?s){reason}") as error:
        run(START + block + "\n")
    assert error.value.where["line"] == str(1 + len(block.splitlines()))


def test_an_unknown_g_code_may_be_declared_harmless() -> None:
    assert written("G5.1 Q1\nG5.1 G1 X10 F9\n", kept_g=frozenset({51})) == ["G5.1 Q1", "G5.1 G1 X10.0100 Z0.0110 F9"]


def test_rapid_moves_are_divided_only_if_asked_for() -> None:
    rng = np.random.default_rng(1)
    rough = CompensationTable(
        *table().nodes, 0.03 * rng.uniform(-1, 1, (11, 6, 5, 3)), np.zeros(3), Anchor(np.zeros(3)), table().extrapolated
    )
    for divide, least in ((False, 2), (True, 20)):
        lines: list[str] = []
        options = CorrectionOptions(0.002, divide_rapids=divide)
        counts = correct_program([START, "X800 Y300\n"], rough, SETUP, options, lines.append)
        assert (counts.written_lines >= least) and (counts.written_lines > 2) == divide


def test_a_chord_error_that_asks_for_too_many_pieces_is_refused() -> None:
    with pytest.raises(FormatError, match="pieces"):
        run(START + "G2 I200 P10000\n", max_chord_error_mm=1e-6, decimals=8)


def test_a_corrected_program_that_would_become_too_long_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(writer, "_MOST_POINTS", 10_000)
    loop = "o1 while [1]\nG2 I50\no1 endwhile\n"
    with pytest.raises(FormatError, match=r"more than 10000 points.*G2 I50") as error:
        run(START + loop)
    assert error.value.where == {"line": "3"}


def test_memory_does_not_grow_with_the_program() -> None:
    """Compare Python's peak memory for some ten batches with that for some fifty."""

    def peak(lines: int) -> int:
        tracemalloc.start()
        text = (f"G1 X{number % 700}.5 Y{number % 300} F500\n" for number in range(lines))
        correct_program(itertools.chain([START], text), table(), SETUP, CorrectionOptions(0.002), lambda _: None)
        found = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return found

    assert peak(40_000) < 1.1 * peak(10_000)
