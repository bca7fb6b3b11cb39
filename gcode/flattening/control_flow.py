"""O-words of a program: subroutines, loops and conditions, and the jumps between their lines."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from gcode.source import SourceLine

_O_WORD = re.compile(r"/?(?:n[\d.]+)?o(?:<([^<>]*)>|(\d+)|(?=\[))")
# (?![a-z]) makes the keyword a whole word: a longer word is refused, not read as a keyword with a rest.
_KEYWORD = re.compile(
    r"(sub|endsub|call|do|while|endwhile|if|elseif|else|endif|break|continue|return|repeat|endrepeat)?(?![a-z])(.*)"
)
_CLOSES = {"endsub": "sub", "endwhile": "while", "endrepeat": "repeat"}
_LOOPS = ("while", "do", "repeat")
PROGRAM_NUMBER = ""
"""Keyword of an O-word with a number alone, which begins a program or a subprogram."""

END_OF_DO = "end of do"
"""Keyword of the `while` that closes a `do`."""


class OWord(NamedTuple):
    """O-word of one line. `rest` is the code after the keyword. The label of a call may be an expression; `label` is
    then empty, and `rest` begins with the expression.
    """

    label: str
    keyword: str
    rest: str
    deletable: bool


def read_control(source: SourceLine) -> OWord | None:
    """Return the O-word of a line, or None if it has none."""
    code, _ = source.split_comments()
    found = _O_WORD.match(code)
    if found is None:
        return None
    rest, label = code[found.end() :], found[1] or (found[2].lstrip("0") or "0" if found[2] else "")
    if not label:
        return OWord("", "call", rest, code.startswith("/"))
    keyword = _KEYWORD.fullmatch(rest)
    if keyword is None or (keyword[1] is None and keyword[2]):
        source.refuse(f"'{rest[:20]}' is not the keyword of an O-word")
    return OWord(label, keyword[1] or PROGRAM_NUMBER, keyword[2], code.startswith("/"))


@dataclass(slots=True)
class ControlFlow:
    """Control flow of a list of lines: their O-words, all of which are known in advance.

    - `controls` maps the index of a line to its O-word.
    - `partners` maps the index of a line to the index of the line that belongs to it: the end of a loop or subroutine
      to its beginning and vice versa, `if`, `elseif` and `else` to the next branch or `endif`, and `break` and
      `continue` to the beginning of the loop.
    - `ends` maps the index of each branch of an `if` to its `endif`.
    - `subroutines` maps labels to the lines of `sub`, and `programs` maps numbers to the lines of subprograms.
    """

    lines: Sequence[SourceLine]
    controls: dict[int, OWord] = field(default_factory=dict)
    partners: dict[int, int] = field(default_factory=dict)
    ends: dict[int, int] = field(default_factory=dict)
    subroutines: dict[str, int] = field(default_factory=dict)
    programs: dict[str, int] = field(default_factory=dict)

    @classmethod
    def of(cls, lines: Sequence[SourceLine]) -> ControlFlow:
        """Find the O-words in `lines`, and pair the beginning of each block with its end. Raises FormatError if blocks
        overlap instead of being nested."""
        section, stack = cls(lines), _Nesting([])
        for index, source in enumerate(lines):
            if "o" in source.text or "O" in source.text:
                control = read_control(source)
                if control is not None:
                    section._add(index, control, source, stack)
        if stack.open:
            last = stack.open[-1]
            lines[last.begin].refuse(f"o<{last.label}> {last.keyword} is not closed")
        return section

    def loop_lines(self, begin: int) -> range:
        """Return the indices of the lines of the loop that begins at index `begin`."""
        return range(begin, self.partners[begin] + 1)

    def _add(self, index: int, control: OWord, source: SourceLine, stack: _Nesting) -> None:
        keyword, label = control.keyword, control.label
        if control.deletable:
            source.refuse("block delete makes an O-word optional", "Remove the slash or the line")
        # `while` opens a loop, except as the end of the innermost open `do` of the same label.
        if keyword == "while" and stack.innermost("do", label):
            control = control._replace(keyword=END_OF_DO)
            self._pair(stack.close("do", label, source).begin, index)
        elif keyword in ("elseif", "else", "endif"):
            self._branch(index, keyword == "endif", stack.close("if", label, source), stack)
        elif keyword in _CLOSES:
            self._pair(stack.close(_CLOSES[keyword], label, source).begin, index)
        elif keyword in ("break", "continue"):
            self.partners[index] = stack.loop(label, source)
        elif keyword in (*_LOOPS, "if", "sub"):
            stack.open.append(_Open(keyword, label, [index]))
        if keyword == "sub":
            self._name(self.subroutines, index, control, source, nested=len(stack.open) > 1)
        elif keyword == PROGRAM_NUMBER:
            self._name(self.programs, index, control, source, nested=bool(stack.open))
        self.controls[index] = control

    def _pair(self, begin: int, end: int) -> None:
        self.partners[begin], self.partners[end] = end, begin

    def _branch(self, index: int, last: bool, condition: _Open, stack: _Nesting) -> None:
        """Record the next branch or the end of a condition."""
        # Each branch is linked to the next one, which is tried if its condition is false.
        self.partners[condition.branches[-1]] = index
        if last:
            self.ends.update(dict.fromkeys(condition.branches, index))
        else:
            condition.branches.append(index)
            stack.open.append(condition)

    def _name(self, names: dict[str, int], index: int, control: OWord, source: SourceLine, nested: bool) -> None:
        if nested:
            source.refuse("a subroutine begins within another one, or within a loop or condition")
        if control.label in names:
            source.refuse(
                f"o<{control.label}> is defined twice, first in line {self.lines[names[control.label]].number}"
            )
        names[control.label] = index


class _Open(NamedTuple):
    """Open loop, condition or subroutine. `branches` contains the indices of its first line and of its `elseif` and
    `else`.
    """

    keyword: str
    label: str
    branches: list[int]

    @property
    def begin(self) -> int:
        return self.branches[0]


class _Nesting(NamedTuple):
    """Open loops, conditions and subroutines, the innermost last."""

    open: list[_Open]

    def innermost(self, keyword: str, label: str) -> bool:
        return bool(self.open) and (self.open[-1].keyword, self.open[-1].label) == (keyword, label)

    def close(self, keyword: str, label: str, source: SourceLine) -> _Open:
        if not self.innermost(keyword, label):
            source.refuse(f"there is no open o<{label}> {keyword} to which this line belongs")
        return self.open.pop()

    def loop(self, label: str, source: SourceLine) -> int:
        begins = [each.begin for each in self.open if each.keyword in _LOOPS and each.label == label]
        if not begins:
            source.refuse(f"this line is not in a loop o<{label}>")
        return begins[-1]
