"""Saved modal state (M70 to M73 of LinuxCNC), which is restored with plain codes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from gcode.modal import ModalState
from gcode.setup import Triple
from gcode.source import SourceLine

SAVE, INVALIDATE, RESTORE, SAVE_FOR_RETURN = 700, 710, 720, 730
STATE_CODES = (SAVE, INVALIDATE, RESTORE, SAVE_FOR_RETURN)
# State of LinuxCNC at the start of a program, for groups that were not mentioned before M70.
_AT_START = {"spindle": "M5", "coolant": "M9", "overrides": "M48"}


@dataclass(frozen=True)
class SavedState:
    """Modal state at the time of M70. `codes` contains the codes of coordinates and units, `words` those of the other
    groups. With M73, the state is restored when the subroutine returns.
    """

    codes: tuple[str, ...]
    words: dict[str, str]
    tool_offset: Triple
    at_return: bool

    @classmethod
    def of(cls, modal: ModalState, *, at_return: bool) -> SavedState:
        return cls(_codes(modal), dict(modal.words), modal.tool_offset, at_return)

    def restored(self, modal: ModalState, source: SourceLine) -> Iterator[str]:
        """Yield the blocks that restore the state. Raises FormatError if the program does not contain all of it."""
        if self.tool_offset != modal.tool_offset:
            source.refuse("the tool length has changed since the state was saved (M70, M73)")
        changed = [code for code, now in zip(self.codes, _codes(modal), strict=True) if code != now]
        if changed:
            yield " ".join(changed)
        for group in sorted(modal.words):
            before = self.words.get(group, _AT_START.get(group, ""))
            if before == modal.words[group]:
                continue
            if not before and group not in ("F", "S"):
                message = f"the {group} that was in effect when the state was saved is not in the program"
                source.refuse(message, "State it at the beginning of the program")
            # M7 and M8 add up, so the present coolant is switched off first.
            if group == "coolant" and before != "M9":
                yield "M9"
            if before:
                yield before


def _codes(modal: ModalState) -> tuple[str, ...]:
    return (
        "G21" if modal.unit_mm == 1.0 else "G20",
        f"G{modal.plane // 10}",
        "G90" if modal.absolute else "G91",
        "G90.1" if modal.absolute_centres else "G91.1",
        modal.system,
        f"G{modal.feed_mode // 10}",
    )
