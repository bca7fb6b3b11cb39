"""Contract tests of the device role `LookOnlyDevice`.

Every driver whose device can be read between runs must pass them. Each test uses the fixture `look`, a `LookRig` with
the equipment in one condition: ready, in an alarm, locked, not homed, in use. The equipment's own record, not that of
the driver, shows what it has received.
"""
# ruff: noqa: S101  contract tests assert

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence

import pytest

from drivers.errors import CommandRejected, DeviceError
from drivers.roles import Device, LookOnlyDevice


class LookRig(ABC):
    """Equipment in one condition, with the device under test, which is closed.

    `device` is the device under test. `answers` is False if the equipment answers no query in its condition.
    `records_queries` is False if the equipment keeps no record of queries, only of commands. `selections` are the
    writes that only select which part of a table the equipment shows.
    """

    device: Device
    answers: bool = True
    records_queries: bool = True
    selections: frozenset[str] = frozenset()

    @abstractmethod
    def read(self) -> object:
        """Read with the device all that it can read while it is open only to look, and return it."""

    @abstractmethod
    def read_tables(self) -> object:
        """Read a table with the device, if it has the role `CompensationStore`, and return it."""

    @abstractmethod
    def commands(self) -> Sequence[Callable[[], object]]:
        """Return calls of all methods of the device that move, stop, reset, unlock or write."""

    @abstractmethod
    def received(self) -> list[str]:
        """Return one text for each frame, byte or request that the equipment has received from anybody since the last
        call of this method or of `writes`."""

    @abstractmethod
    def is_query(self, received: str) -> bool:
        """Return True if what `received` describes only asks the equipment."""

    def writes(self) -> list[str]:
        """Return those texts of `received` that are no queries."""
        return [one for one in self.received() if not self.is_query(one)]

    @abstractmethod
    def state(self) -> object:
        """Return the state of the equipment, without asking through the device: motion, alarms, locks, homing, modes,
        tables, half-received input. It can be compared."""

    @abstractmethod
    def move_with_another_client(self, meanwhile: Callable[[], None]) -> None:
        """Make a motion with another client, as a run does, call `meanwhile` in the middle of the motion, and require
        that it ends as commanded. Does nothing if the condition permits no motion."""

    @property
    def looked_at(self) -> LookOnlyDevice:
        assert isinstance(self.device, LookOnlyDevice)
        return self.device


class LookOnlyContract:
    def test_it_can_be_looked_at(self, look: LookRig) -> None:
        assert look.looked_at.why_no_look() == ""

    def test_a_look_writes_nothing_and_changes_nothing(self, look: LookRig) -> None:
        before = look.state()
        look.received()
        if look.answers:
            look.looked_at.open_to_look()
            first = look.read()
            assert look.read() == first
            look.device.close()
        else:
            with pytest.raises(DeviceError):
                look.looked_at.open_to_look()
        received = look.received()
        assert received or not look.records_queries
        assert [one for one in received if not look.is_query(one)] == []
        assert look.state() == before

    def test_a_look_at_the_tables_selects_what_is_shown_and_writes_nothing_else(self, look: LookRig) -> None:
        before = look.state()
        look.received()
        if look.answers:
            look.looked_at.open_to_look(tables=True)
            look.read_tables()
            look.device.close()
        else:
            with pytest.raises(DeviceError):
                look.looked_at.open_to_look(tables=True)
        assert set(look.writes()) <= look.selections
        assert look.state() == before

    def test_every_command_is_refused_and_a_stop_does_nothing(self, look: LookRig) -> None:
        if not look.answers:
            return
        before = look.state()
        look.looked_at.open_to_look()
        look.received()
        for command in look.commands():
            with pytest.raises(CommandRejected, match="opened only to read"):
                command()
        look.device.stop()
        look.device.close()
        look.device.stop()
        assert look.writes() == []
        assert look.state() == before

    def test_a_look_does_a_motion_of_another_client_no_harm(self, look: LookRig) -> None:
        """The look may fail, for example because the other client has locked the line."""
        looks = []

        def look_at_it() -> None:
            looks.append(True)
            try:
                look.looked_at.open_to_look()
                look.read()
            except DeviceError:
                pass
            finally:
                look.device.close()

        look.move_with_another_client(look_at_it)
        assert len(looks) <= 1
