"""`python -m simulators.linuxcnc`: an unmodified LinuxCNC with a simulated machine around it.

The program runs until standard input ends.

The first line on standard output is one JSON object. Its key `pid` gives the id of a process; other programs must enter
the namespaces of this process. The object also gives the addresses of the control channel and of the CAN bus, which are
valid inside these namespaces.
"""

from __future__ import annotations

import json
import shutil
import signal
import subprocess
import sys
from pathlib import Path
from types import FrameType

import click

from drivers.errors import ConfigurationError, VolcalError
from simulators.linuxcnc.machine import LinuxCncMachine, build
from simulators.linuxcnc.namespaces import first_child, unavailable_reason, unshare_command
from simulators.scenario import read_scenario

EMPTY = ("machine.var",)
TABLES = "tables"
PATH = click.Path(path_type=Path)


@click.command()
@click.option("--scenario", type=PATH, required=True, help="Scenario file (TOML).")
@click.option("--configuration", type=PATH, required=True, help="Directory of the INI and HAL files.")
@click.option("--components", type=PATH, required=True, help="Directory of the driver's HAL components.")
@click.option("--work", type=PATH, required=True, help="Working directory for all generated files.")
@click.option("--ini", default="machine.ini", show_default=True, help="INI file in the configuration directory.")
@click.option(
    "--speed",
    type=click.FloatRange(0.1, 100.0),
    default=1.0,
    show_default=True,
    help="Speed as a multiple of real time.",
)
@click.option("--inside", is_flag=True, hidden=True)
def run(
    *, scenario: Path, configuration: Path, components: Path, work: Path, ini: str, speed: float, inside: bool
) -> None:
    """Compile the components, start LinuxCNC, switch it on and home it, then serve clients."""
    try:
        if inside:
            _serve(scenario, work.resolve(), ini, speed)
            return
        reason = unavailable_reason()
        if reason:
            raise click.ClickException(f"LinuxCNC cannot run here: {reason}")
        prepare_work_directory(configuration, components, work.resolve())
        build(components.resolve(), work.resolve() / "build")
    except VolcalError as error:
        raise click.ClickException(str(error)) from None
    raise SystemExit(_in_namespaces(sys.argv[1:]))


def _in_namespaces(arguments: list[str]) -> int:
    """Run this program again in namespaces of its own, and add to its ready line the process id needed to enter
    them.
    """
    command = unshare_command([sys.executable, "-m", "simulators.linuxcnc", *arguments, "--inside"])
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:  # noqa: S603  our own program
        assert process.stdout is not None  # noqa: S101  a pipe was requested above
        line = process.stdout.readline()
        if line:
            click.echo(json.dumps({"pid": first_child(process.pid)} | json.loads(line)))
        return process.wait()


def _serve(scenario: Path, work: Path, ini: str, speed: float) -> None:
    def end(number: int, _: FrameType | None) -> None:
        raise SystemExit(128 + number)

    signal.signal(signal.SIGTERM, end)
    with LinuxCncMachine(read_scenario(scenario.resolve()), work, ini, speed=speed) as machine:
        click.echo(json.dumps(machine.ready_line()))
        while sys.stdin.buffer.read(4096):
            pass  # the content has no meaning; only the end of the stream counts


def prepare_work_directory(configuration: Path, components: Path, work: Path) -> None:
    """Copy the INI, HAL (hardware abstraction layer) and tool files of a LinuxCNC configuration and the HAL files of
    the components to `work`.

    A directory for compensation tables is created as well. The agent's settings are not copied.
    """
    if not configuration.is_dir():
        raise ConfigurationError("no such directory", file=str(configuration))
    work.mkdir(parents=True, exist_ok=True)
    work.chmod(0o777)  # parts of LinuxCNC run as another user
    for file in (*configuration.iterdir(), *components.glob("*.hal")):
        if file.is_file() and file.suffix != ".toml":
            shutil.copy(file, work)
    for name in EMPTY:
        (work / name).touch()
        (work / name).chmod(0o666)
    (work / TABLES).mkdir(exist_ok=True)
    (work / TABLES).chmod(0o777)


if __name__ == "__main__":
    run()
