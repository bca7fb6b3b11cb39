"""Exceptions raised by `twin`, the mathematical part of the project.

::

    TwinError (ValueError)
    ├── ModelError     invalid kinematic chain, axis range or Legendre order, or an axis position outside a grid
    ├── DataError      measured or calibrated values that cannot be used
    │   └── PositionError  a position of the artefact that cannot be used; the message begins with its number
    ├── FormatError    invalid text of a file; the error names the file, and the key or the row and column
    └── SingularSet    measurements that do not determine the requested quantities

The errors of the device drivers have the same attributes (message, named locations, hint), but a different base class.
`twin` therefore does not depend on the drivers.
"""

from __future__ import annotations

from typing import Self


class TwinError(ValueError):
    """Base class of the errors of `twin`.

    `where` maps each kind of location (file, key, row, column, axis) to its value, for example `row` to 3. `hint` tells
    the user what to do.
    """

    def __init__(self, message: str, *, hint: str = "", **where: str | int) -> None:
        super().__init__(message)
        self.message = message
        self.hint = hint
        self.where: dict[str, str] = {name: str(value) for name, value in where.items()}

    def at(self, **where: str | int) -> Self:
        """Add locations known to the caller (a file, a key) to `where` and return the error; existing entries are not
        replaced.
        """
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


class PositionError(DataError):
    """Error in the measurements of one position of the artefact, with the message `position K TEXT`.

    `position` is the number K of the position in the observations.
    """

    def __init__(self, position: int, text: str, *, hint: str = "", **where: str | int) -> None:
        super().__init__(f"position {position} {text}", hint=hint, **where)
        self.position = position
        self._text = text

    def renumbered(self, number: int) -> PositionError:
        """Return the same error with the number of the position replaced, for example by its number in a file."""
        return PositionError(number, self._text, hint=self.hint, **self.where)


class FormatError(TwinError):
    pass


class SingularSet(TwinError):
    pass
