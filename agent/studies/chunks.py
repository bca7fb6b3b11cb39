"""Chunks of items that a worker process handles together, and errors that name the failed item.

This module contains only code that a worker process executes.
"""

from __future__ import annotations

import pickle
import platform
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from importlib.metadata import version
from typing import Any, Generic, TypeVar

from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]

from drivers.errors import ConfigurationError, InputError, VolcalError
from twin.errors import TwinError

Item = TypeVar("Item")
Result = TypeVar("Result")

_MAX_NAME_LENGTH = 60

_CHUNKS_PER_WORKER = 8  # enough that all workers finish at about the same time
_MAX_ITEMS = 32  # items, so that progress is visible; sending a task of 100 kB costs less than one item


@dataclass(frozen=True)
class Chunk(Generic[Item]):
    """Consecutive items of a list, starting at index `first`."""

    first: int
    items: Sequence[Item]

    def run(self, task: Callable[[Item], Result]) -> list[Result]:
        """Return the result of `task` for each item of the chunk. Raises VolcalError with the name of the failed item
        if `task` raises an error."""
        results: list[Result] = []
        for number, item in enumerate(self.items, start=self.first):
            try:
                results.append(task(item))
            except Exception as error:
                raise _as_volcal_error(error, _item_name(number, item)) from error
        return results


def split_into_chunks(items: Sequence[Item], workers: int) -> list[Chunk[Item]]:
    """Split the items into chunks of equal size for `workers` worker processes; the last chunk may be shorter."""
    size = max(1, min(_MAX_ITEMS, -(-len(items) // (_CHUNKS_PER_WORKER * workers))))
    return [Chunk(start, items[start : start + size]) for start in range(0, len(items), size)]


def run_chunk(task: bytes, chunk: Chunk[Any]) -> list[Any]:
    """Return the results of a pickled task for the items of a chunk. Linear algebra in this process is limited to one
    thread.

    The limit is needed because the result of a sum computed by several threads depends on the number of threads.
    """
    function = _unpickled(task)
    threadpool_limits(limits=1)  # after unpickling, since it affects only libraries that are already loaded
    return chunk.run(function)


def run_chunk_on_cluster(task: bytes, chunk: Chunk[Any], software: Mapping[str, str]) -> list[Any]:
    """Return the results of a pickled task for the items of a chunk, computed on a computer of the cluster.

    `software` contains the software versions of the computer that submitted the chunk. Raises ConfigurationError if the
    versions on this computer differ.
    """
    here = local_software()
    for name, wanted in software.items():
        if here[name] != wanted:
            raise ConfigurationError(
                f"a worker of the cluster has {name} {here[name]}, this computer {wanted}",
                hint="results would depend on the computer: install the same versions everywhere",
            )
    return run_chunk(task, chunk)


def local_software() -> dict[str, str]:
    """Return the versions of all software that affects the numbers of a study."""
    names = ("volcal", "numpy", "scipy")
    return {"Python": ".".join(platform.python_version_tuple()[:2]), **{name: version(name) for name in names}}


@lru_cache(maxsize=2)
def _unpickled(task: bytes) -> Callable[[Any], Any]:
    """Return the unpickled task, cached because many chunks share one task."""
    unpickled: Callable[[Any], Any] = pickle.loads(task)  # noqa: S301  pickled by the process that started this work
    return unpickled


def _as_volcal_error(error: Exception, item: str) -> VolcalError:
    if isinstance(error, VolcalError):
        return error.at(item=item)
    if isinstance(error, TwinError):
        return InputError(error.message, hint=error.hint, **error.where).at(item=item)
    return VolcalError(f"the computation failed: {type(error).__name__}: {error}", item=item)


def _item_name(number: int, item: object) -> str:
    text = repr(item)
    return str(number) if text == str(number) or len(text) > _MAX_NAME_LENGTH else f"{number}: {text}"
