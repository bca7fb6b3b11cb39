"""Consent to write a table although the machine has changed.

The request of the run contains the consent, or the operator is asked for it.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import Enum

from agent.execution.steps import AskOperator, Plan
from agent.results.gates import CHANGE, Gate
from drivers.roles import OperatorRequest, OperatorTask


class Consent(Enum):
    ASK = "ask"
    GIVEN = "given"
    REFUSED = "refused"


def opens_by_consent(gate: Gate, consent: Consent) -> bool:
    """Return True if `gate` is the gate `CHANGE` (limit of the machine's change), did not pass, and the request of the
    run already contains the consent."""
    return gate.name == CHANGE and not gate.passed and consent is Consent.GIVEN


def ask_consent(gates: Sequence[Gate]) -> Plan[bool]:
    """Ask the operator for consent to a changed machine if `CHANGE` (limit of the machine's change) is the only one of
    `gates` that did not pass. Return True if the operator consents.

    In all other cases, the operator is not asked and the result is False. Raises Aborted if the operator answers no.
    """
    closed = [gate for gate in gates if not gate.passed]
    if [gate.name for gate in closed] != [CHANGE]:
        return False
    text = f"The machine is not what it was: {closed[0].text}. Write the new compensation table?"
    yield AskOperator("consent/change", OperatorRequest(OperatorTask.CONSENT, text))
    return True
