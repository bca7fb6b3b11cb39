"""Consent to write a table although the machine has changed.

The request of the run contains the consent, or the operator is asked for it.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import Enum

from agent.results.gates.gate import Gate
from agent.results.gates.gate_rules import CHANGE
from drivers.roles import OperatorRequest, OperatorTask


class Consent(Enum):
    ASK = "ask"
    GIVEN = "given"
    REFUSED = "refused"


def opens_by_consent(gate: Gate, consent: Consent) -> bool:
    """Return True if `gate` is the gate `CHANGE` (limit of the machine's change), did not pass, and the request of the
    run already contains the consent."""
    return gate.name == CHANGE and not gate.passed and consent is Consent.GIVEN


def consent_request(gates: Sequence[Gate]) -> OperatorRequest:
    """Return the request for consent to a changed machine, which names the closed gate among `gates`."""
    closed = "; ".join(gate.text for gate in gates if not gate.passed)
    text = f"The machine is not what it was: {closed}. Write the new compensation table?"
    return OperatorRequest(OperatorTask.CONSENT, text)
