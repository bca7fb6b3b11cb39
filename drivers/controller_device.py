"""Common part of the devices that are a whole controller: their parts while they are open, and their tables."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Generic, TypeVar

from drivers.errors import CommandRejected, LinkLost
from drivers.roles import CompensationStore, StoreLimits, TableImage

Parts = TypeVar("Parts")


class ControllerDevice(ABC, Generic[Parts]):
    """Device with the role `CompensationStore`, which its part `_tables` carries out.

    `_parts` are the parts that can be created only after the controller has answered. `where` names the device in error
    messages.
    """

    def __init__(self, where: Mapping[str, str]) -> None:
        self._where = where
        self._parts: Parts | None = None
        self._look_only = False
        """True while the device is open only to look."""

    @property
    def _open(self) -> Parts:
        """Parts of the open device. Raises LinkLost if it is closed, and CommandRejected if they do not exist because
        it was opened only to look."""
        if self._parts is None:
            self._require_open_for_a_run()
            raise LinkLost("the device is not open", hint="open it first", **self._where)
        return self._parts

    def _require_open_for_a_run(self) -> None:
        if self._look_only:
            raise CommandRejected(
                "refused by a device that was opened only to read",
                hint="close it and open it for a run",
                **self._where,
            )

    @property
    @abstractmethod
    def _tables(self) -> CompensationStore:
        """Part that reads, stages and activates the tables."""

    def store_limits(self) -> StoreLimits:
        return self._tables.store_limits()

    def active_bank(self) -> int:
        return self._tables.active_bank()

    def pending_bank(self) -> int | None:
        return self._tables.pending_bank()

    def read_table(self, bank: int) -> TableImage | None:
        return self._tables.read_table(bank)

    def stage(self, bank: int, table: TableImage) -> None:
        self._require_open_for_a_run()
        self._tables.stage(bank, table)

    def activate(self, bank: int) -> None:
        self._require_open_for_a_run()
        self._tables.activate(bank)
