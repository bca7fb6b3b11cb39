"""Cross-check of a simulated calibration: what the estimate predicts for a laser interferometer and a ballbar, compared
with what virtual instruments measure on the simulated machine."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import click

from agent.cli.errors import fail
from agent.cli.printing import columns_table, results_console
from agent.cli.run_commands.simulator_process import SimulatorProcess
from agent.errors import MeasurementFault
from agent.files import write_all_atomically
from agent.printable import printable
from agent.results.run_outcome import Outcome
from agent.settings.schema import Settings
from agent.workpiece.instrument_comparison import ComparedFigure, InstrumentComparison, compare_with_instruments
from agent.workpiece.predicted_tests import AcceptanceRequest, predict_acceptance
from drivers.errors import VolcalError
from twin.units import UM_PER_MM

NAME = "cross-check"
_HEADINGS = ("standard", "figure", "table", "predicted / µm", "U (k = 2)", "measured / µm", "U (k = 2) ", "En", "")


@dataclass(frozen=True, eq=False)
class CrossCheck:
    """Cross-check that was attempted after a run. `compared` is None if the run has no estimate, or if the cross-check
    failed with `error`."""

    compared: InstrumentComparison | None = None
    error: VolcalError | None = None

    def as_json(self) -> dict[str, Any]:
        """Return the keys of the cross-check in the document of the run."""
        document: dict[str, Any] = {"cross_check": None if self.compared is None else self.compared.as_json()}
        return document if self.error is None else {**document, "cross_check_error": str(self.error)}

    def show(self) -> None:
        """Print the comparison, or why there is none."""
        if self.compared is not None:
            show_comparison(self.compared)
        if self.error is not None:
            results_console().print(f"no cross-check: {printable(str(self.error))}", markup=False)

    def conclude(self) -> None:
        """Print an error and end the program if the cross-check failed, or contradicts the prediction."""
        if self.error is not None:
            raise fail(self.error)
        if self.compared is not None:
            require_agreement(self.compared)


def attempt(outcome: Outcome, settings: Settings, simulator: SimulatorProcess, *, in_controller: bool) -> CrossCheck:
    """Cross-check a run that has ended, as `cross_checked` does. The result of the run is worth printing even if this
    fails, so an error is returned."""
    try:
        return CrossCheck(cross_checked(outcome, settings, simulator, in_controller=in_controller))
    except VolcalError as error:
        return CrossCheck(error=error)


def cross_checked(
    outcome: Outcome, settings: Settings, simulator: SimulatorProcess, *, in_controller: bool
) -> InstrumentComparison | None:
    """Return the comparison of the estimate of a run with the instruments; None if the run has no estimate.

    The machine is measured with its table only if the table was accepted and is `in_controller`. The figure
    ``cross-check.png`` and ``.svg`` is written into the folder of the run.
    """
    if outcome.estimation is None:
        click.echo("no cross-check: the run has no estimate", err=True)
        return None
    folder = settings.state_directory / outcome.run_id
    predicted = predict_acceptance(AcceptanceRequest(folder, None, False, None, (), None))
    proved = outcome.proof is not None and outcome.proof.accepted
    bank = int(simulator.ask("status")["active_bank"]) if proved and in_controller else None

    def ask(request: Mapping[str, Any]) -> Mapping[str, Any]:
        keys = dict(request)
        return simulator.ask(keys.pop("do"), **keys)

    compared = compare_with_instruments(predicted, ask, bank)
    from agent.workpiece.acceptance_figure import draw_comparison  # noqa: PLC0415  matplotlib takes a second to import

    drawn = draw_comparison(compared)
    write_all_atomically(folder, {f"{NAME}.png": drawn.png, f"{NAME}.svg": drawn.svg})
    return compared


def show_comparison(compared: InstrumentComparison) -> None:
    """Print the table of all figures and a sentence about their agreement."""
    table = columns_table(
        _HEADINGS,
        title="predicted from the estimate, and measured with a virtual laser interferometer and ballbar",
        whole=("standard", "figure"),
        numbers=_HEADINGS[3:8],
    )
    for figure in compared.figures:
        table.add_row(*_cells(figure))
    console = results_console()
    console.print(table)
    console.print(compared.text, markup=False)


def require_agreement(compared: InstrumentComparison) -> None:
    """Print an error and end the program if prediction and instruments contradict each other."""
    if compared.contradicts:
        raise fail(MeasurementFault(f"the prediction contradicts the instruments: {compared.text}"))


def _cells(figure: ComparedFigure) -> tuple[str, ...]:
    predicted, measured = figure.predicted, figure.measured
    return (
        figure.test.test.standard,
        figure.test.test.feature.name,
        "with" if figure.with_table else "without",
        f"{UM_PER_MM * predicted.expected_mm:.2f}",
        f"± {UM_PER_MM * predicted.expanded_mm:.2f}",
        f"{measured.value_um:.2f}",
        f"± {measured.expanded_um:.2f}",
        f"{figure.en:+.2f}",
        "agrees" if figure.agrees else "disagrees",
    )
