"""Lines of a part program, and the errors that name them."""

from __future__ import annotations

import re
from typing import NamedTuple, NoReturn

from twin.errors import FormatError

_COMMENT = re.compile(r"\([^()]*\)|;.*")
_SPACE = re.compile(r"\s+")


class SourceLine(NamedTuple):
    """Line of a part program without its line end. `number` counts from 1. `file` is the name of the subprogram file
    that contains the line, or an empty string for the part program itself.
    """

    number: int
    text: str
    file: str = ""

    def refusal(self, message: str, hint: str = "") -> FormatError:
        """Return an error for a line that cannot be corrected. The message of the error contains the text of the
        line.
        """
        shown = "".join(sign if sign.isprintable() else "?" for sign in self.text.strip()[:61])
        shown = shown if len(shown) <= 60 else shown[:57] + "..."
        error = FormatError(f"{message}: {shown}", hint=hint, line=self.number)
        return error.at(file=self.file) if self.file else error

    def refuse(self, message: str, hint: str = "") -> NoReturn:
        """Raise the error that `refusal` returns."""
        raise self.refusal(message, hint)

    def split_comments(self) -> tuple[str, list[str]]:
        """Return the code of the line in lower case and without white space, and its comments as written.

        White space and case have no meaning in RS-274/NGC, not even within a number or a name.
        """
        if "(" not in self.text and ";" not in self.text:
            return _SPACE.sub("", self.text).lower(), []
        code = _SPACE.sub("", _COMMENT.sub("", self.text)).lower()
        if "(" in code or ")" in code:
            self.refuse("a comment is not closed or is nested in another one")
        return code, _COMMENT.findall(self.text)
