"""A door: a way in to the one `Control`. What opens them knows nothing else of them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from typing import Protocol

from agent.service.control import Control


class Door(Protocol):
    """`start` returns when it is open, or raises; `stop` returns when nobody comes through any more."""

    @property
    def name(self) -> str: ...

    def start(self, control: Control) -> None: ...

    def stop(self) -> None: ...


@contextmanager
def opened(doors: Sequence[Door], control: Control) -> Iterator[None]:
    """All of them for the block; those already open are closed where one does not open."""
    with ExitStack() as stack:
        for door in doors:
            door.start(control)
            stack.callback(door.stop)
        yield
