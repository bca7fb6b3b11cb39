"""Command-line options with three numbers in mm."""

from __future__ import annotations

import click

MOST_MM = 1e6
"""Bound of a coordinate on a machine tool."""


def parse_triple(text: str, also: str = "") -> tuple[float, float, float]:
    """Return the three numbers of a text `X,Y,Z`.

    Raises BadParameter, which ends with the text `also`, if the text is not three numbers, or if one of them is out of
    proportion.
    """
    try:
        x, y, z = (float(part) for part in text.split(","))
    except ValueError:
        raise click.BadParameter(f"'{text}' is not X,Y,Z in mm, such as 100,200,-50.5{also}") from None
    if not all(abs(number) < MOST_MM for number in (x, y, z)):
        raise click.BadParameter(f"'{text}' is no place on a machine tool")
    return x, y, z


def point_in_mm(_: click.Context, __: click.Parameter, text: str | None) -> tuple[float, float, float] | None:
    """Return the three numbers of an option, or None if it was not given."""
    return None if text is None else parse_triple(text)
