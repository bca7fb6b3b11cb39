"""Tests of the operator at a terminal."""

from __future__ import annotations

import io
import os
import pty
from contextlib import ExitStack
from importlib.metadata import entry_points
from pathlib import Path

import pytest

from drivers.clock import VirtualClock
from drivers.console_operator.plugin import PLUGIN, ConsoleOperator, ConsoleOperatorSettings
from drivers.errors import PermissionMissing
from drivers.registry import DeviceContext
from drivers.roles import Operator, OperatorRequest, OperatorTask

MOVE = OperatorRequest(OperatorTask.MOVE_ARTEFACT, "Move the artefact", station=3)
CONSENT = OperatorRequest(OperatorTask.CONSENT, "Activate the new table?")


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def operator(answers: str) -> tuple[ConsoleOperator, Terminal]:
    sink = Terminal()
    return ConsoleOperator(ConsoleOperatorSettings(attempts=2), "hand", Terminal(answers), sink), sink


@pytest.mark.parametrize(
    ("answers", "agrees"),
    [("d\n", True), (" Done \n", True), ("y\n", True), ("n\n", False), ("no\n", False), ("what\nyes\n", True)],
)
def test_answers(answers: str, agrees: bool) -> None:
    device, sink = operator(answers)
    assert isinstance(device, Operator)
    assert device.ask(MOVE) is agrees
    assert "Move the artefact (station 3) [d]one / [n]o: " in sink.getvalue()


def test_unrecognised_answers_count_as_no() -> None:
    device, sink = operator("what\nhow\nyes\n")
    assert device.ask(CONSENT) is False
    assert sink.getvalue().count("Activate the new table? [y]es / [n]o: ") == 2


def test_a_closed_terminal_is_an_error() -> None:
    device, _ = operator("")
    with pytest.raises(PermissionMissing, match=r"asked for consent: the terminal was closed \(device hand\)"):
        device.ask(CONSENT)


def test_without_a_terminal_it_refuses() -> None:
    device = ConsoleOperator(ConsoleOperatorSettings(), "hand", io.StringIO("done\n"), Terminal())
    with pytest.raises(PermissionMissing, match="there is no terminal"):
        device.ask(MOVE)
    assert [finding.ok for finding in device.diagnose()] == [False]


def test_it_asks_on_a_real_terminal() -> None:
    leader, follower = pty.openpty()
    with ExitStack() as stack:
        stack.callback(os.close, leader)
        source = stack.enter_context(os.fdopen(follower, "r"))
        sink = stack.enter_context(os.fdopen(os.dup(follower), "w"))
        device = ConsoleOperator(ConsoleOperatorSettings(), "hand", source, sink)
        os.write(leader, b"done\n")
        assert device.ask(MOVE) is True
        assert [finding.ok for finding in device.diagnose()] == [True]


def test_the_plugin_is_installed() -> None:
    (entry,) = entry_points(group="volcal.drivers", name="console-operator")
    assert entry.load() is PLUGIN
    device = PLUGIN.create(PLUGIN.settings(), DeviceContext("hand", VirtualClock(), Path()))
    device.open()
    device.stop()
    device.close()
