"""Records of gates (limits) in the journals of earlier versions, in the terms of this one."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from agent.settings.schema import COVERAGE_FACTOR, EARLIER_CERTIFICATE_KEY

_CERTIFICATE = "certificate"  # name that the gate has in every journal
_EARLIER_END, _END = "in standard deviations", "|E_n| with k = 2"


def gate_records(records: Iterable[Mapping[str, Any]], settings: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return the `records` of gates in the journal of a run that was started with `settings`, in their order.

    Settings of an earlier version limit the contradiction of a ball with its certificate in standard deviations, and so
    do the records of their run. These are returned with the score |E_n| (k = 2), which is half of it. A text that
    states how many standard deviations a ball was off stays as it was written.
    """
    earlier = EARLIER_CERTIFICATE_KEY in settings.get("gates", {})
    return [_as_score(one) if earlier and one["name"] == _CERTIFICATE else dict(one) for one in records]


def _as_score(record: Mapping[str, Any]) -> dict[str, Any]:
    return {
        **record,
        "value": record["value"] / COVERAGE_FACTOR,
        "limit": record["limit"] / COVERAGE_FACTOR,
        "text": record["text"].replace(_EARLIER_END, _END),
    }
