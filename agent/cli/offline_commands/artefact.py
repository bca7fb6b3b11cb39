"""Command `volcal artefact import`, which reads the digital calibration certificate of an artefact. It contacts no
device."""

from __future__ import annotations

import json
from pathlib import Path

import click

from agent.cli.errors import VolcalGroup, reported
from agent.cli.invocation import will_run
from agent.cli.options import PATH

if will_run():
    import datetime

    from agent.certificates.artefact_import import ImportRequest, import_certificate
    from agent.files import write_all_atomically
    from agent.printable import printable
    from drivers.clock import utc_timestamp
    from drivers.errors import InputError


@click.group("artefact", cls=VolcalGroup)
def artefact_group() -> None:
    """Import the digital calibration certificate of an artefact."""


@artefact_group.command("import")
@click.argument("certificate", type=PATH, metavar="DCC.xml")
@click.option(
    "--like",
    type=PATH,
    required=True,
    metavar="FILE",
    help="Artefact file (TOML) of the same artefact, with its holders and bodies and the frame of the mount.",
)
@click.option(
    "--out", type=PATH, required=True, metavar="FILE", help="Artefact file to write; it may be that of --like."
)
@click.option(
    "--trusted",
    type=PATH,
    multiple=True,
    metavar="CERT.pem",
    help="Certificate of the signer or of its authority; without it, the signer is not checked. May be repeated.",
)
@click.option(
    "--ignore",
    "ignored",
    multiple=True,
    metavar="NAME",
    help="Name, identity or refType of a result or a quantity that the artefact does not need. May be repeated.",
)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object on stdout.")
@reported
def import_command(
    certificate: Path, like: Path, out: Path, trusted: tuple[Path, ...], ignored: tuple[str, ...], as_json: bool
) -> None:
    """Write the artefact file of the digital calibration certificate DCC.xml, with its covariance beside it.

    The certificate gives the balls with their uncertainties; holders, bodies and the frame of the mount come from
    --like. A signature is always checked, and a certificate that is not understood in full is refused.
    """
    if out.suffix != ".toml":
        raise InputError("the artefact file must end in .toml", hint="choose another name for --out", file=str(out))
    today = datetime.datetime.fromisoformat(utc_timestamp()).date()
    found = import_certificate(ImportRequest(certificate, like, out, ignored, trusted), today)
    write_all_atomically(out.parent, found.files)
    written = [str(out.parent / name) for name in found.files]
    for warning in found.warnings:
        click.echo(f"warning: {printable(warning)}", err=True)
    if as_json:
        click.echo(json.dumps(found.as_json() | {"files": written}, allow_nan=False))
        return
    click.echo(printable(found.artefact.certificate))
    click.echo(
        f"{found.artefact.count} balls, largest standard uncertainty {found.largest_uncertainty_um:.2f} µm, "
        f"largest change {1e3 * found.moved_mm:.1f} µm"
    )
    for key, before, after in found.changes:
        click.echo(f"{key}: {before:g} → {after:g}")
    click.echo("\n".join(written))
