"""Options of a calibration that chooses each position from what was measured before it."""

from __future__ import annotations

from dataclasses import dataclass

import click

from agent.cli.options import Duration
from drivers.errors import InputError


@dataclass(frozen=True)
class SequentialOptions:
    """Options of a calibration for the choice of its positions: whether it chooses them one after the other, and when
    its measurement ends.

    Raises InputError if an end is given for a calibration whose positions are known beforehand.
    """

    sequential: bool = False
    target_vce_um: float | None = None
    slot_minutes: float | None = None

    def __post_init__(self) -> None:
        ends = {"--target-vce": self.target_vce_um, "--slot": self.slot_minutes}
        given = [name for name, value in ends.items() if value is not None]
        if given and not self.sequential:
            raise InputError(
                f"{given[0]} needs --sequential: a calibration otherwise measures all positions of its set",
                hint=f"`volcal design {given[0]}` chooses a set beforehand",
            )


ALL_POSITIONS = SequentialOptions()
"""Options of a calibration that measures all positions of its set."""


def sequential_options(command: click.decorators.FC) -> click.decorators.FC:
    """Add to a command the options `--sequential`, `--target-vce` and `--slot`."""
    for option in (
        click.option(
            "--slot",
            "slot_minutes",
            type=Duration(),
            metavar="20min",
            help="With --sequential: longest time of the run, proof included [default: that of the position set].",
        ),
        click.option(
            "--target-vce",
            "target_vce_um",
            type=click.FloatRange(min=0.0, min_open=True),
            metavar="µm",
            help="With --sequential: end when the upper 95 % limit of the predicted VCE is below.",
        ),
        click.option("--sequential", is_flag=True, help="Choose each position from what was measured before it."),
    ):
        command = option(command)
    return command
