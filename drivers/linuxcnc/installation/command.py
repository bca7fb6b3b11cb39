"""Command `volcal linuxcnc`: volcal's lines in the configuration of a LinuxCNC machine."""

from __future__ import annotations

from pathlib import Path

import click

from drivers.errors import InputError
from drivers.linuxcnc.installation import INSTALL_HELP
from drivers.linuxcnc.installation.changes import carry_out
from drivers.linuxcnc.installation.install import Installation, plan_installation, plan_removal

INI = click.argument("ini", type=click.Path(path_type=Path))
DRY_RUN = click.option("--dry-run", is_flag=True, help="Show the changes and write nothing.")


@click.group("linuxcnc", help=INSTALL_HELP)
def linuxcnc_group() -> None:
    pass


@linuxcnc_group.command("install")
@INI
@click.option(
    "--directory", type=click.Path(path_type=Path), help="For the tables [default: /var/lib/volcal/linuxcnc]."
)
@click.option("--probe-pin", metavar="PIN", help="HAL pin of the touch probe, if the machine has not connected one.")
@DRY_RUN
def install(*, ini: Path, directory: Path | None, probe_pin: str | None, dry_run: bool) -> None:
    """Add the lines that volcal needs to the INI file of a machine; a backup is kept, and nothing is added twice."""
    found = plan_installation(ini, directory=directory, probe_pin=probe_pin)
    if not dry_run and found.directory is not None:
        _create(found.directory)
    _report(found, dry_run=dry_run, unchanged="volcal is installed already; nothing was changed")


@linuxcnc_group.command("remove")
@INI
@DRY_RUN
def remove(*, ini: Path, dry_run: bool) -> None:
    """Take out what `install` has added; all other lines stay as they are now."""
    _report(plan_removal(ini), dry_run=dry_run, unchanged="volcal is not installed here; nothing was changed")


def _create(directory: Path) -> None:
    try:
        directory.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(
            f"the directory of the tables cannot be created: {error.strerror}; nothing was changed",
            hint=f"sudo mkdir -p {directory} && sudo chown $USER {directory}",
            file=str(directory),
        ) from None


def _report(found: Installation, *, dry_run: bool, unchanged: str) -> None:
    if not dry_run:
        carry_out(found.changes)
    for change in found.changes:
        click.echo(change.description())
    if not found.changes:
        click.echo(unchanged)
    elif dry_run:
        click.echo("nothing was written (--dry-run)")
    for note in found.notes:
        click.echo(f"note: {note}")
    if found.changes and not dry_run:
        click.echo("LinuxCNC reads this at its next start.")
