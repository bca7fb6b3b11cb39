"""Errors of the mathematics.

::

    TwinError (ValueError)
    ├── ModelError     chain, ranges, orders, axis positions outside a grid
    ├── DataError      measured or calibrated values that cannot be used
    ├── FormatError    the text of a neutral file: names file, key or row and column
    └── SingularSet    the measurements cannot determine what is asked for

Same shape as the errors of devices and runs (message, named locations, hint), but a separate trunk: the mathematics
does not import the drivers (docs/decisions/0018).
"""

from __future__ import annotations

from typing import Self


class TwinError(ValueError):
    """Root of the tree. `where` holds named locations (file, key, row, column, axis), `hint` what to do."""

    def __init__(self, message: str, *, hint: str = "", **where: str | int) -> None:
        super().__init__(message)
        self.message = message
        self.hint = hint
        self.where: dict[str, str] = {name: str(value) for name, value in where.items()}

    def at(self, **where: str | int) -> Self:
        """Add locations known to a caller (a file, a key); names already present are kept."""
        for name, value in where.items():
            self.where.setdefault(name, str(value))
        return self

    def __str__(self) -> str:
        places = ", ".join(f"{name} {value}" for name, value in self.where.items())
        text = f"{self.message} ({places})" if places else self.message
        return f"{text}. {self.hint}" if self.hint else text


class ModelError(TwinError):
    pass


class DataError(TwinError):
    pass


class FormatError(TwinError):
    pass


class SingularSet(TwinError):
    pass
