"""Values that never change, and values of equal content that are shared."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Hashable, Mapping
from dataclasses import fields, is_dataclass
from typing import Generic, Self, TypeVar

import numpy as np

T = TypeVar("T")


class Immutable:
    """Value that never changes. Deep copies of the objects that contain it share it."""

    __slots__ = ()

    def __deepcopy__(self, _: object) -> Self:
        return self


def content_key(value: object) -> Hashable:
    """Return a key that is equal for two values of the same content and different for all others.

    A value is a number, a text, None, an array, or a mapping, a tuple, a list or a frozen dataclass of such values.
    Fields of a dataclass that its constructor does not take (caches) are left out.
    """
    if is_dataclass(value):
        content = tuple(content_key(getattr(value, one.name)) for one in fields(value) if one.init)
        return (type(value), content)
    if isinstance(value, np.ndarray):
        return (value.shape, value.dtype.str, value.tobytes())
    if isinstance(value, Mapping):
        return tuple((content_key(key), content_key(one)) for key, one in value.items())
    if isinstance(value, (list, tuple)):
        return tuple(map(content_key, value))
    assert isinstance(value, Hashable)  # noqa: S101  no other value is part of a frozen one
    return value


class SharedValues(Generic[T]):
    """The values that were used last, at most `size`. Equal content is the same object, so that what such an object
    has computed and keeps is computed once in a process."""

    def __init__(self, size: int) -> None:
        self._size = size
        self._values: OrderedDict[Hashable, T] = OrderedDict()

    def shared(self, value: T) -> T:
        """Return the value with the content of `value` that was handed in first, which may be `value` itself."""
        key = content_key(value)
        found = self._values.pop(key, value)
        self._values[key] = found
        while len(self._values) > self._size:
            self._values.popitem(last=False)
        return found
