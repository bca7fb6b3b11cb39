"""Comparison of the compensation in the controller with the journal, between runs."""

from __future__ import annotations

from agent.errors import PlanRefused
from agent.runs.reconcile_result import Reconciliation
from agent.service.owner.owner_parts import OwnerParts
from agent.settings.schema import Settings
from drivers.errors import VolcalError


class TableComparison:
    """Comparison of the compensation in the controller with the journal.

    It is made once after the start of the service, and again after every run that ended aborted or faulted. While a
    table is active that was never proved, each start and each reset compares again.
    """

    def __init__(self, parts: OwnerParts) -> None:
        self._parts = parts
        self._done = False

    def make(self, settings: Settings) -> None:
        """Compare, if that is due. If an active table has not yet been confirmed by measurements, reactivate the table
        that was active before it. Raise DeviceError if the machine cannot be reached; the comparison is still due
        then."""
        if not self._done:
            self.show(self._parts.machine.reconcile(settings, self._parts.config.parent))

    def make_or_forget_bank(self, settings: Settings) -> None:
        """Do the same as `make`. If the machine cannot be reached, the active bank is not known from then on, so that
        the next reading compares."""
        try:
            self.make(settings)
        except VolcalError as error:
            self._parts.board.show_bank(None, error.message)
            raise

    def show(self, found: Reconciliation) -> None:
        """Show the result of a comparison."""
        self._done = found.unproved is None
        self._parts.board.show_reconciliation(found)

    def repeat(self) -> None:
        """Let the comparison be due again."""
        self._done = False

    def require_proved_table(self) -> None:
        """Raise PlanRefused if a table is active that was never proved and could not be taken back. A new run would
        take it for the intended compensation of the machine."""
        unproved = self._parts.board.status().unproved
        if unproved is not None:
            raise PlanRefused(unproved.situation, hint=unproved.way_out)
