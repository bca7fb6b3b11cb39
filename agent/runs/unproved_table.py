"""A table that is active although no measurement has proved it, and the ways out in their order.

This happens if a run is stopped during the proof and the former table cannot be reactivated. The command line, the
service and the page take their words from here.
"""

from __future__ import annotations

from dataclasses import dataclass

GIVEN_UP = "given_up"
"""Kind of the event with which a run ends whose unproved table was left to the operator."""


@dataclass(frozen=True)
class UnprovedTable:
    """Unproved table of the run `run_id` in `bank`. `former_bank` is the bank that was active before; 0 is no
    compensation. `provable` is True if the run can be resumed and then proves its table."""

    run_id: str
    bank: int
    former_bank: int
    provable: bool

    @property
    def situation(self) -> str:
        return f"bank {self.bank} is active with a table of run {self.run_id} that was never proved"

    @property
    def retry(self) -> str:
        if self.former_bank == 0:
            return "`volcal resume --restore` tries again to switch the compensation off, as it was before"
        return f"`volcal resume --restore` tries again to make the former table (bank {self.former_bank}) active"

    @property
    def proof(self) -> str:
        if not self.provable:
            return f"run {self.run_id} has ended and cannot prove its table"
        return f"`volcal resume` resumes run {self.run_id}, which proves the table by fresh measurements"

    @property
    def give_up(self) -> str:
        last = "`volcal resume --give-up` tries it a last time and ends the run"
        return f"{last}; if it still fails, {self.at_the_controller}"

    @property
    def at_the_controller(self) -> str:
        """Action of the operator at the controller if volcal cannot reactivate the former table."""
        if self.former_bank == 0:
            return "switch the compensation off at the controller (bank 0)"
        return f"activate bank {self.former_bank} at the controller"

    @property
    def way_out(self) -> str:
        """Ways out in one line, in the order in which they are tried."""
        return f"{self.retry}; if that fails, {self.proof}; else {self.give_up}"
