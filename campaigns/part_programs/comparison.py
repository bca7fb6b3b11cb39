"""Comparison of a corrected program with the original one, block by block. Both are executed by `rs274`, and the path
of the corrected one is compared with the path that the table asks for.
"""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.interpolate import RegularGridInterpolator

from campaigns.part_programs.random_programs import REFERENCES_MM, TOOLS_MM, ProgramAuthor
from campaigns.part_programs.rs274 import Executed, ExecutedMove, ProgramRefused, execute, farthest
from gcode.correction import correct_program
from gcode.setup import SYSTEMS as ALL_SYSTEMS
from gcode.setup import CorrectionOptions, PartSetup
from twin.arrays import Array
from twin.compensation.table import CompensationTable, regular_nodes
from twin.errors import FormatError
from twin.machine.anchor import Anchor

CHORD_MM = 0.004
PRINTED_MM = 0.5e-4
"""Half a step of the positions and offsets that rs274 prints in mm; in inches it is 25.4 times as large."""
PRINTED_SUMMANDS = 4
"""Printed numbers of which an axis position is the sum: word, work offset, G92 offset and tool length."""
SHORT_MM = 0.0173
"""Moves shorter than this may be left out of one of the two programs; no random length equals it."""
DURATION_SHARE = 0.05
MOST_REMOVED = 40

_ZERO = (0.0, 0.0, 0.0)
SETUP = PartSetup(
    work_offsets=dict.fromkeys(ALL_SYSTEMS, _ZERO),
    reference_points=REFERENCES_MM,
    tools=TOOLS_MM,
    start=_ZERO,
    tool_change_moves=False,
)
_NUMBER = re.compile(r"^\s*N(\d+)", re.IGNORECASE)


def wavy_table() -> CompensationTable:
    """Return a table with corrections of up to 0.3 mm, far more than any rounding, in 8 m × 8 m × 8 m."""
    nodes = regular_nodes(((-4000.0, 4000.0),) * 3, (400.0,) * 3)
    x, y, z = np.meshgrid(*nodes, indexing="ij")
    waves = (np.sin(x / 900.0 + y / 700.0 + 1.0), np.cos(y / 500.0 - z / 800.0), np.sin(z / 600.0 + x / 1500.0 + 2.0))
    corrections = 0.3 * np.stack(waves, axis=-1)
    return CompensationTable(*nodes, corrections, np.zeros(3), Anchor(np.zeros(3)), np.zeros(x.shape, dtype=bool))


TABLE = wavy_table()
_FIELD = RegularGridInterpolator(TABLE.nodes, TABLE.corrections)


@dataclass
class ProgramTrial:
    """Result of one program.

    `deviation_mm` is the largest deviation from the path that the table asks for beyond the rounding of what `rs274`
    prints; the chord error is part of it. `not_supported` counts the reasons for which volcal refused blocks, and
    `invalid` is the number of blocks that `rs274` refused; both are left out of the program. `failures` says what is
    wrong.
    """

    seed: int
    blocks: int = 0
    moves: int = 0
    deviation_mm: float = 0.0
    not_supported: Counter[str] = field(default_factory=Counter)
    invalid: int = 0
    failures: list[str] = field(default_factory=list)
    program: str = ""


def try_program(seed: int, folder: Path) -> ProgramTrial:
    """Correct the random program with this seed, and compare it with the original."""
    trial = ProgramTrial(seed)
    lines = ProgramAuthor(seed).lines()
    source, out = folder / "source.ngc", folder / "corrected.ngc"
    for _ in range(MOST_REMOVED):
        trial.program = "".join(lines)
        corrected: list[str] = []
        try:
            correct_program(lines, TABLE, SETUP, CorrectionOptions(CHORD_MM), corrected.append)
        except FormatError as error:
            trial.not_supported[_reason(error)] += 1
            del lines[int(error.where["line"]) - 1]
            continue
        source.write_text(trial.program)
        try:
            original = _executed(source, folder)
        except ProgramRefused as error:
            trial.invalid += 1
            del lines[_index_of(lines, error)]
            continue
        out.write_text(_all_numbered("".join(corrected)))
        trial.blocks = len(lines)
        try:
            after = _executed(out, folder)
        except ProgramRefused as error:
            trial.failures.append(f"rs274 refuses the corrected program: {error}")
            return trial
        compare(original, after, trial)
        return trial
    trial.failures.append(f"no valid program after {MOST_REMOVED} blocks were removed")
    return trial


def compare(original: Executed, after: Executed, trial: ProgramTrial) -> None:
    """Compare the moves of each block, and enter what is found in the trial."""
    largest = PRINTED_MM * (25.4 if original.inch or after.inch else 1.0)
    # Both paths are rounded, in the three axes.
    rounding = 2.0 * PRINTED_SUMMANDS * largest * np.sqrt(3.0)
    lines = {_number_of(line): line.strip() for line in trial.program.splitlines()}
    uncorrected = True
    for number in sorted({move.number for move in (*original.moves, *after.moves)}):
        text = lines.get(number, "")
        at_reference = re.search(r"[gG](?:28|30)(?![\d.])", text) is not None
        wanted = _grouped([move for move in original.moves if move.number == number])
        found = _grouped([move for move in after.moves if move.number == number])
        trial.moves += len(wanted)
        problem, deviation = _compare_block(wanted, found, uncorrected=uncorrected, at_reference=at_reference)
        beyond = deviation - rounding
        if not at_reference:
            trial.deviation_mm = max(trial.deviation_mm, beyond)
        if not problem and beyond > CHORD_MM:
            problem = f"{1e3 * deviation:.1f} µm from the path that the table asks for"
        if problem:
            trial.failures.append(f"{problem}: {text}")
            return
        if wanted or found:
            uncorrected = at_reference


@dataclass
class _Group:
    """Successive moves of one kind: the ends (n, 3) of rapid moves, or the path (n, 3) of moves with feed."""

    feed: bool
    points: list[Array]
    state: tuple[float | str, ...]
    minutes: float = 0.0

    def path(self) -> Array:
        return np.concatenate(self.points)


def _grouped(moves: list[ExecutedMove]) -> list[_Group]:
    groups: list[_Group] = []
    for move in moves:
        length = float(np.linalg.norm(np.diff(move.points, axis=0), axis=1).sum())
        if length < SHORT_MM and not (move.feed and groups and groups[-1].feed):
            continue
        if not groups or groups[-1].feed != move.feed:
            groups.append(_Group(move.feed, [], move.state))
        groups[-1].points.append(move.points if move.feed else move.points[-1:])
        feed = float(move.state[0])
        groups[-1].minutes += length / feed if feed > 0.0 else 0.0
    return groups


def _compare_block(
    wanted: list[_Group], found: list[_Group], *, uncorrected: bool, at_reference: bool
) -> tuple[str, float]:
    """Return what is wrong with the moves of a block, or an empty text, and their largest deviation in mm.

    If the axes were not at a corrected position before the block, only ends are compared.
    """
    if [group.feed for group in wanted] != [group.feed for group in found]:
        if uncorrected or at_reference:
            return "", 0.0
        kinds = ["/".join("feed" if group.feed else "rapid" for group in groups) for groups in (wanted, found)]
        return f"moves are {kinds[1] or 'none'} and not {kinds[0] or 'none'}", 0.0
    deviation = 0.0
    for index, (meant, made) in enumerate(zip(wanted, found, strict=True)):
        target = meant.path() + _FIELD(meant.path())
        if not meant.feed:
            if at_reference:
                continue
            if uncorrected and index == 0:
                deviation = max(deviation, float(np.linalg.norm(target[-1] - made.path()[-1])))
                continue
            if len(target) != len(made.path()):
                return f"{len(made.points)} rapid moves and not {len(target)}", deviation
            deviation = max(deviation, float(np.linalg.norm(target - made.path(), axis=1).max()))
            continue
        deviation = max(deviation, float(np.linalg.norm(target[-1] - made.path()[-1])))
        if not (uncorrected and index == 0):
            deviation = max(deviation, farthest(target, made.points), farthest(made.path(), [target]))
            if meant.state[1:] != made.state[1:]:
                return f"the state is {made.state[1:]} and not {meant.state[1:]}", deviation
            if abs(made.minutes - meant.minutes) > DURATION_SHARE * meant.minutes + 1e-4:
                return f"the moves take {made.minutes:.5g} min and not {meant.minutes:.5g}", deviation
    return "", deviation


def _executed(program: Path, folder: Path) -> Executed:
    return execute(program, folder, tools_mm=TOOLS_MM, references_mm=REFERENCES_MM)


def _reason(error: FormatError) -> str:
    """Return the reason of a refusal without the text of the line and without numbers."""
    return re.sub(r"-?\d+\.\d+", "…", error.message.split(": N", maxsplit=1)[0])


def _number_of(line: str) -> int:
    found = _NUMBER.match(line)
    return int(found[1]) if found else -1


def _all_numbered(text: str) -> str:
    """Return a corrected program in which each line has an N word: the one of the block from which it comes."""
    lines, number = [], -1
    for line in text.splitlines():
        own = _number_of(line)
        number = own if own >= 0 else number
        lines.append(line if own >= 0 else f"N{number} {line}")
    return "".join(f"{line}\n" for line in lines)


def _index_of(lines: list[str], refused: ProgramRefused) -> int:
    """Return the index of the line that rs274 has refused."""
    number = _number_of(refused.line)
    return next(index for index, line in enumerate(lines) if _number_of(line) == number)
