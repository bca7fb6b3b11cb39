"""Tests of the operator at a terminal."""

from __future__ import annotations

import io
import os
import pty
from collections.abc import Iterator
from contextlib import contextmanager
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


class Screen(io.StringIO):
    """Screen of a real terminal `keyboard`. The next of the `answers` is typed when a question has been shown; after
    the last one the terminal hangs up."""

    def __init__(self, keyboard: int, answers: list[bytes]) -> None:
        super().__init__()
        self._keyboard: int | None = keyboard
        self._answers = answers

    def isatty(self) -> bool:
        return True

    def flush(self) -> None:
        if self._answers and self._keyboard is not None:
            os.write(self._keyboard, self._answers.pop(0))
        else:
            self.hang_up()

    def hang_up(self) -> None:
        if self._keyboard is not None:
            os.close(self._keyboard)
        self._keyboard = None


@contextmanager
def operator(*answers: bytes, typed_ahead: bytes = b"") -> Iterator[tuple[ConsoleOperator, Screen]]:
    """Yield an operator who gives the `answers`, of which at least one is left at the end, and the operator's
    screen."""
    keyboard, follower = pty.openpty()
    with os.fdopen(follower, "r", encoding="utf-8") as source:
        screen = Screen(keyboard, [*answers])
        os.write(keyboard, typed_ahead)
        yield ConsoleOperator(ConsoleOperatorSettings(attempts=2), "hand", source, screen), screen
        screen.hang_up()


@pytest.mark.parametrize(
    ("answers", "agrees"),
    [
        ([b"d\n"], True),
        ([b" Done \n"], True),
        ([b"y\n"], True),
        ([b"n\n"], False),
        ([b"no\n"], False),
        ([b"what\n", b"yes\n"], True),
        ([b"j\xe4\n", b"yes\n"], True),
    ],
)
def test_answers(answers: list[bytes], agrees: bool) -> None:
    with operator(*answers) as (device, screen):
        assert isinstance(device, Operator)
        assert device.ask(MOVE) is agrees
        assert "Move the artefact (station 3) [d]one / [n]o: " in screen.getvalue()
        assert [finding.ok for finding in device.diagnose()] == [True]


@pytest.mark.parametrize("ahead", [b"yes\n", b"yes\nyes\n", b"y"])
def test_what_was_typed_before_the_question_is_not_its_answer(ahead: bytes) -> None:
    with operator(b"no\n", typed_ahead=ahead) as (device, _):
        assert device.ask(CONSENT) is False


def test_unrecognised_answers_count_as_no() -> None:
    with operator(b"what\n", b"how\n", b"yes\n") as (device, screen):
        assert device.ask(CONSENT) is False
        assert screen.getvalue().count("Activate the new table? [y]es / [n]o: ") == 2


def test_a_closed_terminal_is_an_error() -> None:
    with (
        operator() as (device, _),
        pytest.raises(PermissionMissing, match=r"asked for consent: the terminal was closed \(device hand\)"),
    ):
        device.ask(CONSENT)


def test_without_a_terminal_it_refuses() -> None:
    device = ConsoleOperator(ConsoleOperatorSettings(), "hand", io.StringIO("done\n"), io.StringIO())
    with pytest.raises(PermissionMissing, match="there is no terminal"):
        device.ask(MOVE)
    assert [finding.ok for finding in device.diagnose()] == [False]


def test_the_plugin_is_installed() -> None:
    (entry,) = entry_points(group="volcal.drivers", name="console-operator")
    assert entry.load() is PLUGIN
    device = PLUGIN.create(PLUGIN.settings(), DeviceContext("hand", VirtualClock(), Path()))
    device.open()
    device.stop()
    device.close()
