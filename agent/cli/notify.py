"""Command `volcal notify`, which sends a test notice to the receivers of the settings."""

from __future__ import annotations

import json
from pathlib import Path

import click

from agent.cli.errors import reported
from agent.cli.invocation import will_run
from agent.cli.options import config_option

if will_run():
    from agent.cli.printing import facts_table, results_console
    from agent.model_files import load_machine
    from agent.notifications.channels import open_channels
    from agent.notifications.connection import DeliveryFailed
    from agent.notifications.wording import trial_notice
    from agent.settings.load import naming, read_settings
    from drivers.errors import ConfigurationError


@click.command("notify")
@config_option
@click.option("--to", type=click.Choice(["mqtt", "webhook", "mail"]), multiple=True, help="Only this receiver.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object on stdout.")
@reported
def notify_command(config: Path, to: tuple[str, ...], as_json: bool) -> None:
    """Send a test notice to every receiver of the settings, once and without the service.

    The exit status is 3 if a receiver does not take it.
    """
    settings = read_settings(config)
    told = settings.notifications
    with naming(config):
        missing = [name for name in to if name not in told.channels]
        if missing or not told.channels:
            raise ConfigurationError(
                f"the settings name no receiver {missing[0] if missing else ''}".strip(),
                key=".".join(("notifications", *missing[:1])),
                hint="add one of the sections [notifications.mqtt], [notifications.webhook], [notifications.mail]",
            )
        left_out = told.channels.keys() - set(to or told.channels)  # their files may be out of reach here
        channels = open_channels(told.model_copy(update=dict.fromkeys(left_out)))
        notice = trial_notice(load_machine(settings.machine).name, told.language)
    results: dict[str, str] = {}
    for name, channel in channels.items():
        try:
            results[name] = channel.send(notice)
        except DeliveryFailed as error:
            results[name] = str(error)
    if as_json:
        click.echo(json.dumps({name: {"taken": not text, "problem": text} for name, text in results.items()}))
    else:
        rows = [(name, text or "taken") for name, text in results.items()]
        results_console().print(facts_table(rows, title=notice.subject))
    if any(results.values()):
        raise SystemExit(DeliveryFailed.exit_code)
