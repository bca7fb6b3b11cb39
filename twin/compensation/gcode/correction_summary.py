"""Summary of the correction of a part program, for the person who runs the corrected program."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(slots=True)
class CorrectionSummary:
    """Counts of a corrected program.

    `moves`: corrected moves; `divided`: corrected moves that were written as several lines; `arcs`: corrected arcs,
    which were written as straight moves. `not_corrected`: rapid moves before all three axes had a known position.
    `outside`: points beyond the table's volume; `held`: points at which the correction was limited, because it would
    have left the volume. For both, the largest amount is stored too. `extrapolated`: points in cells with nodes outside
    the measured region.
    """

    lines: int = 0
    written_lines: int = 0
    moves: int = 0
    divided: int = 0
    arcs: int = 0
    points: int = 0
    not_corrected: int = 0
    outside: int = 0
    outside_mm: float = 0.0
    held: int = 0
    held_mm: float = 0.0
    extrapolated: int = 0
    largest_correction_mm: float = 0.0
