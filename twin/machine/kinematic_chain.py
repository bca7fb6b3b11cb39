"""Kinematic chain of a machine with three linear axes, listed from the tool to the workpiece."""

from __future__ import annotations

from dataclasses import dataclass

from twin.errors import ModelError

AXES = ("X", "Y", "Z")
_HINT = "Write the chain from tool to workpiece with each axis once, such as tool-Y-Z-X-bed-workpiece"


@dataclass(frozen=True)
class Chain:
    """Kinematic chain of a machine.

    `tool_side` contains the axes between the tool and the bed, starting at the tool. `workpiece_side` contains the axes
    between the bed and the workpiece, starting at the bed.
    """

    tool_side: tuple[str, ...]
    workpiece_side: tuple[str, ...]

    def __post_init__(self) -> None:
        axes = self.tool_side + self.workpiece_side
        for axis in axes:
            if axis not in AXES:
                raise ModelError(f"'{axis}' is not a linear axis", hint=_HINT, chain=str(self))
            if axes.count(axis) > 1:
                raise ModelError(f"axis {axis} is listed twice", hint=_HINT, chain=str(self))
        for axis in AXES:
            if axis not in axes:
                raise ModelError(f"axis {axis} is missing", hint=_HINT, chain=str(self))

    @property
    def axes(self) -> tuple[str, ...]:
        """All three axes in the order from the tool to the workpiece."""
        return self.tool_side + self.workpiece_side

    def __str__(self) -> str:
        return "-".join(("tool", *self.tool_side, "bed", *self.workpiece_side, "workpiece"))


def parse_chain(text: str) -> Chain:
    """Parse a kinematic chain such as `tool-Y-Z-X-bed-workpiece` in upper or lower case. Raises ModelError if the text
    is not valid."""
    links = [link.strip().lower() for link in text.split("-")]
    for word, link, where in (("tool", links[0], "begin"), ("workpiece", links[-1], "end")):
        if link != word:
            raise ModelError(f"the chain must {where} with '{word}'", hint=_HINT, chain=text)
    if links.count("bed") != 1:
        raise ModelError("the chain must contain 'bed' exactly once", hint=_HINT, chain=text)
    bed = links.index("bed")
    tool_side = tuple(link.upper() for link in links[1:bed])
    workpiece_side = tuple(link.upper() for link in links[bed + 1 : -1])
    try:
        return Chain(tool_side, workpiece_side)
    except ModelError as error:
        error.where["chain"] = text
        raise
