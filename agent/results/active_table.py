"""Newest known figures of the compensation table that is active, as the runs of a machine leave it.

A run that restores a stored table measures nothing. The figures of the table that it has replaced must not be shown as
those of the restored one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from agent.results.run_verdict import RESTORED, RunVerdict


class RunWithTable(Protocol):
    """Columns of a run that say which table it leaves active, and how large the errors with it are;
    `agent.history.schema.StoredRun` says what they mean."""

    @property
    def accepted(self) -> bool | None: ...

    @property
    def acting_um(self) -> float | None: ...

    @property
    def held_out_before_um(self) -> float | None: ...

    @property
    def held_out_after_um(self) -> float | None: ...

    @property
    def table_bank(self) -> int | None: ...

    @property
    def table_crc32(self) -> str | None: ...

    @property
    def verdict(self) -> RunVerdict: ...


@dataclass(frozen=True)
class ActiveTableFigures:
    """Newest known volumetric error with the active table (VCE), and rms of the held-out balls with it, in µm. Each is
    None if no run has stated it for this table."""

    vce_um: float | None = None
    held_out_um: float | None = None


def active_table_figures(runs: Sequence[RunWithTable]) -> ActiveTableFigures:
    """Return the figures of the table that the last of the `runs` of a machine leaves active; the oldest run is first.

    The table that is active at the start of the first run counts as one of its own. A table that is restored has the
    figures again that were stated for it.
    """
    active: str | None = None
    known: dict[str | None, ActiveTableFigures] = {}
    for run in runs:
        if run.accepted or _replaces(run):
            active = run.table_crc32 or ("written" if run.accepted else "no compensation")
        held_out_um = run.held_out_after_um if run.accepted else run.held_out_before_um
        former = known.get(active, ActiveTableFigures())
        known[active] = ActiveTableFigures(
            former.vce_um if run.acting_um is None else run.acting_um,
            former.held_out_um if held_out_um is None else held_out_um,
        )
    return known.get(active, ActiveTableFigures())


def _replaces(run: RunWithTable) -> bool:
    """Return True if the run has restored a table that was not active already. Such a run has written a table, or has
    activated bank 0, which stands for no compensation."""
    return run.verdict is RESTORED and (run.table_crc32 is not None or not run.table_bank)
