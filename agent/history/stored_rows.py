"""Rows that were read from the history database, checked against the types of their class.

A disk or a foreign program can damage single bytes of a database, which SQLite does not notice: it returns a text where
a number was stored.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import MISSING, fields
from functools import cache
from typing import Annotated, Any, TypeVar, get_type_hints

from pydantic import ConfigDict, Field, TypeAdapter, ValidationError

from drivers.errors import InputError, VolcalError

T = TypeVar("T")

_DAMAGE = (ValueError, LookupError, TypeError, ArithmeticError)
"""Errors of the conversion of a column, and of the use of a value, that was not stored so."""
_LARGEST = 1e12
"""Largest absolute value of a number, in any unit of the history. Squares of damaged numbers could overflow."""
_Number = Annotated[float, Field(ge=-_LARGEST, le=_LARGEST)]
_BOUNDED: dict[Any, Any] = {float: _Number, float | None: _Number | None}


def checked_rows(row_type: type[T], rows: Iterable[Iterable[Any]]) -> list[T]:
    """Return an instance of the dataclass `row_type` for each row, whose values are in the order of its fields.

    Raise ValidationError, a ValueError, if a value has another type, or if a number is too large for a result.
    """
    key: Any = row_type
    checked = _columns(key).validate_python([tuple(row) for row in rows])
    return [row_type(*row) for row in checked]


@contextmanager
def damage_of_history(**where: str) -> Iterator[None]:
    """Raise InputError if a value that was read from the history in the `with` block cannot be used. `where` says which
    database it is."""
    try:
        yield
    except VolcalError:
        raise
    except _DAMAGE as error:
        reason = error.errors()[0]["msg"] if isinstance(error, ValidationError) else str(error)
        raise InputError(
            f"the history database is damaged: a value cannot be used ({reason})",
            **where,
            hint="move it away, or name a new one in `history.url`; `volcal history sync` copies all runs again",
        ) from error


@cache
def _columns(row_type: Any) -> TypeAdapter[list[tuple[Any, ...]]]:
    """Return what checks the rows of the dataclass `row_type`. Fields with a factory are no columns."""
    hints = get_type_hints(row_type)
    columns = tuple(
        _BOUNDED.get(hint, hint)
        for hint in (hints[one.name] for one in fields(row_type) if one.default_factory is MISSING)
    )
    # The types of the columns are not known before the program runs.
    rows_type: Any = list.__class_getitem__(tuple.__class_getitem__(columns))
    return TypeAdapter(rows_type, config=ConfigDict(strict=True, allow_inf_nan=False))
