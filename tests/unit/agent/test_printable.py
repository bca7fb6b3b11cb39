"""What anybody may send is shown, never obeyed: by terminals, logs and panels."""

from __future__ import annotations

import json
from pathlib import Path

import httpx
import pytest
from rich.console import Console
from service_house import house
from test_service import NIGHTLY
from volcal_command import volcal

from agent.cli.errors import fail
from agent.cli.printing import columns_table, facts_table, results_console
from agent.cli.run_commands.progress import watching
from agent.cli.service_commands import pair
from agent.execution.run_state import Announcement
from agent.execution.states import RunState
from agent.printable import MAX_REASON, one_line, printable
from agent.service.client import _parse_events
from drivers.errors import InputError

CASE_STUDY = Path(__file__).resolve().parents[3] / "config" / "case-study.toml"
EVIL = "stop\x1b]0;title\x07\x1b[2J\u202egnp.exe\r\nerror: all is well"


def test_control_characters_are_replaced() -> None:
    assert printable("Grüße, 3 µm\n") == "Grüße, 3 µm\n"
    assert not {"\x1b", "\x07", "\u202e", "\r"} & set(printable(EVIL))
    assert one_line(EVIL, 200).count("\n") == 0
    assert len(one_line("x" * 100_000, 200)) == 200


def test_the_reason_of_an_abort_is_one_short_line(tmp_path: Path) -> None:
    with house(tmp_path) as built, built.event_log.subscribe() as events:
        built.owner.start(NIGHTLY)
        built.puppet.begun()
        built.owner.abort(EVIL + "x" * 100_000)
        said = built.puppet.abort_wanted
        built.puppet.end(RunState.ABORTED)
        built.owner.wait(600.0)
        told = [event.text for event in (events.get_nowait() for _ in range(events.qsize()))]
    assert said is not None
    assert said.isprintable()
    assert len(said.removeprefix("aborted: ")) <= MAX_REASON
    assert all(text.isprintable() for text in told)
    assert any("abort requested" in text for text in told)


def test_commands_print_what_the_service_says_without_obeying_it(capsys: pytest.CaptureFixture[str]) -> None:
    ((kind, document),) = _parse_events(iter(["event: note", 'data: {"text": "\\u001b[2J", "data": {}}', ""]))
    assert (kind, document["text"]) == ("note", "\N{REPLACEMENT CHARACTER}[2J")
    results_console().print(facts_table([("doing", "[/red] [bold]x[/bold]")]))
    assert "[/red] [bold]x[/bold]" in capsys.readouterr().out


@pytest.mark.parametrize("name", ["panel [hall 2]", "panel [/hall 2]", "[bold]panel", "hall :bell: 2"])
def test_names_of_others_are_shown_as_they_are(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    """In cells, headings and titles of tables, and on lines."""
    pair._list({"clients": [{"name": name, "role": "operator", "paired": "2026-12-01T10:00:00+00:00"}]}, as_json=False)
    table = columns_table((name,), title=name)
    table.add_row(name)
    results_console().print(table)
    results_console().print(name)
    assert capsys.readouterr().out.count(name) == 5


def test_the_progress_of_a_run_is_never_read_as_markup(capsys: pytest.CaptureFixture[str]) -> None:
    with watching(Console(width=200)) as listener:
        listener(Announcement("state", "the file [/x] is wrong \x1b[2J", {"state": "faulted"}))
        listener(Announcement("note", "no report: [/x]", {}))
        listener(Announcement("progress", "[/x]", {"fraction": 0.5, "minutes_left": 1.0}))
    said = capsys.readouterr().out
    assert "the file [/x] is wrong" in said
    assert "no report: [/x]" in said
    assert "\x1b" not in said


def test_the_console_shows_a_preflight_before_the_minutes_are_known(
    capsys: pytest.CaptureFixture[str],
) -> None:
    preflight = {"phase": "preflight", "fraction": 0.0, "minutes_left": None, "simulated_steps": 1400}
    with watching(Console(width=200)) as listener:
        listener(Announcement("progress", "preflight", preflight))
    said = capsys.readouterr().out
    assert "1400 steps simulated" in said
    with watching(Console(width=200)) as listener:
        listener(Announcement("progress", "", {"phase": "probe-check", "fraction": 0.0, "minutes_left": 64.2}))
    said = capsys.readouterr().out
    assert "64 min left" in said
    assert "probe-check" in said


def test_errors_are_printed_without_obeying_them(capsys: pytest.CaptureFixture[str]) -> None:
    fail(InputError(f"'{EVIL}' is not a number"))
    assert "\x1b" not in capsys.readouterr().err


def test_an_abort_that_could_not_be_sent_says_so(tmp_path: Path) -> None:
    """The settings name the state directory, in which the address of the service is."""
    (tmp_path / "volcal.toml").write_text("state_directory = [")
    refused = volcal("abort", "--config", tmp_path / "volcal.toml", exit_code=2).stderr
    assert "the abort was NOT sent" in refused
    assert "emergency stop" in refused


@pytest.mark.parametrize("content", [None, "nonsense"])
def test_an_abort_without_the_certificate_of_the_service_says_that_it_was_not_sent(
    tmp_path: Path, content: str | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("agent.service.client.read_address", lambda _: "https://127.0.0.1:1")
    config = tmp_path / "volcal.toml"
    named = '\n[service]\ncertificate_file = "cert.pem"\nkey_file = "key.pem"\n'
    config.write_text(CASE_STUDY.read_text() + named)
    if content is not None:
        (tmp_path / "cert.pem").write_text(content)
    refused = volcal("abort", "--config", config, exit_code=2).stderr
    assert "certificate" in refused
    assert "the abort was NOT sent" in refused
    assert "emergency stop" in refused


@pytest.mark.parametrize(
    ("reason", "sent"),
    [
        ("x" * 300, "x" * (MAX_REASON - 1) + "…"),
        ("", "volcal abort"),
        ("  ", "volcal abort"),
        ("Sp\udce4ne", "Sp\ufffdne"),
    ],
)
def test_the_command_sends_an_abort_whatever_its_reason(
    tmp_path: Path, reason: str, sent: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also one that was typed in a terminal with another encoding."""
    requests: list[httpx.Request] = []

    def connection(_: object) -> httpx.Client:
        def answer(request: httpx.Request) -> httpx.Response:
            requests.append(request)
            return httpx.Response(200, json={"taken": True})

        return httpx.Client(transport=httpx.MockTransport(answer), base_url="http://volcal.test")

    monkeypatch.setattr("agent.service.client._connect", connection)
    volcal("abort", "--reason", reason, "--config", CASE_STUDY)
    assert [json.loads(request.content) for request in requests] == [{"reason": sent}]
