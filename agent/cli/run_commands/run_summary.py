"""Result of a calibration as text on the terminal."""

from __future__ import annotations

from agent.cli.printing import facts_table, results_console, travel_rows
from agent.execution.states import RunState
from agent.results.homing_scatter import after_homing_text
from agent.results.run_outcome import Outcome


def show_summary(outcome: Outcome) -> None:
    """Print the result of a run as text.

    The path of the run's report file is printed on a separate line and is never truncated.
    """
    console = results_console()
    console.print(facts_table(_rows(outcome), title=f"{outcome.run_id}: {outcome.verdict.word['en']}"))
    console.print(f"report: {outcome.report or 'none'}", markup=False)


def _rows(outcome: Outcome) -> list[tuple[str, str]]:
    rows = [
        ("verdict", f"{outcome.verdict.sign} {outcome.verdict.sentence['en']}"),
        ("position set", f"{outcome.position_set}, {outcome.formulation}"),
        ("measured", f"{outcome.touches} touches; {outcome.balls} ball centres in the estimate"),
        *time_rows(outcome),
    ]
    if outcome.estimation is not None:
        estimation, estimate = outcome.estimation, outcome.estimation.estimate
        rows += [
            ("VE without table", f"{estimation.volumetric.before_aligned.value_um:.2f} µm (aligned)"),
            ("VCE with table, predicted", f"{estimation.volumetric.after_aligned.value_um:.2f} µm (aligned)"),
            ("temperature", estimation.thermometer.short_text),
            *travel_rows(estimation.travel),
            ("rank", f"{estimate.rank} of {estimate.model.size} parameters"),
        ]
    if outcome.proof is not None:
        proof = outcome.proof
        text = f"{proof.before_um:.2f} → {proof.after_um:.2f} µm, predicted {proof.predicted_um:.2f} µm"
        rows.append(("held-out positions", text))
        rows.append(("proof", proof.reason))
    if outcome.confirmed is not None:
        rows.append(("held-out positions", f"{outcome.confirmed.held_out_um:.2f} µm with the active compensation"))
        rows.append(("decision", outcome.confirmed.text))
    if outcome.night is None:
        rows += homing_rows(outcome)
    if outcome.state in (RunState.COMPLETE, RunState.REFUSED):
        rows.append(("active bank", str(outcome.table_bank)))
    return rows


def homing_rows(outcome: Outcome) -> list[tuple[str, str]]:
    """Return a row about the accuracy after the next homing; none if the run says nothing about the accuracy."""
    if outcome.ve_now is None:
        return []
    return [("after a homing", after_homing_text(outcome.after_homing_record))]


def time_rows(outcome: Outcome) -> list[tuple[str, str]]:
    """Return rows about the machine time of a run: its forecast, what it took, and both by phase."""
    time = outcome.run_time
    if time is None:
        return [("machine time", f"{outcome.machine_minutes:.1f} min")]
    return [("machine time", time.text), ("of which (forecast)", time.phases_text)]
