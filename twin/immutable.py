"""Values that never change."""

from __future__ import annotations

from typing import Self


class Immutable:
    """Value that never changes. Deep copies of the objects that contain it share it."""

    __slots__ = ()

    def __deepcopy__(self, _: object) -> Self:
        return self
