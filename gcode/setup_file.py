"""TOML file with the information that is needed to interpret a part program, but is not contained in the program
itself.

The file contains work offsets, reference points, tools and the initial state of the controller.
"""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from gcode.setup import NO_OFFSET, PartSetup, Triple
from twin.errors import FormatError
from twin.formats.toml_reading import StrictModel, read_toml

LONGEST_TOOL_NUMBER = 9
System = Literal["G54", "G55", "G56", "G57", "G58", "G59", "G59.1", "G59.2", "G59.3"]


class PartSetupFile(StrictModel):
    """Contents of the setup file of a part program. Positions are axis positions (machine coordinates), and all lengths
    are in mm. Tools are listed by H number.
    """

    work_offsets_mm: dict[System, Triple] = Field(default_factory=dict)
    reference_points_mm: dict[Literal["G28", "G30"], Triple] = Field(default_factory=dict)
    tools_mm: dict[str, Triple] = Field(default_factory=dict)
    start_mm: Triple | None = None
    g92_mm: Triple = NO_OFFSET
    system: System = "G54"
    units: Literal["G20", "G21"] = "G21"
    distance: Literal["G90", "G91"] = "G90"
    arc_centres: Literal["G90.1", "G91.1"] = "G91.1"
    plane: Literal["G17", "G18", "G19"] = "G17"
    feed: Literal["G93", "G94", "G95"] = "G94"
    retract: Literal["G98", "G99"] | None = None
    tool_change: Literal["moves", "stays"] = "moves"
    parameters: dict[str, float] = Field(default_factory=dict)


def parse_part_setup(text: str, source: str) -> PartSetup:
    """Parse the TOML text of a setup file and return the setup of the part program.

    Raises FormatError if the text cannot be used. The error names the file and the key.
    """
    read = read_toml(text, source, PartSetupFile)
    return PartSetup(
        work_offsets={str(name): offset for name, offset in read.work_offsets_mm.items()},
        reference_points={str(name): point for name, point in read.reference_points_mm.items()},
        tools={_tool_number(name, source): offset for name, offset in read.tools_mm.items()},
        start=read.start_mm,
        g92=read.g92_mm,
        system=read.system,
        units=read.units,
        distance=read.distance,
        arc_centres=read.arc_centres,
        plane=read.plane,
        feed=read.feed,
        retract=read.retract,
        tool_change_moves=read.tool_change == "moves",
        parameters=read.parameters,
    )


def _tool_number(name: str, source: str) -> int:
    if not name.isdecimal() or len(name) > LONGEST_TOOL_NUMBER:
        raise FormatError(f"'{name}' is not a tool number", hint="Write 1 = [0, 0, 120.5]", file=source, key="tools_mm")
    return int(name)
