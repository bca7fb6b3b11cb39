"""One run while the date of the controller PC was wrong: later runs still raise alarms, and the run is named."""

from __future__ import annotations

from contextlib import closing
from datetime import UTC, datetime, timedelta, timezone
from pathlib import Path

import pytest
from click.testing import CliRunner
from journal_surgery import change_dates
from journaled import SETTINGS, journaled, run_id
from prometheus_client.parser import text_string_to_metric_families
from test_history import settings
from volcal_command import volcal_json

from agent.cli.main import main
from agent.cli.opened_history import counted_runs
from agent.execution.states import RunState
from agent.history.cached_trends import CachedTrends
from agent.history.database_url import database_address
from agent.history.dated_ahead import CLOCK_DIFFERENCE, ahead_text, by_date
from agent.history.metrics import CachedMetrics
from agent.history.plant import plant_summaries
from agent.history.recent_runs import RecentRun
from agent.history.store import HistoryStore
from agent.history.sync import sync
from agent.language.sentences import in_language
from agent.reports.plant_page import plant_html
from agent.service.page.trends import TrendCache
from agent.settings.schema import Settings

NIGHTS = 14
AHEAD = 3
NOW = datetime(2026, 11, 14, 8, tzinfo=UTC)
SENTENCE = f"run {run_id(AHEAD)} is dated in the future: check the clock of the controller PC"


@pytest.fixture
def state(tmp_path: Path) -> Path:
    """Fourteen nights whose VE passes the tolerance of 15 µm after the one dated in the future; the last one failed."""
    for night in range(NIGHTS):
        ends = RunState.FAULTED if night == NIGHTS - 1 else RunState.COMPLETE
        journaled(tmp_path / "state", night, machine="mill", ve_um=10.0 if night <= AHEAD else 30.0, ends=ends)
    date_ahead(tmp_path / "state", AHEAD)
    return tmp_path / "state"


def date_ahead(state: Path, night: int) -> None:
    change_dates(state, run_id(night), f"2098-11-{night + 1:02d}T02:00:00.000Z", f"2098-11-{night + 1:02d}T03:30:00Z")


@pytest.fixture
def chosen(state: Path) -> Settings:
    return settings(state, machine="mill", ve_bare_tolerance_um=15.0)


@pytest.fixture
def config(state: Path, tmp_path: Path) -> Path:
    roles = "\n".join(f'{role} = "twin"' for role in ("machine", "probe", "store", "thermometer", "operator", "mount"))
    file = tmp_path / "volcal.toml"
    file.write_text(
        f'machine = "{SETTINGS["machine"]}"\nartefact = "{SETTINGS["artefact"]}"\nstate_directory = "{state}"\n'
        f'[devices.twin]\ndriver = "simulated"\n[roles]\n{roles}\n[stations]\nplaces_mm = [[700.0, 1000.0, 750.0]]\n'
        '[history]\nmachine = "mill"\nve_bare_tolerance_um = 15.0\n'
    )
    return file


def test_the_page_shows_the_alarms_of_the_newest_run_and_names_the_one_dated_ahead(chosen: Settings) -> None:
    found = TrendCache(CachedTrends()).document(chosen, None)
    assert [(one["kind"], one["text"]) for one in found["alarms"] if one["kind"] in ("limit", "date")] == [
        ("limit", "VE without table is 30.00 µm: tolerance 15 µm reached"),
        ("date", SENTENCE),
    ]
    (bare,) = (trend for trend in found["trends"] if trend["name"] == "ve_bare")
    assert run_id(AHEAD) not in bare["runs"]
    assert bare["nights"][-1] == pytest.approx(NIGHTS - 1)
    assert found["marks"][-1]["started"].startswith("2026-11-1")
    assert run_id(AHEAD) in found["runs"]


def test_the_metrics_are_those_of_the_newest_run_and_count_an_alarm(chosen: Settings) -> None:
    _, text = CachedMetrics(CachedTrends()).text(chosen)
    found = {
        (sample.name, *(value for key, value in sorted(sample.labels.items()) if key != "machine")): sample.value
        for family in text_string_to_metric_families(text)
        for sample in family.samples
    }
    assert found["volcal_last_ve_micrometres", "ve_bare"] == 30.0
    assert (found["volcal_last_run_state", "faulted"], found["volcal_last_run_state", "complete"]) == (1.0, 0.0)
    assert found["volcal_last_run_timestamp_seconds",] < 2.0e9
    assert found["volcal_last_success_timestamp_seconds",] < 2.0e9
    assert (found["volcal_trend_alarms", "limit"], found["volcal_trend_alarms", "date"]) == (1.0, 1.0)
    assert found["volcal_runs", "calibrate", "complete"] == NIGHTS - 1


def test_the_commands_judge_the_newest_run_and_name_the_one_dated_ahead(config: Path, state: Path) -> None:
    trend = CliRunner().invoke(main, ["history", "trend", "--config", str(config)])
    assert trend.exit_code == 4
    assert f"date: {SENTENCE}\n" in trend.stderr
    (machine,) = volcal_json("history", "plant", "--config", config)["machines"]
    assert (machine["run_id"], machine["verdict"]["name"], machine["ve_um"]) == (run_id(NIGHTS - 1), "faulted", 30.0)
    assert machine["days"] > 0.0
    assert machine["dated_ahead"] == [run_id(AHEAD)]
    plant = CliRunner().invoke(main, ["history", "plant", "--config", str(config)])
    assert f"note: mill: {SENTENCE}\n" in plant.stderr


def test_a_date_alone_is_no_fault_of_the_machine(config: Path, tmp_path: Path) -> None:
    config.write_text(config.read_text().replace("ve_bare_tolerance_um = 15.0", ""))
    trend = CliRunner().invoke(main, ["history", "trend", "--config", str(config)])
    assert f"date: {SENTENCE}\n" in trend.stderr
    assert trend.exit_code == 0


def test_a_run_is_dated_ahead_only_beyond_the_difference_of_two_clocks() -> None:
    runs = [dated(0, NOW - CLOCK_DIFFERENCE), dated(1, NOW + CLOCK_DIFFERENCE), dated(2, NOW + 2 * CLOCK_DIFFERENCE)]
    found = by_date(runs, NOW)
    assert (found.every, found.counted, found.ahead) == (runs, runs[:2], runs[2:])
    assert by_date(runs, NOW + CLOCK_DIFFERENCE).ahead == []
    assert by_date(runs, (NOW + CLOCK_DIFFERENCE).astimezone(timezone(timedelta(hours=-9)))).ahead == []
    assert (ahead_text([]), ahead_text(found.ahead)) == ("", SENTENCE.replace(run_id(AHEAD), run_id(2)))


def test_all_runs_count_if_all_are_dated_ahead_and_the_last_is_named() -> None:
    """The clock of the computer that reads the history is a year late."""
    runs = [dated(night, NOW + timedelta(days=365 + night)) for night in range(3)]
    found = by_date(runs, NOW)
    assert (found.counted, found.ahead) == (runs, runs)
    text = f"3 runs are dated in the future, the last is {run_id(2)}: check the clock of the controller PC"
    assert ahead_text(found.ahead) == text
    assert in_language(text, "de") == (
        f"3 Läufe tragen ein Datum in der Zukunft, der letzte ist {run_id(2)}: Uhr des Steuerungs-PCs prüfen"
    )
    assert by_date([], NOW).counted == []


def test_the_trends_change_when_the_date_of_the_run_has_come(chosen: Settings) -> None:
    times = [NOW]
    cached = CachedTrends(lambda: times[0])
    before, key = cached.current(chosen), cached.key(chosen)
    assert [run.run_id for run in before.by_date.ahead] == [run_id(AHEAD)]
    assert (before.key, len(before.runs), len(before.by_date.counted)) == (key, NIGHTS, NIGHTS - 1)
    times[0] = NOW + timedelta(days=1)
    assert cached.current(chosen) is before
    times[0] = datetime(2098, 11, 5, tzinfo=UTC)
    assert cached.key(chosen) != key
    after = cached.current(chosen)
    assert (after.by_date.ahead, after.by_date.counted[-1].run_id) == ([], run_id(AHEAD))
    times[0] = NOW
    assert cached.current(chosen).by_date.ahead


def test_more_runs_dated_ahead_than_the_plant_reads_hide_no_machine(state: Path, chosen: Settings) -> None:
    for night in range(4, 10):
        date_ahead(state, night)
    with closing(HistoryStore(database_address(chosen))) as store:
        sync(state, store)
        runs = store.recent_runs(3, NOW)
    assert [run.run_id for run in runs] == [run_id(night) for night in (11, 12, 13, 7, 8, 9)]
    (machine,) = plant_summaries(runs, NOW)
    assert (machine.last.run_id, len(machine.recent)) == (run_id(13), 3)
    assert machine.days == pytest.approx(0.25)
    page = plant_html([machine], "plant", NOW, "de")
    assert f"3 Läufe tragen ein Datum in der Zukunft, der letzte ist {run_id(9)}" in page


def test_a_machine_of_which_all_runs_are_dated_ahead_is_listed(state: Path, chosen: Settings) -> None:
    for night in range(NIGHTS):
        date_ahead(state, night)
    with closing(HistoryStore(database_address(chosen))) as store:
        sync(state, store)
        (machine,) = plant_summaries(store.recent_runs(3, NOW), NOW)
    assert (machine.last.run_id, machine.as_json()["dated_ahead"]) == (
        run_id(NIGHTS - 1),
        [run_id(night) for night in (11, 12, 13)],
    )


def test_the_thermal_commands_leave_the_run_out_and_name_it(
    state: Path, chosen: Settings, capsys: pytest.CaptureFixture[str]
) -> None:
    with closing(HistoryStore(database_address(chosen))) as store:
        sync(state, store)
        assert [run.run_id for run in counted_runs(store)] == [run_id(n) for n in range(NIGHTS) if n != AHEAD]
    assert capsys.readouterr().err == f"note: {SENTENCE}\n"


def dated(night: int, started: datetime) -> RecentRun:
    figures = dict.fromkeys(("ve_before_um", "ve_before_sigma_um", "acting_um", "held_out_before_um"), 1.0)
    return RecentRun(
        "mill", run_id(night), "calibrate", started, None, "measuring", None, None, **figures, held_out_after_um=None,
        table_bank=None, table_crc32=None,
    )  # fmt: skip
