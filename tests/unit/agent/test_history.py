"""History in a real SQLite file: fed from journals, written again without harm, refused where it is another version."""

from __future__ import annotations

import csv
import io
import json
import re
import sqlite3
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from datetime import date, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from journal_surgery import add_event, change_dates, change_end, operate, remove_results
from journaled import SETTINGS, journaled, run_id
from prometheus_client.parser import text_string_to_metric_families
from volcal_command import volcal

from agent.cli.main import main
from agent.execution.journal import Journal
from agent.execution.run_record import RunRecord, read_record, run_ids
from agent.execution.states import RunState
from agent.history.cached_trends import CachedTrends
from agent.history.database_url import DatabaseAddress, database_address
from agent.history.dated_ahead import RunsByDate
from agent.history.export import as_csv, as_json
from agent.history.feed import update_history
from agent.history.figure import draw_trends, trends_svg
from agent.history.journal_runs import runs_until
from agent.history.metrics import metrics_text
from agent.history.overview import alarms_of, most_relevant, select_trends, trends_of
from agent.history.schema import utc_time
from agent.history.series import ACTIVE, BARE, Series, nights_of
from agent.history.store import HistoryStore
from agent.history.sync import RunsLeftOut, sync, sync_ends, sync_missing
from agent.history.trends import AlarmKind, trend_of
from agent.settings.history import HistorySettings
from agent.settings.schema import Settings
from drivers.clock import VirtualClock, utc_timestamp
from drivers.errors import ConfigurationError, InputError, LinkLost

ROLES = ("machine", "probe", "store", "thermometer", "operator", "mount")


def settings(state: Path, **history: object) -> Settings:
    roles = dict.fromkeys(ROLES, "twin")
    return Settings.model_validate(
        {
            "machine": SETTINGS["machine"],
            "artefact": SETTINGS["artefact"],
            "state_directory": str(state),
            "devices": {"twin": {"driver": "simulated"}},
            "roles": roles,
            "stations": {"places_mm": [[700.0, 1000.0, 750.0]]},
            "history": history,
        }
    )


@pytest.fixture
def state(tmp_path: Path) -> Path:
    return tmp_path / "state"


@pytest.fixture
def store(state: Path) -> Iterator[HistoryStore]:
    state.mkdir()
    with closing(HistoryStore(database_address(settings(state)))) as opened:
        yield opened


def test_trends_read_only_the_runs_that_are_new_or_changed(state: Path) -> None:
    for night in range(3):
        journaled(state, night, machine="mine")
    cached, chosen = CachedTrends(), settings(state, machine="mine")
    first = cached.current(chosen)
    assert [run.run_id for run in first.runs] == [run_id(night) for night in range(3)]
    assert cached.current(chosen) is first
    journaled(state, 3, exx_um=9.0, machine="mine")
    second = cached.current(chosen)
    assert [run.run_id for run in second.runs] == [run_id(night) for night in range(4)]
    assert all(now is before for now, before in zip(second.runs, first.runs, strict=False))
    [slope] = [trend.series for trend in second.trends if trend.series.name == "EXX[1]"]
    assert slope.values == pytest.approx([3.0, 3.0, 3.0, 9.0])
    operate(state, "UPDATE runs SET state = 'faulted' WHERE run_id = ?", run_id(1))
    with closing(HistoryStore(database_address(chosen))) as store:
        sync(state, store)
    third = cached.current(chosen)
    assert [now is before for now, before in zip(third.runs, second.runs, strict=True)] == [True, False, True, True]
    assert third.runs[1].state == "faulted"
    assert cached.current(settings(state, machine="another")).runs == []


class TestFeeding:
    def test_a_run_is_stored_with_everything(self, state: Path, store: HistoryStore) -> None:
        journaled(state, 0, 3.0)
        assert sync(state, store) == (run_id(0),)
        (run,) = store.runs("case-study")
        assert (run.kind, run.state, run.reason, run.software) == ("calibrate", "complete", "as it should", "1.2.3")
        assert (run.ve_before_um, run.ve_before_sigma_um, run.acting_um) == (10.0, 0.5, 10.0)
        assert (run.held_out_before_um, run.held_out_after_um, run.held_out_predicted_um) == (3.5, 2.5, 2.4)
        assert (run.machine_minutes, run.accepted, run.rank, run.started_by) == (83.5, True, 2, "command line")
        assert [(p.name, p.value, p.unit) for p in run.parameters] == [
            ("EXX[1]", pytest.approx(3.0), "µm"),
            ("EXX[2]", 0.0, "µm"),
            ("A0Z", pytest.approx(2.0), "µrad"),
        ]
        assert [decision.kind for decision in run.decisions] == ["gate", "proof"]

    def test_feeding_again_changes_nothing(self, state: Path, store: HistoryStore) -> None:
        journaled(state, 0)
        sync(state, store)
        assert sync(state, store) == ()
        assert len(store.runs()) == 1

    def test_what_has_changed_since_is_written_again(self, state: Path, store: HistoryStore) -> None:
        """A run that was under way, or resumed: the row follows, its parameters are not doubled."""
        journaled(state, 0)
        sync(state, store)
        change_end(state, "faulted", "mended")
        assert sync(state, store) == (run_id(0),)
        (run,) = store.runs()
        assert (run.state, run.reason, len(run.parameters)) == ("faulted", "mended", 3)

    def test_a_reading_command_feeds_the_runs_whose_end_is_new(self, state: Path, store: HistoryStore) -> None:
        journaled(state, 0)
        journaled(state, 1)
        assert sync_ends(state, store) == (run_id(0), run_id(1))
        assert sync_ends(state, store) == ()
        change_end(state, "faulted", "mended")
        changed = sync_ends(state, store)
        assert changed
        assert {run.run_id for run in store.runs() if run.reason == "mended"} == set(changed)

    def test_what_was_added_to_a_run_after_its_end_is_stored_too(self, state: Path, store: HistoryStore) -> None:
        """The next start takes back a table that was never proved: a decision of the run that had ended."""
        journaled(state, 0)
        journaled(state, 1)
        sync_ends(state, store)
        journal = Journal(state)
        aside = journal.continue_run(1, run_id(0), VirtualClock())[0].aside()
        aside.decision("restore/activated", {"bank": 1})
        journal.close()
        assert sync_ends(state, store) == (run_id(0),)
        assert [decision.kind for decision in next(iter(store.runs())).decisions][-1] == "restore/activated"
        assert sync_ends(state, store) == ()

    def test_a_run_whose_end_is_stored_is_not_read_again(
        self, state: Path, store: HistoryStore, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """Each run writes its outcome just after its end. With 1000 runs, to read all of them would take a minute."""
        journaled(state, 0)
        change_dates(state, run_id(0), "2026-11-01T02:00:00.000Z", utc_timestamp())
        journal = Journal(state)
        journal.continue_run(1, run_id(0), VirtualClock())[0].aside().decision("outcome", {"machine_minutes": 83.5})
        journal.close()
        sync_ends(state, store)
        read: list[str] = []
        monkeypatch.setattr("agent.history.sync.read_record", lambda _, chosen: read.append(chosen))
        assert sync_ends(state, store) == ()
        assert read == []

    def test_runs_without_what_belongs_to_them(self, state: Path, store: HistoryStore) -> None:
        journaled(state, 0)
        sync(state, store)
        (whole,) = store.runs()
        (run,) = store.runs(whole=False)
        assert whole == replace(
            run, parameters=whole.parameters, temperatures=whole.temperatures, decisions=whole.decisions
        )
        assert (run.parameters, run.temperatures, run.decisions) == ([], [], [])

    @pytest.mark.parametrize(
        ("first", "said"), [('{"source": "timer"}', "timer"), ('{"source": "page", "by": "panel 2"}', "page (panel 2)")]
    )
    def test_a_run_that_was_gone_on_with_was_started_by_who_asked_first(
        self, state: Path, store: HistoryStore, first: str, said: str
    ) -> None:
        journaled(state, 0)
        for asked in (first, '{"source": "page", "resumed": true}'):
            add_event(state, 1, "asked", asked)
        sync(state, store)
        (run,) = store.runs()
        assert run.started_by == said

    def test_a_run_without_an_estimate_is_history_too(self, state: Path, store: HistoryStore) -> None:
        journaled(state, 0, ends=RunState.REFUSED)
        remove_results(state)
        sync(state, store)
        (run,) = store.runs()
        assert (run.state, run.ve_before_um, run.parameters, run.accepted) == ("refused", None, [], None)

    def test_machines_are_kept_apart(self, state: Path, store: HistoryStore, tmp_path: Path) -> None:
        journaled(state, 0, machine="mill-4")
        other = tmp_path / "other"
        journaled(other, 0, machine="mill-5")
        sync(state, store)
        sync(other, store)
        assert store.machines() == ("mill-4", "mill-5")
        assert [run.machine for run in store.runs("mill-5")] == ["mill-5"]

    def test_a_journal_that_is_not_there_is_told(self, store: HistoryStore, tmp_path: Path) -> None:
        with pytest.raises(InputError, match="no journal"):
            sync(tmp_path / "nowhere", store)

    @pytest.mark.parametrize(
        "damage",
        [
            "INSERT INTO decisions VALUES (2, '2026-12-01T00:00:00.000Z', 'restore/activated', '{\"bank\":', 0)",
            "UPDATE runs SET settings = '{' WHERE run = 2",
            "UPDATE runs SET ended = '2026-1!-02T03:30:00.000Z' WHERE run = 2",
            "UPDATE runs SET started = '2026-1!-02T02:00:00.000Z' WHERE run = 2",
        ],
    )
    def test_a_run_that_cannot_be_read_keeps_no_other_run_out_of_the_history(self, state: Path, damage: str) -> None:
        for night in range(4):
            journaled(state, night)
        operate(state, damage)
        chosen = settings(state)
        complaint = update_history(chosen, run_id(3))
        assert complaint.startswith(f"the history is not complete: run {run_id(1)} cannot be copied to the history: ")
        with closing(HistoryStore(database_address(chosen))) as store:
            assert [run.run_id for run in store.runs()] == [run_id(night) for night in (0, 2, 3)]
            journaled(state, 4)
            assert sync_missing(state, store) == {run_id(night) for night in range(5)}
            journaled(state, 5)
            with pytest.raises(RunsLeftOut, match=run_id(1)):
                sync(state, store)
            assert [run.run_id for run in store.runs()] == [run_id(night) for night in (0, 2, 3, 4, 5)]

    def test_an_unknown_run_names_the_last_ones(self, state: Path) -> None:
        journaled(state, 0)
        with pytest.raises(InputError, match=run_id(0)):
            read_record(state, "20200101T000000Z-0000")
        assert run_ids(state) == (run_id(0),)


def until_last(state: Path, nights: int, **history: object) -> tuple[str, list[str]]:
    """Return the runs up to the last one as text, and the identities of those that were read from the journal."""
    read: list[str] = []

    def counting(directory: Path, chosen: str) -> RunRecord:
        read.append(chosen)
        return read_record(directory, chosen)

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr("agent.history.journal_runs.read_record", counting)
        last = read_record(state, run_id(nights - 1))
        return as_json(runs_until(state, last, HistorySettings.model_validate(history))), read


class TestRunsUntil:
    NIGHTS = 4

    @pytest.fixture
    def nights(self, state: Path) -> list[str]:
        """Runs that ended when their last decision was written; the identities of all but the last."""
        for night in range(self.NIGHTS):
            change_dates(
                state, journaled(state, night, 3.0 + night), f"2026-11-{night + 1:02}T02:00:00.000Z", utc_timestamp()
            )
        return [run_id(night) for night in range(self.NIGHTS - 1)]

    def test_runs_in_the_history_file_are_the_same_and_are_not_read_again(self, state: Path, nights: list[str]) -> None:
        journaled(state, self.NIGHTS)  # a later one is not among them
        alone, read = until_last(state, self.NIGHTS)
        assert [run["run_id"] for run in json.loads(alone)["runs"]] == [*nights, run_id(self.NIGHTS - 1)]
        assert read == nights
        assert not (state / "history.sqlite").exists()
        with closing(HistoryStore(database_address(settings(state)))) as store:
            sync(state, store)
        assert until_last(state, self.NIGHTS) == (alone, [])

    @pytest.mark.parametrize("change", ["end", "settings", "later"])
    def test_a_run_that_is_not_as_stored_is_read(
        self, state: Path, store: HistoryStore, nights: list[str], change: str
    ) -> None:
        sync(state, store)
        if change == "end":
            operate(state, "UPDATE runs SET reason = 'mended' WHERE run_id = ?", nights[1])
        elif change == "settings":
            operate(state, "UPDATE runs SET settings = settings || ' ' WHERE run_id = ?", nights[1])
        else:
            journal = Journal(state)
            journal.continue_run(2, nights[1], VirtualClock())[0].aside().decision("restore/activated", {"bank": 1})
            journal.close()
        found, read = until_last(state, self.NIGHTS)
        assert read == [nights[1]]
        sync(state, store)
        assert as_json(store.runs()) == found

    @pytest.mark.parametrize(
        "damage", ["UPDATE volcal_schema SET version = 2", "UPDATE volcal_runs SET ve_before_um = x'ff00'"]
    )
    def test_without_a_usable_history_file_all_are_read(
        self, state: Path, store: HistoryStore, nights: list[str], damage: str
    ) -> None:
        sync(state, store)
        good, _ = until_last(state, self.NIGHTS)
        with closing(sqlite3.connect(state / "history.sqlite")) as database, database:
            database.execute(damage)
        assert until_last(state, self.NIGHTS) == (good, nights)
        assert until_last(state, self.NIGHTS, url="postgresql://me@127.0.0.1:1/volcal", timeout_s=1.0) == (good, nights)

    def test_runs_of_another_machine_are_not_among_them(self, state: Path) -> None:
        for night, machine in enumerate(("mine", "yours", "mine")):
            journaled(state, night, machine=machine)
        assert [run["run_id"] for run in json.loads(until_last(state, 3)[0])["runs"]] == [run_id(0), run_id(2)]


class TestPlace:
    def test_a_newer_schema_is_refused(self, state: Path, store: HistoryStore) -> None:
        with closing(sqlite3.connect(state / "history.sqlite")) as database, database:
            database.execute("UPDATE volcal_schema SET version = 2")
        with pytest.raises(ConfigurationError, match="version 2"):
            HistoryStore(store.address)

    @pytest.mark.parametrize(
        "damage",
        [
            "UPDATE volcal_runs SET balls = 'many'",
            "UPDATE volcal_runs SET ve_before_um = x'ff00'",
            "UPDATE volcal_runs SET ve_before_um = 9e999",
            "UPDATE volcal_runs SET started = 'yesterday'",
            "UPDATE volcal_parameters SET value = 'large'",
            "UPDATE volcal_parameters SET value = -1e200",
            "UPDATE volcal_runs SET ve_before_um = 1e200",
            "UPDATE volcal_decisions SET record = '{'",
            "UPDATE volcal_decisions SET record = '{\"value\": 1e999}'",
            "UPDATE volcal_decisions SET record = '{\"value\": NaN}'",
        ],
    )
    def test_a_damaged_value_is_refused_in_words(self, state: Path, store: HistoryStore, damage: str) -> None:
        journaled(state, 0, 3.0)
        sync(state, store)
        assert as_json(store.runs())
        with closing(sqlite3.connect(state / "history.sqlite")) as database, database:
            assert database.execute(damage).rowcount > 0
        with pytest.raises(InputError, match="the history database is damaged") as told:
            as_json(store.runs())
        assert "volcal history sync" in told.value.hint

    def test_a_password_in_the_url_is_refused(self, state: Path) -> None:
        with pytest.raises(ConfigurationError, match="contains a password") as told:
            database_address(settings(state, url="postgresql://me:secret@plant/volcal"))
        assert "secret" not in str(told.value)

    def test_the_password_of_the_file_is_never_shown(self, state: Path, tmp_path: Path) -> None:
        file = tmp_path / "password"
        file.write_text("hush-hush\n")
        file.chmod(0o600)
        address = database_address(settings(state, url="postgresql://me@plant/volcal", credentials_file=str(file)))
        assert address.url.password == file.read_text().strip()
        assert "hush-hush" not in address.text + repr(address)

    def test_a_file_that_others_can_read_is_refused(self, state: Path, tmp_path: Path) -> None:
        file = tmp_path / "password"
        file.write_text("hush-hush\n")
        file.chmod(0o644)
        with pytest.raises(ConfigurationError, match="can be read by others"):
            database_address(settings(state, url="postgresql://me@plant/volcal", credentials_file=str(file)))

    @pytest.mark.parametrize("url", ["mysql://me@plant/volcal", "not a url"])
    def test_other_databases_are_refused(self, state: Path, url: str) -> None:
        with pytest.raises(ConfigurationError):
            database_address(settings(state, url=url))

    def test_a_database_that_is_away_is_a_lost_link(self, state: Path, tmp_path: Path) -> None:
        file = tmp_path / "password"
        file.write_text("hush-hush")
        file.chmod(0o600)
        configured = settings(
            state, url="postgresql://me@127.0.0.1:1/volcal", credentials_file=str(file), timeout_s=1.0, machine="m"
        )
        with pytest.raises(LinkLost, match="history sync") as told:
            HistoryStore(database_address(configured))
        assert "hush-hush" not in str(told.value)


def fed(state: Path, store: HistoryStore, values: list[float]) -> None:
    for night, value in enumerate(values):
        journaled(state, night, value)
    sync(state, store)


class TestTrends:
    def test_an_alarm_before_the_tolerance_is_reached(self, state: Path, store: HistoryStore) -> None:
        """4.8 µm growing by 0.4 a night for ten nights is 8.4; 3.6 of 12 are left: nine nights."""
        fed(state, store, [4.8 + 0.4 * night for night in range(10)])
        trends = trends_of(store.runs(), HistorySettings(parameter_tolerances={"EXX[1]": 12.0}))
        (trend,) = select_trends(trends, ["EXX[1]"])
        assert trend.drift is not None
        assert trend.drift.slope == pytest.approx(0.4)
        (alarm,) = [one for one in alarms_of(trends) if one.series == "EXX[1]" and one.kind is AlarmKind.TREND]
        assert alarm.text.startswith("EXX slope grows by 0.40 ± ")
        told = re.search(
            r"tolerance 12 µm will be reached about (\S+) \(5 to 95 %: (\S+) to (\S+)\), 100 %", alarm.text
        )
        assert told is not None
        low, middle, high = (date.fromisoformat(told[place]) for place in (2, 1, 3))
        assert low <= middle <= high
        assert abs(middle - date(2026, 11, 19)) <= timedelta(days=1)
        assert high - low <= timedelta(days=2)

    def test_no_alarm_without_a_trend(self, state: Path, store: HistoryStore) -> None:
        fed(state, store, [5.0 + 0.1 * (-1) ** night for night in range(10)])
        trends = trends_of(store.runs(), HistorySettings(parameter_tolerances={"EXX": 12.0}))
        assert alarms_of(trends) == ()

    def test_a_tolerance_that_is_reached(self, state: Path, store: HistoryStore) -> None:
        fed(state, store, [5.0, 13.0])
        trends = trends_of(store.runs(), HistorySettings(parameter_tolerances={"EXX": 12.0}))
        assert [alarm.kind for alarm in alarms_of(trends)] == [AlarmKind.LIMIT]

    def test_an_error_is_judged_by_its_largest_value(self, state: Path, store: HistoryStore) -> None:
        """EXX = c1 P1: largest at the ends, where it is |c1|."""
        fed(state, store, [-7.0, -8.0, -9.0])
        whole, *_ = select_trends(trends_of(store.runs(), HistorySettings()), ["EXX"])
        assert whole.series.name == "EXX"
        assert whole.series.values == pytest.approx([7.0, 8.0, 9.0])

    @pytest.mark.parametrize(
        ("last", "two_sided", "told"),
        [(7.0, False, 1), (3.0, False, 0), (7.0, True, 1), (3.0, True, 1), (5.1, False, 0)],
    )
    def test_an_error_that_falls_out_of_its_limits_is_a_better_machine(
        self, last: float, two_sided: bool, told: int
    ) -> None:
        """Mean moving range of the first: (7 * 0.2 + 2.1) / 8 = 0.44, so one sigma is 0.39 and 7.0 is beyond three."""
        values = np.array([*(5.0 + 0.1 * (-1.0) ** night for night in range(8)), last])
        series = Series(
            name="ve", title="VE", unit="µm", run_ids=tuple("abcdefghi"), nights=np.arange(9.0), values=values,
            sigmas=np.full(9, np.nan), stated=False, tolerance=None, two_sided=two_sided, steps=(),
            started_s=86_400.0 * np.arange(9.0),
        )  # fmt: skip
        alarms = trend_of(series, warn_nights=14.0).alarms
        assert [alarm.kind for alarm in alarms] == [AlarmKind.CONTROL] * told

    def test_nights_are_those_of_the_calendar(self, state: Path, store: HistoryStore) -> None:
        for night in (0, 1, 4):
            journaled(state, night)
        sync(state, store)
        assert nights_of(store.runs()) == pytest.approx([0.0, 1.0, 4.0])

    def test_unknown_names_are_told_what_there_is(self, state: Path, store: HistoryStore) -> None:
        fed(state, store, [1.0])
        with pytest.raises(InputError, match="ve_bare"):
            select_trends(trends_of(store.runs(), HistorySettings()), ["EWX"])

    def test_figures(self, state: Path, store: HistoryStore) -> None:
        fed(state, store, [4.8 + 0.4 * night for night in range(10)])
        shown = most_relevant(trends_of(store.runs(), HistorySettings()))
        assert draw_trends(shown).png.startswith(b"\x89PNG")
        assert trends_svg(shown) == trends_svg(shown)
        assert [trend.series.name for trend in shown[:2]] == [BARE, ACTIVE]


class TestExports:
    def test_csv_has_a_line_a_run(self, state: Path, store: HistoryStore) -> None:
        fed(state, store, [3.0, 4.0])
        rows = list(csv.DictReader(io.StringIO(as_csv(store.runs()))))
        assert [row["run_id"] for row in rows] == [run_id(0), run_id(1)]
        assert float(rows[1]["EXX[1]_µm"]) == pytest.approx(4.0)
        assert rows[0]["started"] == "2026-11-01T02:00:00.000Z"

    def test_no_text_of_the_csv_is_a_formula_for_a_spreadsheet(self, state: Path, store: HistoryStore) -> None:
        journaled(state, 0, machine="=HYPERLINK(1)")
        sync(state, store)
        runs = store.runs("=HYPERLINK(1)")
        changed = [replace(run, reason="@SUM(A1)", started_by="-2+3") for run in runs]
        (row,) = csv.DictReader(io.StringIO(as_csv(changed)))
        assert (row["machine"], row["reason"], row["started_by"]) == ("'=HYPERLINK(1)", "'@SUM(A1)", "'-2+3")
        assert float(row["EXX[1]_µm"]) == pytest.approx(3.0)
        assert json.loads(as_json(runs))["runs"][0]["machine"] == "=HYPERLINK(1)"

    def test_json_has_it_all(self, state: Path, store: HistoryStore) -> None:
        fed(state, store, [3.0])
        (run,) = json.loads(as_json(store.runs()))["runs"]
        assert run["decisions"][1]["record"]["after_um"] == 2.5

    def test_metrics_are_what_prometheus_reads(self, state: Path, store: HistoryStore) -> None:
        fed(state, store, [4.8 + 0.4 * night for night in range(10)])
        runs = store.runs()
        trends = trends_of(runs, HistorySettings(parameter_tolerances={"EXX[1]": 12.0}))
        text = metrics_text("case-study", RunsByDate(runs, runs, ()), trends, {"link_errors": 2.0})
        found = {
            (
                sample.name,
                sample.labels.get("series", sample.labels.get("state", sample.labels.get("kind", ""))),
            ): sample
            for family in text_string_to_metric_families(text)
            for sample in family.samples
        }
        assert found["volcal_link_errors", ""].value == 2.0
        assert found["volcal_trend_drift_per_night", "EXX[1]"].value == pytest.approx(0.4)
        assert found["volcal_last_run_state", "complete"].value == 1.0
        assert found["volcal_trend_alarms", "trend"].value == 1.0
        assert found["volcal_last_success_timestamp_seconds", ""].value == pytest.approx(1794195000.0, abs=86400 * 40)

    @pytest.mark.parametrize(
        ("change", "verdict"),
        [
            ({"accepted": False}, "proof-failed"),
            ({"kind": "verify", "accepted": None, "night": "out of limits"}, "out-of-limits"),
            ({"kind": "restore", "accepted": None}, "restored"),
        ],
    )
    def test_a_complete_run_without_a_good_verdict_is_no_success(
        self, state: Path, store: HistoryStore, change: dict[str, Any], verdict: str
    ) -> None:
        fed(state, store, [3.0, 4.0])
        good, last = store.runs()
        runs = [good, replace(last, **change)]
        found = {
            (sample.name, sample.labels.get("verdict", "")): sample.value
            for family in text_string_to_metric_families(metrics_text("mill", RunsByDate(runs, runs, ()), ()))
            for sample in family.samples
        }
        assert good.ended is not None
        assert found["volcal_last_success_timestamp_seconds", ""] == utc_time(good.ended).timestamp()
        assert [name for (metric, name), value in found.items() if metric.endswith("verdict") and value] == [verdict]


class TestCommands:
    @pytest.fixture
    def config(self, state: Path, tmp_path: Path) -> Path:
        for night in range(10):
            journaled(state, night, 4.8 + 0.4 * night)
        path = tmp_path / "volcal.toml"
        roles = "\n".join(f'{role} = "twin"' for role in ROLES)
        path.write_text(
            f'machine = "{SETTINGS["machine"]}"\nartefact = "{SETTINGS["artefact"]}"\nstate_directory = "{state}"\n'
            f'[devices.twin]\ndriver = "simulated"\n[devices.twin.options]\n'
            f'scenario = "{Path(str(SETTINGS["machine"])).parents[1] / "simulators" / "case-study.toml"}"\n'
            f"[roles]\n{roles}\n[stations]\nplaces_mm = [[700.0, 1000.0, 750.0]]\n"
            f'[history.parameter_tolerances]\n"EXX[1]" = 12.0\n'
        )
        return path

    def test_list(self, config: Path) -> None:
        result = volcal("history", "list", "--config", config, "--last", "3", "--json")
        assert [run["run_id"] for run in json.loads(result.stdout)["runs"]] == [run_id(7), run_id(8), run_id(9)]

    def test_trend_ends_with_4_where_it_warns(self, config: Path, tmp_path: Path) -> None:
        figure = tmp_path / "trend.png"
        call = ["history", "trend", "--config", str(config), "--of", "EXX", "--figure", str(figure), "--json"]
        result = CliRunner().invoke(main, call)
        assert result.exit_code == 4, result.output
        assert {"EXX", "EXX[1]", "EXX[2]"} == {trend["name"] for trend in json.loads(result.stdout)["trends"]}
        assert "tolerance 12 µm will be reached about 2026-11-1" in result.stderr
        assert figure.read_bytes().startswith(b"\x89PNG")

    def test_export_and_sync(self, config: Path, tmp_path: Path) -> None:
        out = tmp_path / "runs.csv"
        volcal("history", "sync", "--config", config)
        volcal("history", "export", "--config", config, "--out", out)
        assert len(out.read_text().splitlines()) == 11


def test_the_database_is_a_file_by_default(state: Path) -> None:
    address = database_address(settings(state))
    assert isinstance(address, DatabaseAddress)
    assert address.is_file
    assert address.machine == "case-study"
