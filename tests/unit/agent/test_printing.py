"""Output of commands: an identity and a path are never cut, in a terminal of 80 columns, and in a pipe."""

from __future__ import annotations

import io
import os
import pty
import re
import subprocess
import sys
import termios
import tty
from collections.abc import Callable
from pathlib import Path

import pytest
from rich.console import Console

import agent.cli
from agent.cli.printing import columns_table, facts_table, gates_table, results_console
from agent.lasting_output import lasting_output
from agent.results.gates.gate_forecast import GateForecast

PATH = "/var/lib/volcal/a-machine-with-a-long-name/20261122T124825Z-fe2a/another-long-folder-of-the-plant/report.html"
RUN = "20261122T124825Z-fe2a"
ANSI = re.compile(r"\x1b\[[0-9;]*m")
PROGRAM = f"""
from agent.cli.printing import columns_table, facts_table, results_console
table = columns_table(("run", "kind", "a long heading", "another long heading", "a third long heading"), whole=("run",))
table.add_row("{RUN}", "calibrate", "many words to fold here", "many words to fold here", "averyveryverylongword")
console = results_console()
console.print(table)
console.print("report: {PATH}", markup=False)
"""

FORECASTS = [
    GateForecast(
        "gain", "verification.min_gain", 0.1, 0.25, False, "text", "measure more positions or lower it. " * 12, "≥"
    ),
    GateForecast(
        "correction", "gates.common_scale_false_alarm", 1061.0, 1000.0, False, "text", "narrow the range", "≤"
    ),
    GateForecast("redundancy", "gates.min_degrees_of_freedom", None, 10610.0, True, "text", "", "≥"),
]


@pytest.mark.parametrize("width", [80, 300, 100_000])
def test_the_table_of_the_gates_fits_a_page_and_says_on_which_side_of_a_limit_a_value_passes(width: int) -> None:
    console = Console(width=width, file=io.StringIO(), highlight=False, soft_wrap=True)
    console.print(gates_table(FORECASTS))
    assert isinstance(console.file, io.StringIO)
    text = console.file.getvalue()
    assert max(map(len, text.splitlines())) <= min(width, 96)
    assert "0.1 │ ≥ 0.25" in re.sub(" +", " ", text)
    assert "1061 │ ≤ 1000 │ refuse" in re.sub(" +", " ", text.replace("1060", "1061"))
    assert "no bound │ ≥ 10600" in re.sub(" +", " ", text)
    assert "e+0" not in text
    assert text.count("lower it.") == 12


def in_terminal(columns: int) -> str:
    """Return the output of PROGRAM in a terminal with this many columns."""
    leader, follower = pty.openpty()
    tty.setraw(follower)
    termios.tcsetwinsize(follower, (24, columns))
    environment = {name: value for name, value in os.environ.items() if name != "COLUMNS"} | {"TERM": "xterm"}
    command = [sys.executable, "-c", PROGRAM]
    subprocess.run(command, stdin=follower, stdout=follower, stderr=subprocess.PIPE, env=environment, check=True)
    os.close(follower)
    shown = b""
    try:
        while chunk := os.read(leader, 4096):
            shown += chunk
    except OSError:
        pass  # the end of a terminal whose other side is closed
    finally:
        os.close(leader)
    return ANSI.sub("", shown.decode())


def test_a_terminal_of_80_columns_cuts_neither_identity_nor_path() -> None:
    shown = in_terminal(80)
    assert RUN in shown
    assert f"report: {PATH}\n" in shown
    assert "…" not in shown
    tables = [line for line in shown.splitlines() if line.startswith(("│", "┃"))]
    assert tables
    assert max(len(line) for line in tables) <= 80


def test_a_pipe_gets_whole_lines() -> None:
    shown = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, check=True).stdout
    (row,) = (line for line in shown.splitlines() if line.startswith(f"│ {RUN}"))
    assert [cell.strip() for cell in row.strip("│").split("│")] == [
        RUN, "calibrate", "many words to fold here", "many words to fold here", "averyveryverylongword"
    ]  # fmt: skip
    assert f"report: {PATH}\n" in shown


def test_facts_are_folded_not_cut() -> None:
    text = io.StringIO()
    Console(file=text, width=40).print(facts_table([("report", PATH)], title=f"{RUN}: complete"))
    cells = [line.split("│")[2].strip() for line in text.getvalue().splitlines() if line.startswith("│")]
    assert "".join(cells) == PATH
    assert RUN in text.getvalue()


def test_numbers_are_aligned_to_the_right() -> None:
    table = columns_table(("name", "µm"), numbers=("µm",))
    assert [column.justify for column in table.columns] == ["left", "right"]


def test_every_command_prints_its_tables_through_this_module() -> None:
    folder = Path(agent.cli.__file__).parent
    writers = [path for path in folder.rglob("*.py") if path.name != "printing.py"]
    assert [path.name for path in writers if "Console()" in path.read_text(encoding="utf-8")] == []


def test_output_that_is_no_terminal_has_no_width(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stdout", io.StringIO())
    assert results_console().width > 10_000


COMMAND_OF_A_RUN = """
import logging
import sys
import click
import structlog
from rich.console import Console
from agent.cli.errors import fail, reported
from agent.cli.main import configure_logging
from agent.cli.printing import facts_table, results_console
from agent.cli.run_commands.progress import watching
from agent.errors import Aborted
from agent.execution.run_state import Announcement
from agent.lasting_output import lasting_output

@click.command()
@lasting_output()
@reported
def command():
    configure_logging(logging.WARNING)
    with watching(Console(stderr=True)) as listener:
        for state in ("measuring", "aborting"):
            listener(Announcement("state", state, {"state": state}))
            listener(Announcement("progress", "ball", {"fraction": 0.1, "minutes_left": 1.0}))
            structlog.get_logger().warning("a link was lost")
    results_console().print(facts_table([("report", "none")]))
    click.echo("{}")
    raise fail(Aborted("aborted: SIGHUP"))

command()
"""


def gone_pipe() -> int:
    reading, writing = os.pipe()
    os.close(reading)
    return writing


def gone_terminal() -> int:
    leader, follower = pty.openpty()
    os.close(leader)
    return follower


@pytest.mark.parametrize("gone", [gone_pipe, gone_terminal])
@pytest.mark.parametrize("streams", [("stdout", "stderr"), ("stdout",), ("stderr",)])
def test_a_run_ends_with_its_exit_code_although_nobody_can_read_its_output(
    gone: Callable[[], int], streams: tuple[str, ...]
) -> None:
    output = gone()
    stdout, stderr = (output if stream in streams else subprocess.PIPE for stream in ("stdout", "stderr"))
    command = [sys.executable, "-c", COMMAND_OF_A_RUN]
    try:
        ended = subprocess.run(command, stdout=stdout, stderr=stderr, text=True, check=False)
    finally:
        os.close(output)
    assert ended.returncode == 5
    assert "Traceback" not in (ended.stderr or "")
    assert "Exception ignored" not in (ended.stderr or "")
    if "stderr" not in streams:
        assert ended.stderr.endswith("error: aborted: SIGHUP\n")
    if "stdout" not in streams:
        assert ended.stdout.endswith("{}\n")


def test_a_result_that_a_full_disk_cuts_off_is_an_error_and_lost_progress_is_none() -> None:
    command = [sys.executable, "-c", COMMAND_OF_A_RUN]
    with Path("/dev/full").open("wb") as full:
        result = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, check=False)
        progress = subprocess.run(command, stdout=subprocess.PIPE, stderr=full, text=True, check=False)
    assert result.returncode == 1
    assert "No space left on device" in result.stderr
    assert progress.returncode == 5
    assert progress.stdout.endswith("{}\n")


def test_streams_are_themselves_again_after_a_command() -> None:
    former = sys.stdout, sys.stderr
    with lasting_output():
        assert sys.stdout is not former[0]
        assert sys.stdout.encoding == former[0].encoding
        assert sys.stderr.isatty() == former[1].isatty()
    assert (sys.stdout, sys.stderr) == former
