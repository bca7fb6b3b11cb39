"""Command `volcal resume`, which resumes or abandons an interrupted run, that is, a run that ended because its process
ended.
"""

from __future__ import annotations

import json
from pathlib import Path

import click

from agent.cli.errors import fail, reported
from agent.cli.invocation import will_run
from agent.cli.options import config_option
from agent.lasting_output import lasting_output

if will_run():
    from rich.console import Console

    from agent.cli.printing import results_console
    from agent.cli.run_commands.local_run import conclude, interruptible
    from agent.cli.run_commands.night_options import night_table
    from agent.cli.run_commands.progress import watching
    from agent.cli.run_commands.run_summary import show_summary
    from agent.cli.run_commands.trial import show_trial
    from agent.cli.service_commands.requests import resumed_by_service, settled_by_service
    from agent.errors import MeasurementFault
    from agent.execution.device_assembly import assemble, closing_clock, make_clock
    from agent.execution.run_lock import run_lock
    from agent.results.run_outcome import Decision
    from agent.runs.other_machine import require_own_state_directory
    from agent.runs.reconcile import reconcile
    from agent.runs.reconcile_result import CompensationState, ReconcileAction, Reconciliation
    from agent.runs.resume.abandon import abandon as abandon_run
    from agent.runs.resume.resume import resume
    from agent.runs.run_context import RunHooks
    from agent.runs.session import RunResult
    from agent.settings.load import load_settings
    from agent.settings.schema import Settings
    from drivers.errors import StoreError


NO_UNPROVED_TABLE = "no table was active that was never proved"
"""What is printed as found if the service has given up a run that had activated no table."""


@click.command("resume")
@config_option
@click.option(
    "--give-up", "abandon", is_flag=True, help="Do not resume: reactivate the previous table and end the run."
)
@click.option(
    "--restore",
    is_flag=True,
    help="Do not resume: try to reactivate the previous table; the run can still be resumed.",
)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object on stdout at the end.")
@lasting_output()
@reported
def resume_command(config: Path, abandon: bool, restore: bool, as_json: bool) -> None:
    """Resume the interrupted run; completed measurements are not repeated.

    If the service is running, it resumes the run, also after a hold; otherwise the run resumes in this process. The run
    uses the settings and files with which it started; a file that has changed since is refused. The settings given here
    only name the state directory with the journal.
    """
    if abandon and restore:
        raise click.UsageError("--restore and --give-up exclude each other: --give-up also tries to restore")
    settings = load_settings(config)
    if abandon or restore:
        _settle(settings, config.resolve().parent, give_up=abandon, as_json=as_json)
        return
    if resumed_by_service(settings):
        return
    require_own_state_directory(settings)
    with watching(Console(stderr=True)) as listener, interruptible() as signals:
        ended = resume(settings.state_directory, RunHooks(announce=listener, attach=signals.attach))
    _show_and_exit(ended, as_json=as_json)


def _show_and_exit(ended: RunResult, *, as_json: bool) -> None:
    """Print the outcome and exit. The exit code is the one with which the command that started the run would have
    ended.
    """
    outcome = ended.outcome
    if as_json:
        click.echo(json.dumps(outcome.as_json(), allow_nan=False))
    else:
        if outcome.night is not None:
            results_console().print(night_table(outcome, outcome.night))
        if outcome.trial is not None:
            show_trial(outcome, outcome.trial)
        if outcome.kind == "calibrate" or outcome.estimation is not None:
            show_summary(outcome)
    if ended.error is not None:
        raise fail(ended.error)
    decision = None if outcome.night is None else outcome.night.decision
    if outcome.kind == "verify":
        if decision is Decision.OUT:
            raise fail(MeasurementFault(f"out of limits: {outcome.night.reason if outcome.night else ''}"))
    elif outcome.trial is None and decision in (None, Decision.WRITTEN, Decision.RESTORED, Decision.FULL_DONE):
        conclude(ended)


def _settle(settings: Settings, base: Path, *, give_up: bool, as_json: bool) -> None:
    """Try to reactivate the previous table, print what was found and done, and with `give_up` end the run.

    If the service is running, it does it; otherwise it is done in this process.
    """
    answered = settled_by_service(settings, give_up=give_up)
    if answered is not None:
        former, now = answered["former"], answered["now"]
        run, found, done = former["unfinished"], NO_UNPROVED_TABLE, ReconcileAction.NOTHING.value
        if former["unproved"] is not None:
            run, found = former["unproved"]["run_id"], CompensationState.UNPROVED.value
            done = ReconcileAction.RESTORED.value
        _print_settled(run, found, done, "", now["active_bank"], now["written_not_active"], as_json=as_json)
        return
    require_own_state_directory(settings)
    with (
        run_lock(settings.state_directory, "to be given up" if give_up else "whose former table is reactivated"),
        closing_clock(make_clock(settings.clock)) as clock,
    ):
        rig = assemble(settings, clock, base)
        rig.open()
        try:
            if give_up:
                result = abandon_run(rig, settings.state_directory, "volcal resume --give-up")
            else:
                result = reconcile(rig, settings.state_directory)
        finally:
            rig.close()
    run = None if result.unfinished is None else result.unfinished.run_id
    if as_json:
        facts = (run, result.state.value, result.action.value, result.instruction)
        _print_settled(*facts, result.active_bank, result.waiting_bank, as_json=True)
    elif result.action is not ReconcileAction.LEFT:
        click.echo(f"{'no run is unfinished' if run is None else f'run {run}'}: {result.text}")
    if result.action is ReconcileAction.LEFT:
        raise fail(_unsettled(result, give_up=give_up))


def _print_settled(
    run: str | None, found: str, done: str, person: str, active: int, waiting: int | None, *, as_json: bool
) -> None:
    if as_json:
        facts = {"run_id": run, "found": found, "done": done, "person": person}
        click.echo(json.dumps({**facts, "active_bank": active, "waiting_bank": waiting}))
    else:
        click.echo(f"run {run}: {found}; {done} (bank {active} is active)")


def _unsettled(result: Reconciliation, *, give_up: bool) -> StoreError:
    reason = f": {result.refused}" if result.refused else ""
    if result.unproved is None or not result.refused:
        return StoreError(f"the previous table could not be reactivated{reason}", hint=result.instruction)
    if give_up:
        message = f"the run has ended, but {result.unproved.situation}{reason}"
        return StoreError(message, hint=f"{result.unproved.at_the_controller}; until then no run starts")
    return StoreError(f"{result.unproved.situation}{reason}", hint=result.instruction)
