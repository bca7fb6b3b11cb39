"""Tests of the operator at a terminal."""

from __future__ import annotations

import io
import os
import pty
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.metadata import entry_points
from pathlib import Path

import pytest
from rich.console import Console

from agent.cli.run_commands.progress import watching
from agent.errors import Aborted
from agent.execution.run_state import Announcement
from agent.execution.supervisor import Supervisor
from drivers.clock import Clock, InterruptibleClock, VirtualClock
from drivers.console_operator.plugin import PLUGIN, ConsoleOperator, ConsoleOperatorSettings
from drivers.errors import PermissionMissing
from drivers.registry import DeviceContext
from drivers.roles import Operator, OperatorRequest, OperatorTask

MOVE = OperatorRequest(OperatorTask.MOVE_ARTEFACT, "Move the artefact", station=3)
CONSENT = OperatorRequest(OperatorTask.CONSENT, "Activate the new table?")


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


class Screen(Terminal):
    """Screen of a real terminal `keyboard`. The next of the `answers` is typed when a question has been shown; after
    the last one the terminal hangs up."""

    def __init__(self, keyboard: int, answers: list[bytes]) -> None:
        super().__init__()
        self._keyboard: int | None = keyboard
        self._answers = answers

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
def operator(
    *answers: bytes, typed_ahead: bytes = b"", clock: Clock | None = None
) -> Iterator[tuple[ConsoleOperator, Screen]]:
    """Yield an operator who gives the `answers`, of which at least one is left at the end, and the operator's
    screen."""
    keyboard, follower = pty.openpty()
    with os.fdopen(follower, "r", encoding="utf-8") as source:
        screen = Screen(keyboard, [*answers])
        os.write(keyboard, typed_ahead)
        device = ConsoleOperator(ConsoleOperatorSettings(attempts=2), "hand", clock or VirtualClock(), source, screen)
        yield device, screen
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
        assert "\nMove the artefact (station 3)\n[d]one / [n]o:\n" in screen.getvalue()
        assert [finding.ok for finding in device.diagnose()] == [True]


@pytest.mark.parametrize("ahead", [b"yes\n", b"yes\nyes\n", b"y"])
def test_what_was_typed_before_the_question_is_not_its_answer(ahead: bytes) -> None:
    with operator(b"no\n", typed_ahead=ahead) as (device, _):
        assert device.ask(CONSENT) is False


def test_the_run_can_be_aborted_while_a_question_is_open() -> None:
    clock = VirtualClock()
    supervisor = Supervisor(clock)
    clock.subscribe(lambda _: supervisor.request_abort("Ctrl-C"))
    with (
        operator(b"", clock=InterruptibleClock(clock, supervisor.check)) as (device, _),
        pytest.raises(Aborted, match="Ctrl-C"),
    ):
        device.ask(MOVE)


def test_a_question_can_be_read_beside_the_progress_of_the_run(monkeypatch: pytest.MonkeyPatch) -> None:
    keyboard, follower = pty.openpty()
    clock, screen = VirtualClock(), Terminal()

    def answer(_: float) -> None:
        os.write(keyboard, b"d\n")

    clock.subscribe(answer)
    monkeypatch.setattr("sys.stderr", screen)
    with os.fdopen(follower, "r") as source, watching(Console(stderr=True, width=200)) as listener:
        listener(Announcement("progress", "ball", {"fraction": 0.1, "minutes_left": 1.0}))
        device = ConsoleOperator(ConsoleOperatorSettings(), "hand", clock, source, sys.stderr)
        assert device.ask(OperatorRequest(OperatorTask.MOVE_ARTEFACT, "Move the artefact [bar 7]")) is True
    os.close(keyboard)
    assert "Move the artefact [bar 7]\n[d]one / [n]o:\n" in re.sub(r"\x1b\[[0-9;]*m", "", screen.getvalue())


def test_unrecognised_answers_count_as_no() -> None:
    with operator(b"what\n", b"how\n", b"yes\n") as (device, screen):
        assert device.ask(CONSENT) is False
        assert screen.getvalue().count("Activate the new table?\n[y]es / [n]o:\n") == 2


def test_a_closed_terminal_is_an_error() -> None:
    with (
        operator() as (device, _),
        pytest.raises(PermissionMissing, match=r"asked for consent: the terminal was closed \(device hand\)"),
    ):
        device.ask(CONSENT)


def test_without_a_terminal_it_refuses() -> None:
    device = ConsoleOperator(ConsoleOperatorSettings(), "hand", VirtualClock(), io.StringIO("done\n"), io.StringIO())
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
