"""Overview of several machines in one database, against what their journals hold."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from datetime import UTC, datetime, timedelta, timezone
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from journaled import SETTINGS, dated, journaled, run_id
from sqlalchemy import inspect, make_url, text
from volcal_command import volcal, volcal_json

from agent.execution.journal import Journal
from agent.execution.states import RunState
from agent.history.database_url import DatabaseAddress
from agent.history.dated_ahead import RunsByDate
from agent.history.metrics import metrics_text
from agent.history.overview import trends_of
from agent.history.plant import plant_summaries
from agent.history.schema import RUNS, RUNS_BY_START, utc_time
from agent.history.store import HistoryStore
from agent.history.sync import sync
from agent.reports.plant_page import drift_text, plant_html, spark_points
from agent.results.active_table import ActiveTableFigures, active_table_figures
from agent.settings.history import HistorySettings
from drivers.clock import VirtualClock
from drivers.roles import TableImage

NOW = datetime(2026, 11, 13, 2, tzinfo=UTC)
WILD = "<mill> & co"


def address(folder: Path, machine: str) -> DatabaseAddress:
    return DatabaseAddress(make_url(f"sqlite:///{folder}/plant.sqlite"), machine, 60.0)


@pytest.fixture
def store(tmp_path: Path) -> Iterator[HistoryStore]:
    """Ten nights of a machine whose VE grows by 0.5 µm a night, two of one that stands still, and one that failed."""
    with closing(HistoryStore(address(tmp_path, "grows"))) as opened:
        for machine, nights in (("grows", 10), ("still", 2), (WILD, 1)):
            state = tmp_path / str(nights)
            for night in range(nights):
                ve_um = 8.0 + 0.5 * night if machine == "grows" else 9.0
                ends = RunState.FAULTED if machine == WILD else RunState.COMPLETE
                journaled(state, night, machine=machine, ve_um=ve_um, ends=ends)
            sync(state, opened)
        yield opened


def test_the_latest_runs_of_each_machine_make_its_row(store: HistoryStore) -> None:
    runs = store.recent_runs(3, NOW)
    assert [(run.machine, run.run_id) for run in runs] == [
        (WILD, run_id(0)),
        *(("grows", run_id(night)) for night in (7, 8, 9)),
        *(("still", run_id(night)) for night in (0, 1)),
    ]
    failed, still, grows = plant_summaries(store.recent_runs(30, NOW), NOW)
    assert (failed.machine, failed.last.verdict.name, failed.days) == (WILD, "faulted", 12.0)
    assert (still.machine, still.days, still.ve_um, still.held_out_um) == ("still", 11.0, 9.0, 2.5)
    assert (grows.machine, grows.days, grows.ve_um, grows.vce_um) == ("grows", 3.0, 12.5, 12.5)
    assert grows.drift_um is not None
    assert grows.drift_um[0] == pytest.approx(0.5)
    assert (grows.drifts, still.drifts, failed.drift_um) == (True, False, None)
    assert drift_text(grows).startswith("+0.500 ± ")
    assert (drift_text(failed), spark_points(failed)) == ("too few nights", "")
    points = [tuple(map(float, point.split(","))) for point in spark_points(grows).split()]
    assert (len(points), points[0][0], points[-1][0]) == (10, 0.0, 120.0)
    assert all(later[1] < former[1] for former, later in pairwise(points))


def restored(state: Path, night: int, bank: int, image: TableImage | None) -> None:
    """Journal a run that has restored a stored table, or found it active already."""
    with closing(Journal(state)) as journal:
        run = journal.start_run(run_id(night), "restore", {**SETTINGS, "history": {"machine": "mill"}}, "1", CLOCK)
        if image is not None or bank == 0:
            run.table("staged", bank, image)
        run.decision("outcome", {"table_bank": bank, "night": None})
        run.state(RunState.COMPLETE, "as it should", final=True)
    dated(state, night)


OLD_TABLE = TableImage((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), 1e-4, np.ones((2, 2, 2, 3), dtype=np.int32))
CLOCK = VirtualClock()


@pytest.mark.parametrize(
    ("bank", "image", "vce_um", "held_out_um"), [(2, OLD_TABLE, None, None), (0, None, None, None), (1, None, 9.0, 2.5)]
)
def test_the_figures_of_a_table_are_not_those_of_the_one_that_was_restored(
    tmp_path: Path, bank: int, image: TableImage | None, vce_um: float | None, held_out_um: float | None
) -> None:
    """Bank 1 without a table: the table to be restored was active already."""
    state = tmp_path / "state"
    journaled(state, 0, machine="mill", ve_um=9.0)
    restored(state, 1, bank, image)
    with closing(HistoryStore(address(tmp_path, "mill"))) as store:
        sync(state, store)
        (shown,) = plant_summaries(store.recent_runs(30, NOW), NOW)
        runs = store.runs()
    assert (shown.verdict.name, shown.ve_um) == ("restored", 9.0)
    assert (shown.vce_um, shown.held_out_um) == (vce_um, held_out_um)
    metrics = metrics_text("mill", RunsByDate(runs, runs, ()), trends_of(runs, HistorySettings()))
    told = re.findall(r'^volcal_last_ve_micrometres\{machine="mill",which="(\w+)"\} (\S+)$', metrics, re.MULTILINE)
    expected = {"ve_bare": 9.0, "ve_acting": vce_um, "held_out": held_out_um}
    assert {name: float(value) for name, value in told} == {k: v for k, v in expected.items() if v is not None}


def test_a_table_that_is_restored_has_its_own_figures_again(store: HistoryStore) -> None:
    first, second, third, *_ = store.runs("grows")
    old = replace(first, acting_um=7.0, held_out_after_um=2.0, table_crc32="0000000a")
    new = replace(second, acting_um=4.0, held_out_after_um=1.0, table_crc32="0000000b")
    unmeasured = replace(third, accepted=None, acting_um=None, held_out_before_um=None, held_out_after_um=None)
    back = replace(unmeasured, kind="restore", table_crc32="0000000a")
    assert active_table_figures([old, new]) == ActiveTableFigures(4.0, 1.0)
    assert active_table_figures([old, new, back]) == ActiveTableFigures(7.0, 2.0)
    checked = replace(unmeasured, kind="verify", night="within limits", acting_um=7.5, held_out_before_um=2.5)
    assert active_table_figures([old, new, back, checked]) == ActiveTableFigures(7.5, 2.5)
    assert active_table_figures([old, new, back, replace(back, table_crc32="0000000b")]) == ActiveTableFigures(4.0, 1.0)
    assert active_table_figures([]) == ActiveTableFigures()


def test_a_run_in_progress_is_not_called_unfinished_and_its_start_is_in_utc(tmp_path: Path) -> None:
    with closing(HistoryStore(address(tmp_path, "mill"))) as store:
        journaled(tmp_path / "state", 0, machine="mill")
        sync(tmp_path / "state", store)
        (run,) = store.recent_runs(3, NOW)
    there = utc_time(run.started).astimezone(timezone(timedelta(hours=9)))
    elsewhere = replace(run, started=there, ended=None, state=RunState.MEASURING.value)
    (unfinished,), (busy,) = plant_summaries([elsewhere], NOW), plant_summaries([elsewhere], NOW, ("mill", run.run_id))
    assert (unfinished.verdict.name, busy.verdict.name) == ("unfinished", "running")
    assert f"{utc_time(run.started):%Y-%m-%d %H:%M}" in plant_html((busy,), "plant", NOW)


def test_the_page_is_told_in_german_and_a_machine_keeps_its_name(tmp_path: Path) -> None:
    with closing(HistoryStore(address(tmp_path, "Night"))) as store:
        journaled(tmp_path / "state", 0, machine="Night")
        sync(tmp_path / "state", store)
        page = plant_html(plant_summaries(store.recent_runs(3, NOW), NOW), "Prior", NOW, "de")
    texts = [cell.strip() for cell in re.findall(r">([^<]+)<", page.split("</style>")[1])]
    assert {"Maschinen des Werks", "Night", "Kalibrierung", "Vor Tagen", "zu wenige Nächte", "01.11.2026 02:00"} <= {
        *texts
    }
    assert "1 Maschinen in Prior, gelesen 13.11.2026 02:00 UTC" in page
    assert re.search(r"[\u2068\u2069]", page) is None


def test_the_page_has_a_row_for_each_machine(store: HistoryStore) -> None:
    page = plant_html(plant_summaries(store.recent_runs(30, NOW), NOW), store.address.text, NOW)
    assert page.count("<tr>") == 4
    assert "&lt;mill&gt; &amp; co" in page
    assert WILD not in page
    assert "2026-11-10 02:00" in page


def test_a_database_of_an_earlier_program_gets_the_index(store: HistoryStore, tmp_path: Path) -> None:
    name = str(RUNS_BY_START.name)
    with store._engine.begin() as connection:
        connection.execute(text(f"DROP INDEX {name}"))
    with closing(HistoryStore(address(tmp_path, "grows"))) as again:
        assert inspect(again._engine).has_index(RUNS.name, name)
        assert len(again.recent_runs(30, NOW)) == 13


def test_the_command_lists_them_and_writes_the_page(store: HistoryStore, tmp_path: Path) -> None:
    config, page = tmp_path / "volcal.toml", tmp_path / "plant.html"
    roles = "\n".join(f'{role} = "twin"' for role in ("machine", "probe", "store", "thermometer", "operator", "mount"))
    config.write_text(
        f'machine = "{SETTINGS["machine"]}"\nartefact = "{SETTINGS["artefact"]}"\n'
        f'state_directory = "{tmp_path / "10"}"\n'
        f'[devices.twin]\ndriver = "simulated"\n[roles]\n{roles}\n[stations]\nplaces_mm = [[700.0, 1000.0, 750.0]]\n'
        f'[history]\nurl = "sqlite:///{tmp_path}/plant.sqlite"\nmachine = "grows"\n'
    )
    found = volcal_json("history", "plant", "--config", config, "--html", page)
    assert [one["machine"] for one in found["machines"]] == [WILD, "still", "grows"]
    assert found["machines"][2]["drift_um_a_night"] == pytest.approx(0.5)
    assert "&lt;mill&gt;" in page.read_text(encoding="utf-8")
    assert "Fault" in volcal("history", "plant", "--config", config).stdout
