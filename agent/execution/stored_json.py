"""JSON texts that the journal stores. A text that is damaged, or that lacks an entry, is an error in the user's words.

A disk or a foreign program can damage single bytes of a journal, which SQLite does not notice.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NoReturn

from drivers.errors import InputError, VolcalError
from twin.errors import TwinError

HINT = "restore the journal from a copy, or move it to another directory; the next run begins a new journal"
_DAMAGE = (ValueError, LookupError, TypeError, AttributeError, ArithmeticError, RecursionError)


class StoredRecord(dict[str, Any]):
    """Object in a stored text. Reading an entry that it lacks raises InputError."""

    def __missing__(self, key: str) -> NoReturn:
        raise InputError(f"the journal is damaged: a record lacks {key!r}", hint=HINT)


def stored_json(text: str) -> Any:
    """Return the value of a stored text. Raises InputError if the text is damaged."""
    try:
        return json.loads(text, object_hook=StoredRecord)
    except (ValueError, TypeError, RecursionError) as error:
        raise InputError("the journal is damaged: a record cannot be read", hint=HINT) from error


@contextmanager
def damage_reported(failure: type[VolcalError], path: Path | None = None) -> Iterator[None]:
    """Raise an error of the class `failure` if a stored value of a wrong kind, such as a text in place of a number,
    causes an error in the `with` block."""
    try:
        yield
    except (VolcalError, TwinError):
        raise
    except _DAMAGE as error:
        where = {} if path is None else {"file": str(path)}
        message = "the journal is damaged: a record cannot be used"
        raise failure(message, hint=HINT, **where) from error
