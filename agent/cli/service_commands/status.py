"""Command `volcal status`, which shows the current state of the machine and of the run in progress, as the service
reports it.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from datetime import datetime
from pathlib import Path
from typing import Any

import click

from agent.cli.errors import reported
from agent.cli.invocation import will_run
from agent.cli.options import config_option

if will_run():
    from agent.cli.printing import facts_table, readings_text, results_console
    from agent.service.client import Client
    from agent.settings.load import read_settings


@click.command("status")
@config_option
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object on stdout; with --watch one per line.")
@click.option("--watch", is_flag=True, help="Continue to print events.")
@reported
def status_command(config: Path, as_json: bool, watch: bool) -> None:
    """Show what the service is doing and which requests it accepts."""
    with Client(read_settings(config)) as client:
        if not watch:
            show(client.get("/api/status"), as_json=as_json)
            return
        for kind, document in client.events():
            if as_json:
                click.echo(json.dumps({"event": kind, **document}))
            elif kind == "status":
                show(document, as_json=False)
            else:
                click.echo(f"{kind:12} {document['text']}")


def show(status: Mapping[str, Any], *, as_json: bool) -> None:
    if as_json:
        click.echo(json.dumps(status))
        return
    title = f"{status['machine']}: {status['state']} ({status['packml']})"
    results_console().print(facts_table(_rows(status), title=title))


def _rows(status: Mapping[str, Any]) -> list[tuple[str, str]]:
    rows = [("doing", status["doing"])]
    if status["run_id"]:
        rows.append(("run", f"{status['run_id']}, {status['kind']}"))
        rows.append(("measured", f"{status['balls']} balls, {status['touches']} touches"))
    if status["minutes_left"] is not None:
        rows.append(("progress", f"{100.0 * status['fraction']:.0f} %, {status['minutes_left']:.0f} min left"))
    if status.get("phase"):  # a service of an earlier version knows neither phases nor receivers
        rows.append(("phase", _phase(status)))
    for name, key in (("VE without table", "ve_before_um"), ("VCE with table", "ve_now_um")):
        if status[key] is not None:
            rows.append((name, f"{status[key]:.2f} µm"))
    if status["active_bank"] is not None:
        rows.append(("active bank", str(status["active_bank"])))
    if status["written_not_active"] is not None:
        rows.append(("written, not active", f"bank {status['written_not_active']}"))
    if status.get("temperatures_c"):  # not of a service of an earlier version
        readings, age_s = readings_text(status["temperatures_c"]), status["temperatures_age_s"]
        rows.append(("temperatures", f"{readings}; read {age_s:.0f} s ago"))
    if status["unfinished"]:
        rows.append(("interrupted run", f"{status['unfinished']}; `volcal resume` resumes it"))
    if status["question"]:
        question = status["question"]
        rows.append((f"question {question['number']}", question["text"]))
    for one in status.get("receivers", ()):
        if one["problem"]:
            since = _since(one.get("since", ""))
            # a service of an earlier version does not tell the two apart
            how = "delivers in part" if one.get("delivery") == "partial" else "fails"
            rows.append((f"{one['channel']} {how}", f"{one['waiting']} waiting{since}: {one['problem']}"))
    rows += [(f"alarm {a['code']}", f"{a['text']}. {a['hint']}") for a in status["alarms"]]
    return [*rows, ("accepted requests", ", ".join(status["may"]) or "none")]


def _since(utc: str) -> str:
    return f" since {datetime.fromisoformat(utc).astimezone():%Y-%m-%d %H:%M}" if utc else ""


def _phase(status: Mapping[str, Any]) -> str:
    parts = [status["phase"]]
    if status["phase_fraction"] is not None:
        parts.append(f"{100.0 * status['phase_fraction']:.0f} %")
    if status["phase_minutes_left"] is not None:
        parts.append(f"{status['phase_minutes_left']:.0f} min left")
    if status["phase_fraction"] is None and status["simulated_steps"] and status["minutes_left"] is None:
        parts.append(f"{status['simulated_steps']} steps simulated")
    return ", ".join(parts)
