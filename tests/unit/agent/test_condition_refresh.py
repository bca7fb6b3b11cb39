"""Arguments of a ConditionRefresh that a client of the OPC UA server may send."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import pytest
from asyncua import ua
from asyncua.ua.status_codes import StatusCodes

from agent.service.opcua.guard import GuardedSession

REFRESH, REFRESH_2 = ua.ObjectIds.ConditionType_ConditionRefresh, ua.ObjectIds.ConditionType_ConditionRefresh2
OWN, FOREIGN, ITEM = 7, 8, 3
SESSION = SimpleNamespace(
    session_id="mine",
    subscription_service=SimpleNamespace(
        subscriptions={OWN: SimpleNamespace(session_id="mine"), FOREIGN: SimpleNamespace(session_id="other")}
    ),
)


def refusal(method: int, *values: Any) -> ua.CallMethodResult | None:
    """Return the answer of the session with the id `mine` to a request that came over the wire."""
    request = ua.CallMethodRequest(
        MethodId=ua.NodeId(ua.Int32(method)), InputArguments=[ua.Variant(value) for value in values]
    )
    return GuardedSession._refresh_refusal(cast(GuardedSession, SESSION), request)


def code(method: int, *values: Any) -> int:
    refused = refusal(method, *values)
    assert refused is not None
    return int(refused.StatusCode.value)


def test_only_a_subscription_of_the_session_may_be_refreshed() -> None:
    assert refusal(REFRESH, OWN) is None
    assert refusal(REFRESH_2, OWN, ITEM) is None
    assert code(REFRESH, FOREIGN) == StatusCodes.BadUserAccessDenied
    assert code(REFRESH, 99) == StatusCodes.BadSubscriptionIdInvalid


@pytest.mark.parametrize("wrong", [[1], [OWN, FOREIGN], "7", 7.0, True, None])
def test_an_argument_that_is_no_number_is_refused_and_named(wrong: Any) -> None:
    for method, values, place in ((REFRESH, (wrong,), 0), (REFRESH_2, (wrong, ITEM), 0), (REFRESH_2, (OWN, wrong), 1)):
        refused = refusal(method, *values)
        assert refused is not None
        assert refused.StatusCode.value == StatusCodes.BadInvalidArgument
        expected = [StatusCodes.BadTypeMismatch if n == place else StatusCodes.Good for n in range(len(values))]
        assert [one.value for one in refused.InputArgumentResults] == expected


def test_the_number_of_arguments_is_compared() -> None:
    assert code(REFRESH) == code(REFRESH_2) == code(REFRESH_2, OWN) == StatusCodes.BadArgumentsMissing
    assert code(REFRESH, OWN, ITEM) == code(REFRESH_2, OWN, ITEM, 1) == StatusCodes.BadTooManyArguments
