"""Disk that loses what was not synchronised, to which recorded system calls are applied.

A file has durable contents and changes since it was last synchronised, and a directory has durable entries and changes
of its entries. Synchronising a file makes its contents durable, but not its name: that is an entry of its directory.
What a power cut leaves of the changes is chosen anew for each cut.
"""

from __future__ import annotations

import random
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath

from campaigns.power_cuts.recorded_calls import (
    Acknowledged,
    Created,
    FileCall,
    Removed,
    Renamed,
    Synced,
    Truncated,
    Written,
)

SECTOR_BYTES = 512
"""Smallest part of a write that a disk keeps or loses as a whole."""
KEEP_ALL, KEEP_NONE, KEEP_SOME = "everything", "nothing", "a part"
CUTS = (KEEP_ALL, KEEP_NONE, KEEP_SOME)
"""What a cut leaves of the changes that were not synchronised; after `KEEP_ALL` only the process was killed."""


@dataclass
class _File:
    durable: bytearray = field(default_factory=bytearray)
    changes: list[Written | Truncated] = field(default_factory=list)


@dataclass
class _Directory:
    durable: dict[str, _File | _Directory] = field(default_factory=dict)
    entries: dict[str, _File | _Directory] = field(default_factory=dict)
    changes: list[tuple[str, _File | _Directory | None]] = field(default_factory=list)
    """Names with what they have been given, or None for a removed one."""

    def give(self, name: str, held: _File | _Directory | None) -> None:
        self.changes.append((name, held))
        _set(self.entries, name, held)

    def synchronise(self) -> None:
        self.durable = dict(self.entries)
        self.changes.clear()


class VolatileDisk:
    """Directory on a disk, first empty and durable. `ignored_syncs` are paths whose synchronisation has no effect."""

    def __init__(self, directory: Path, ignored_syncs: Iterable[str] = ()) -> None:
        self._root_path = PurePosixPath(directory)
        self._root = _Directory()
        self._ignored = frozenset(ignored_syncs)

    def apply(self, call: FileCall) -> None:
        """Apply one system call."""
        match call:
            case Created():
                parent, name = self._place(call.path)
                parent.give(name, _Directory() if call.directory else _File())
            case Removed():
                parent, name = self._place(call.path)
                parent.give(name, None)
            case Renamed():
                (parent, name), (target, new) = self._place(call.path), self._place(call.target)
                held = parent.entries[name]
                target.give(new, held)
                parent.give(name, None)
            case Written() | Truncated():
                held = self._held(call.path)
                assert isinstance(held, _File)
                held.changes.append(call)
            case Synced():
                self._synchronise(call.path)
            case Acknowledged():
                pass

    def _synchronise(self, path: str) -> None:
        if path in self._ignored:
            return
        held = self._held(path)
        if isinstance(held, _Directory):
            held.synchronise()
            return
        for change in held.changes:
            _change(held.durable, change)
        held.changes.clear()

    def cut(self, target: Path, kept: str, rng: random.Random) -> None:
        """Write to the directory `target` what a power cut now leaves; the disk itself is not changed."""
        _write(self._root, target, kept, rng)

    def _place(self, path: str) -> tuple[_Directory, str]:
        parts = PurePosixPath(path).relative_to(self._root_path).parts
        directory = self._root
        for part in parts[:-1]:
            held = directory.entries[part]
            assert isinstance(held, _Directory)
            directory = held
        return directory, parts[-1]

    def _held(self, path: str) -> _File | _Directory:
        if PurePosixPath(path) == self._root_path:
            return self._root
        directory, name = self._place(path)
        return directory.entries[name]


def _set(entries: dict[str, _File | _Directory], name: str, held: _File | _Directory | None) -> None:
    if held is None:
        entries.pop(name, None)
    else:
        entries[name] = held


def _change(data: bytearray, change: Written | Truncated) -> None:
    if isinstance(change, Truncated):
        del data[change.size :]
        data.extend(bytes(change.size - len(data)))
        return
    data.extend(bytes(max(change.offset - len(data), 0)))
    data[change.offset : change.offset + len(change.data)] = change.data


def _sectors(change: Written, rng: random.Random) -> Iterable[Written]:
    """Return the parts of a write that the disk has kept; its sectors are kept or lost on their own."""
    end = change.offset + len(change.data)
    start = change.offset
    while start < end:
        stop = min((start // SECTOR_BYTES + 1) * SECTOR_BYTES, end)
        if rng.random() < 0.5:
            yield Written(change.path, start, change.data[start - change.offset : stop - change.offset])
        start = stop


def _contents(file: _File, kept: str, rng: random.Random) -> bytes:
    data = bytearray(file.durable)
    for change in file.changes if kept != KEEP_NONE else ():
        parts = _sectors(change, rng) if kept == KEEP_SOME and isinstance(change, Written) else (change,)
        for part in parts:
            _change(data, part)
    return bytes(data)


def _write(directory: _Directory, target: Path, kept: str, rng: random.Random) -> None:
    """Write a directory; of its changed entries a part is kept from the first one on, as by a journal of metadata."""
    entries = dict(directory.durable)
    count = {KEEP_ALL: len(directory.changes), KEEP_NONE: 0}.get(kept, rng.randint(0, len(directory.changes)))
    for name, held in directory.changes[:count]:
        _set(entries, name, held)
    target.mkdir(exist_ok=True)
    for name, held in entries.items():
        if isinstance(held, _Directory):
            _write(held, target / name, kept, rng)
        elif not name.endswith("-shm"):  # shared memory of processes that are gone, which SQLite builds again
            (target / name).write_bytes(_contents(held, kept, rng))
