"""The board for Grafana names metrics and labels that `/metrics` has, and leaves none out."""

from __future__ import annotations

import json
import re
from contextlib import closing
from typing import Any

import pytest
from journaled import CONFIG, journaled
from prometheus_client.parser import text_string_to_metric_families
from test_history import settings

from agent.execution.states import PACKML, RunState
from agent.history.database_url import database_address
from agent.history.dated_ahead import RunsByDate
from agent.history.metrics import metrics_text
from agent.history.overview import trends_of
from agent.history.store import HistoryStore
from agent.history.sync import sync
from agent.notifications.dispatcher import ReceiverState
from agent.service.control import Status
from agent.service.http.metrics import live_gauges
from agent.settings.history import HistorySettings

BOARD: dict[str, Any] = json.loads((CONFIG / "grafana" / "volcal.json").read_text(encoding="utf-8"))
METRIC = re.compile(r"volcal_\w+")
EXPRESSION = re.compile(r"(time\(\) - )?(?P<metric>volcal_\w+)\{machine=~\"\$machine\"\}( == 1)?")


@pytest.fixture(scope="module")
def labels(tmp_path_factory: pytest.TempPathFactory) -> dict[str, set[str]]:
    """Labels of each metric of a machine that drifts, whose service waits for a mail server."""
    state = tmp_path_factory.mktemp("state")
    for night in range(10):
        journaled(state, night, 4.8 + 0.4 * night)
    chosen = settings(state)
    with closing(HistoryStore(database_address(chosen))) as store:
        sync(state, store)
        runs = store.runs()
    trends = trends_of(runs, HistorySettings(parameter_tolerances={"EXX[1]": 12.0}))
    status = Status(
        "mill",
        RunState.IDLE,
        PACKML[RunState.IDLE],
        receivers=(ReceiverState("mail", 2, "fails", "away"), ReceiverState("mqtt", 0, "partial", "one")),
    )
    gauges = live_gauges(status, history_readable=True)
    assert (gauges["notices_waiting"], gauges["receivers_failing"], gauges["receivers_partial"]) == (2.0, 1.0, 1.0)
    families = text_string_to_metric_families(metrics_text("mill", RunsByDate(runs, runs, ()), trends, gauges))
    return {family.name: set(family.samples[0].labels) for family in families if family.samples}


def targets() -> list[dict[str, Any]]:
    return [target for panel in BOARD["panels"] for target in panel["targets"]]


def test_each_expression_is_a_metric_of_the_chosen_machines(labels: dict[str, set[str]]) -> None:
    for target in targets():
        found = EXPRESSION.fullmatch(target["expr"])
        assert found is not None, target["expr"]
        named = set(re.findall(r"\{\{(\w+)\}\}", target["legendFormat"]))
        assert named <= labels[found["metric"]], target


def test_every_metric_is_on_the_board(labels: dict[str, set[str]]) -> None:
    shown = {name for target in targets() for name in METRIC.findall(target["expr"])}
    assert shown == set(labels)


def test_the_machines_are_those_of_a_metric_that_is_always_there(labels: dict[str, set[str]]) -> None:
    (machines,) = (one for one in BOARD["templating"]["list"] if one["name"] == "machine")
    assert METRIC.findall(machines["definition"]) == ["volcal_alarms_open"]
    assert "volcal_alarms_open" in labels


def test_panels_have_numbers_of_their_own_and_do_not_overlap() -> None:
    panels = BOARD["panels"]
    assert len({panel["id"] for panel in panels}) == len(panels)
    taken: set[tuple[int, int]] = set()
    for place in (panel["gridPos"] for panel in panels):
        cells = {(place["x"] + i, place["y"] + j) for i in range(place["w"]) for j in range(place["h"])}
        assert taken.isdisjoint(cells)
        assert max(x for x, _ in cells) < 24
        taken |= cells
