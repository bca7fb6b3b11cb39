"""Options that the trials of instruments on drawn machines have in common."""

from __future__ import annotations

import argparse
from dataclasses import dataclass

from campaigns.foreign.trials import GENERATORS

WRONG_SCALE = 8e-6
"""Relative error of a laser whose air sensor is wrong by about eight kelvin."""


@dataclass(frozen=True)
class TrialOptions:
    """Machines of each generator, the names of the generators, and whether the laser is wrong and does not say so."""

    machines: int
    generators: tuple[str, ...]
    worse_laser: bool

    @property
    def wrong_scale(self) -> float:
        """Relative error of the laser."""
        return WRONG_SCALE if self.worse_laser else 0.0


def read_options(program: str, description: str, machines: int) -> TrialOptions:
    """Read the command line of the module `program`. `machines` is the default of the option of this name."""
    parser = argparse.ArgumentParser(prog=f"python -m {program}", description=description)
    parser.add_argument("--machines", type=int, default=machines, help="machines of each generator")
    parser.add_argument("--generator", choices=tuple(GENERATORS), action="append", help="generator; all if not given")
    parser.add_argument("--worse-laser", action="store_true", help="use a laser that is wrong and does not say so")
    given = parser.parse_args()
    return TrialOptions(given.machines, tuple(given.generator or GENERATORS), given.worse_laser)
