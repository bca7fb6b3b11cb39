"""Summary of the correction of a part program, for the person who runs the corrected program."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(slots=True)
class CorrectionSummary:
    """Counts of moves and points in a corrected program.

    - `moves` is the number of corrected moves.
    - `divided` is the number of corrected moves that were written as several lines.
    - `arcs` is the number of corrected arcs. They were written as straight moves.
    - `not_corrected` is the number of rapid moves that were left unchanged, because the position of an axis was not
      known yet.
    - `outside` is the number of points outside the volume of the compensation table, and `outside_mm` is the largest
      distance of such a point from the volume.
    - `held` is the number of corrected points that would have been outside the volume and were moved to its border.
      `held_mm` is the largest such displacement.
    - `extrapolated` is the number of points whose correction depends on a table node outside the measured region.
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
