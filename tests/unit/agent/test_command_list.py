"""The list of commands imports no command, the help of a command nothing that only its run needs, and commands to the
service load neither mathematics nor drivers."""

from __future__ import annotations

import inspect
import subprocess
import sys
from collections.abc import Iterator
from importlib.metadata import EntryPoint, EntryPoints
from pathlib import Path

import click
import pytest
from click.testing import CliRunner
from journaled import SETTINGS, journaled

from agent.cli import invocation
from agent.cli import main as program
from agent.cli.main import LONGEST_HELP, OWN_COMMANDS, main
from agent.cli.table_commands.table import ROLES
from agent.runs.kinds.restoration import TABLE_ROLES
from twin.compensation.controllers.all_options import OPTIONS_OF_FORMATS
from twin.compensation.controllers.registry import FORMATS

SLOW = ("scipy", "matplotlib", "sqlalchemy", "fastapi", "pymodbus", "canopen")
NOT_FOR_A_LIST = (*SLOW, "numpy", "pydantic", "structlog", "asyncio", "rich", "simulators.cli")
NOT_FOR_A_HELP_TEXT = (*SLOW, "numpy", "pydantic", "structlog", "asyncio", "rich", "jinja2")
OF_THE_FIELDS: dict[tuple[str, ...], tuple[str, ...]] = {("init",): ("numpy",)}
"""What the options of a command are made of: those of the set-up come from the table of its fields."""
NOT_FOR_THE_HISTORY = (
    *(
        "numpy",
        "scipy",
        "matplotlib",
        "jinja2",
        "structlog",
        "fastapi",
        "sqlalchemy.orm",
        "sqlalchemy.dialects.postgresql",
    ),
    *("agent.planning", "twin.identification", "drivers.roles"),
)


def loaded_by(statement: str) -> list[str]:
    """Return the names of the modules that a fresh interpreter has loaded after `statement`."""
    text = f"{statement}\nimport sys; print(*sys.modules, file=sys.stderr)"
    done = subprocess.run([sys.executable, "-c", text], capture_output=True, text=True, check=True)
    return done.stderr.split()


def leaves(command: click.Command) -> Iterator[click.Command]:
    """Yield `command`, or the commands of a group, and the group itself if it does something without a command."""
    if isinstance(command, click.Group):
        for inner in command.commands.values():
            yield from leaves(inner)
    if not isinstance(command, click.Group) or command.invoke_without_command:
        yield command


def paths(command: click.Command, *before: str) -> Iterator[tuple[str, ...]]:
    """Yield the words that call `command` and, if it is a group, those that call each of its commands."""
    yield before
    if isinstance(command, click.Group):
        context = click.Context(command)
        for name in command.list_commands(context):
            inner = command.get_command(context, name)
            assert inner is not None
            yield from paths(inner, *before, name)


@pytest.mark.parametrize("name", OWN_COMMANDS)
def test_a_command_s_function_takes_its_options_by_name(name: str) -> None:
    """No type checker sees that an option's name and the parameter are the same word."""
    command = main.get_command(click.Context(main), name)
    assert command is not None
    for leaf in leaves(command):
        assert leaf.callback is not None
        accepted = inspect.signature(leaf.callback).parameters.values()
        named = {parameter.name for parameter in accepted if parameter.kind is not parameter.VAR_KEYWORD}
        passed = {parameter.name for parameter in leaf.params if parameter.expose_value}
        takes_others = any(parameter.kind is parameter.VAR_KEYWORD for parameter in accepted)
        assert named - {"ctx"} <= passed, leaf.name
        assert passed <= named or takes_others, leaf.name


@pytest.mark.parametrize("name", OWN_COMMANDS)
def test_the_list_repeats_the_first_sentence_of_a_command_s_help(name: str) -> None:
    command = main.get_command(click.Context(main), name)
    assert command is not None
    assert command.name == name
    assert OWN_COMMANDS[name].help == command.get_short_help_str(LONGEST_HELP)


def test_the_help_lists_own_commands_and_those_of_other_packages() -> None:
    said = main.get_help(click.Context(main))
    for name in (*OWN_COMMANDS, "simulate"):
        assert f"\n  {name} " in said
    assert "..." not in said.partition("Commands:")[2]


def test_the_list_of_commands_imports_none_of_them() -> None:
    loaded = loaded_by("from agent.cli.main import main\nmain(['--help'], standalone_mode=False)")
    assert "agent.cli.main" in loaded
    assert [name for name in NOT_FOR_A_LIST if name in loaded] == []
    own = {name for name in loaded if name.startswith("agent.cli.")}
    assert own == {"agent.cli.errors", "agent.cli.invocation", "agent.cli.main"}


def help_of_process(*words: str) -> tuple[str, list[str]]:
    """Return what the program prints, called with `words`, and the names of the modules that it has loaded then."""
    text = (
        "import atexit, sys\n"
        "atexit.register(lambda: print(*sys.modules, file=sys.stderr))\n"
        f"sys.argv = {['volcal', *words]!r}\n"
        "from agent.cli.main import main\n"
        "main(prog_name='volcal', terminal_width=80)"
    )
    done = subprocess.run([sys.executable, "-c", text], capture_output=True, text=True, check=True)
    return done.stdout, done.stderr.split()


@pytest.mark.parametrize("words", tuple(paths(main)), ids=" ".join)
def test_the_help_of_a_command_waits_for_nothing_that_only_its_run_needs(words: tuple[str, ...]) -> None:
    """It is the help that a process shows which has imported everything."""
    shown, loaded = help_of_process(*words, "--help")
    assert shown == CliRunner().invoke(main, [*words, "--help"], prog_name="volcal").output
    needed = OF_THE_FIELDS.get(words, ())
    assert [name for name in NOT_FOR_A_HELP_TEXT if name in loaded and name not in needed] == []


@pytest.mark.parametrize(
    "words",
    [
        ["-v", "plan", "--config", "nowhere.toml", "--help"],
        ["plan", "--help", "--no-such-option"],
        ["plan", "--config", "--help"],
    ],
    ids=" ".join,
)
def test_help_is_shown_wherever_it_is_asked_for(words: list[str]) -> None:
    assert help_of_process(*words)[0] == CliRunner().invoke(main, ["plan", "--help"], prog_name="volcal").output


def test_a_word_after_two_hyphens_asks_for_no_help(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(invocation._Process, "shows_help", False)
    assert invocation.program_arguments(["report", "--", "--help"]) == ["report", "--", "--help"]
    assert invocation.will_run()
    assert invocation.program_arguments(["-v", "report", "last", "--help"]) == ["report", "last", "--help"]
    assert not invocation.will_run()


def test_the_words_that_options_offer_are_those_of_what_they_choose() -> None:
    """They stand apart from it, because it is slow to import."""
    assert ROLES == TABLE_ROLES
    assert tuple(OPTIONS_OF_FORMATS) == tuple(FORMATS)


def test_the_list_of_runs_waits_for_no_mathematics() -> None:
    loaded = loaded_by("import agent.cli.history")
    assert "sqlalchemy" in loaded
    assert [name for name in NOT_FOR_THE_HISTORY if name in loaded] == []


@pytest.mark.parametrize("fed", [False, True], ids=["to be fed", "fed"])
def test_listing_the_runs_loads_no_mathematics(fed: bool, tmp_path: Path) -> None:
    """Neither the settings nor the runs of the journal need it, whether or not the history has them already."""
    state = tmp_path / "state"
    journaled(state, 0)
    config = tmp_path / "volcal.toml"
    roles = "".join(f'{role} = "twin"\n' for role in ("machine", "probe", "store", "thermometer", "operator", "mount"))
    config.write_text(
        f'machine = "{SETTINGS["machine"]}"\nartefact = "{SETTINGS["artefact"]}"\nstate_directory = "{state}"\n'
        f'[devices.twin]\ndriver = "simulated"\n[roles]\n{roles}[stations]\nplaces_mm = [[700.0, 1000.0, 750.0]]\n'
    )
    call = ["history", "list", "--config", str(config)]
    if fed:
        assert CliRunner().invoke(main, call).exit_code == 0
    loaded = loaded_by(f"from agent.cli.main import main\nmain({call!r}, standalone_mode=False)")
    assert (state / "history.sqlite").is_file()
    assert [name for name in NOT_FOR_THE_HISTORY if name in loaded] == []


@pytest.mark.parametrize("name", [name for name, command in OWN_COMMANDS.items() if not command.logs])
def test_commands_that_say_so_load_nothing_that_logs(name: str) -> None:
    module = OWN_COMMANDS[name].import_path.partition(":")[0]
    assert "structlog" not in loaded_by(f"import {module}")


def test_help_of_another_package_s_command_is_declared(monkeypatch: pytest.MonkeyPatch) -> None:
    """The declared line is shown; a command without one is still listed, and neither is imported."""
    declared = {
        program.COMMAND_GROUP: EntryPoints(
            [
                EntryPoint("simulate", "nowhere.at_all:command", program.COMMAND_GROUP),
                EntryPoint("silent", "nowhere.at_all:command", program.COMMAND_GROUP),
            ]
        ),
        program.HELP_GROUP: EntryPoints([EntryPoint("simulate", "simulators:SIMULATE_HELP", program.HELP_GROUP)]),
    }
    monkeypatch.setattr(program, "_declared", declared.__getitem__)
    lines = main.get_help(click.Context(main)).splitlines()
    assert any(line.split() == ["silent"] for line in lines)
    (shown,) = (line for line in lines if line.startswith("  simulate "))
    assert shown.split(maxsplit=1)[1] == "Run the simulated machine on real links until it is stopped."


def test_the_declared_help_of_the_simulator_is_that_of_its_command() -> None:
    from simulators import SIMULATE_HELP
    from simulators.cli import simulate

    assert simulate.get_short_help_str(LONGEST_HELP) == SIMULATE_HELP


@pytest.mark.parametrize(
    ("words", "suggestion"),
    [
        (["claibrate"], "No such command 'claibrate'. Did you mean 'calibrate'?"),
        (["simulat"], "No such command 'simulat'. Did you mean 'simulate'?"),
        (["history", "lst"], "No such command 'lst'. Did you mean 'list'?"),
        (["table", "shwo"], "No such command 'shwo'. Did you mean 'show'?"),
        (["xyzzy"], "No such command 'xyzzy'.\n"),
        (["status", "--wach"], "'--watch'"),
        (["--verbos", "status"], "'--verbose'"),
    ],
    ids=" ".join,
)
def test_a_mistyped_command_or_option_is_answered_with_the_nearest(words: list[str], suggestion: str) -> None:
    done = CliRunner().invoke(main, words)
    assert done.exit_code == 2
    assert suggestion in done.output


@pytest.mark.parametrize(
    "words",
    [["pair", "--name", "Werk\udce4"], ["plan", "--config", "\udcff.toml"], ["history", "list", "--machine", "\udc80"]],
)
def test_arguments_that_are_no_text_are_refused(words: list[str]) -> None:
    done = CliRunner().invoke(main, words)
    assert done.exit_code == 2
    assert "is no text in UTF-8" in done.output


@pytest.mark.parametrize(
    "module",
    ["agent.cli.service_commands.requests", "agent.cli.service_commands.start", "agent.cli.service_commands.status"],
)
def test_commands_that_stop_a_machine_wait_for_no_import(module: str) -> None:
    loaded = loaded_by(f"import {module}")
    assert module in loaded
    assert [name for name in SLOW if name in loaded] == []
