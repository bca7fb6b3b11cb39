"""Old runs are compacted: they read as before, whatever happens meanwhile, and what may still change is left alone."""

from __future__ import annotations

import gzip
import json
import math
import shutil
import sqlite3
import subprocess
import sys
from collections.abc import Callable
from contextlib import closing
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as st
from journal_surgery import is_intact, operate
from journaled import estimate
from service_house import PATIENCE_S

from agent.cli.main import main
from agent.errors import JournalFailed, PlanRefused
from agent.execution.journal import Journal, RunJournal
from agent.execution.journal_compaction import compactable_runs, packed_record, store_packed
from agent.execution.journal_copy import copy_journal
from agent.execution.journal_reader import open_journal
from agent.execution.journal_schema import FILE_NAME, VERSION, WHOLE_VERSION
from agent.execution.packed_run import PackedRun
from agent.execution.run_lock import ownership
from agent.execution.run_record import read_record, read_steps
from agent.execution.states import RunState
from agent.execution.steps import MoveTo, ReadTemperatures, Record, TouchTowards
from agent.files import read_text
from agent.history.retention import Compaction, compact, due_runs
from agent.history.run_row import run_rows
from agent.settings.history import HistorySettings
from drivers.clock import VirtualClock
from drivers.errors import InputError
from drivers.roles import Touch
from twin.formats.compressed_text import MAX_TEXT_BYTES, compress_text, expand_text

CONFIG = Path(__file__).resolve().parents[3] / "config"
SETTINGS = {
    "machine": str(CONFIG / "machines" / "case-study.toml"),
    "artefact": str(CONFIG / "artefacts" / "ball-bar-1500.toml"),
    "procedure": {"position_set": "S3"},
}
LATE = datetime(2100, 1, 1, tzinfo=UTC)
AT_ONCE = HistorySettings(whole_runs=1, whole_days=0.0)
ESTIMATE = json.dumps({**estimate(3.0), "text": "µm" * 500}, ensure_ascii=False) + "\n"


def run_id(number: int) -> str:
    return f"run-{number}"


def write_run(
    journal: Journal, number: int, ends: RunState | None = RunState.COMPLETE, touches: int = 40
) -> RunJournal:
    """A run that has measured: touches with every kind of number, a step aside, a failure, a question."""
    clock = VirtualClock()
    run = journal.start_run(run_id(number), "calibrate", SETTINGS, "1.0", clock)
    run.origin({"kind": "calibrate"})
    run.begun()
    for place in range(touches):
        clock.sleep(math.pi / (place + 1))
        touch = TouchTowards(f"ball-{place:02d}/touch µ", (place / 7.0, 1e-300, -0.1), 5.0)
        run.begin(touch)
        clock.sleep(1.0 / 3.0)
        run.finish(touch, Touch((place / 3.0, 5e-324, 0.1 + 0.2)), begun=True)
        run.finish(ReadTemperatures(f"t-{place}"), {"artefact": 20.0 + place / 9.0}, begun=False)
        run.finish(Record(f"ball-{place:02d}/centre", "ball", {"ball": place, "x": 1.0 / 3.0}), None, begun=False)
    missed = TouchTowards("missed", (1.0, 2.0, 3.0), 5.0)
    run.begin(missed)
    run.fail(missed, ValueError("no contact"))
    run.aside().begin(MoveTo("recover/withdraw", (0.0, 0.0, 0.0)))
    run.table("backup", 1, None)
    run.estimate(json.dumps(estimate(1.0)))
    run.estimate(ESTIMATE)
    run.decision("outcome", {"machine_minutes": 83.5})
    if ends is not None:
        run.state(ends, "as it should", final=True)
    return run


@pytest.fixture
def state(tmp_path: Path) -> Path:
    """Three runs; the first has the folder of its results."""
    directory = tmp_path / "state"
    journal = Journal(directory)
    for number in range(3):
        write_run(journal, number)
    journal.close()
    folder = directory / run_id(0)
    folder.mkdir()
    (folder / "estimate.json").write_text(ESTIMATE, encoding="utf-8")
    (folder / "report.html").write_text("report", encoding="utf-8")
    (folder / "table.csv").write_text("table", encoding="utf-8")
    return directory


def compact_due(directory: Path, settings: HistorySettings = AT_ONCE) -> list[Compaction | None]:
    return [compact(directory, row, write=True) for row in due_runs(directory, settings, LATE)]


def all_that_is_read(directory: Path) -> dict[str, Any]:
    """Everything that any reader reads of any run."""
    found: dict[str, Any] = {}
    with open_journal(directory) as reader:
        found["runs"] = (reader.runs(), reader.run_counts(100), tuple(reader.latest_begun_runs()))
        for row in reader.runs():
            run = row.run
            found[row.run_id] = (
                reader.steps(run),
                reader.steps(run, "MoveTo"),
                reader.steps(run, procedure_only=True),
                reader.touches(run),
                reader.balls(run),
                reader.temperatures(run),
                reader.estimates(run),
                reader.last_estimate(run),
                (reader.count_steps(run), reader.count_touches(run), reader.count_balls(run)),
                (reader.time_span_s(run), reader.last_ordinal(run), reader.last_step_key(run)),
                (reader.has_worked(run), reader.ordinal_of(run, "ball-01/touch µ")),
                reader.tables(run),
                reader.events(run),
                reader.decisions(run),
            )
    for name in [row.run_id for row in found["runs"][0]]:
        record = read_record(directory, name)
        found[f"{name}/record"] = (record, run_rows(record) if record.estimate else None, read_steps(directory, name))
    return found


def test_a_compacted_run_reads_as_before(state: Path) -> None:
    before, size = all_that_is_read(state), (state / FILE_NAME).stat().st_size
    first, second = compact_due(state)
    assert first is not None
    assert second is not None
    assert 0 < first.after_bytes < first.before_bytes / 2
    assert all_that_is_read(state) == before
    with open_journal(state) as reader:
        assert reader.compacted_runs() == {1, 2}
    assert is_intact(state)
    assert compact_due(state) == []
    journal = Journal(state)  # later runs are written into the free space
    write_run(journal, 3)
    journal.close()
    assert (state / FILE_NAME).stat().st_size <= size + 4096


def test_the_files_of_a_compacted_run_are_read_by_their_former_names(state: Path) -> None:
    compact_due(state)
    folder = state / run_id(0)
    assert sorted(path.name for path in folder.iterdir()) == ["estimate.json.gz", "report.html", "table.csv"]
    assert [(folder / name).read_text() for name in ("report.html", "table.csv")] == ["report", "table"]
    assert read_text(folder / "estimate.json") == read_text(folder / "estimate.json.gz") == ESTIMATE
    assert gzip.decompress((folder / "estimate.json.gz").read_bytes()).decode() == ESTIMATE
    with pytest.raises(InputError, match="no such file"):
        read_text(folder / "balls.csv")


def test_a_copy_of_a_journal_with_compacted_runs_reads_the_same(state: Path, tmp_path: Path) -> None:
    compact_due(state)
    target = tmp_path / "copy"
    target.mkdir()
    copy_journal(state, target, lambda settings: settings)
    with open_journal(state) as one, open_journal(target) as other:
        assert one.steps(1) == other.steps(1)
        assert one.balls(1) == other.balls(1)


def test_a_journal_is_refused_by_earlier_programs_only_once_a_run_is_compacted(state: Path) -> None:
    def version() -> int:
        with closing(sqlite3.connect(state / FILE_NAME)) as connection:
            return int(connection.execute("PRAGMA user_version").fetchone()[0])

    assert version() == WHOLE_VERSION
    compact_due(state)
    assert version() == VERSION


def test_a_journal_of_an_earlier_program_is_read_and_compacted(state: Path) -> None:
    operate(state, "DROP TABLE compacted_runs")
    before = all_that_is_read(state)
    assert len(compact_due(state)) == 2
    assert all_that_is_read(state) == before


class TestRunsLeftAlone:
    """What may still change, or is young, is not compacted."""

    def due(self, state: Path, **changes: Any) -> list[str]:
        settings = AT_ONCE.model_copy(update=changes)
        return [row.run_id for row in due_runs(state, settings, LATE)]

    def test_the_latest_runs(self, state: Path) -> None:
        assert self.due(state) == [run_id(0), run_id(1)]
        assert self.due(state, whole_runs=2) == [run_id(0)]
        assert self.due(state, whole_runs=3) == self.due(state, whole_runs=10) == []

    def test_runs_that_ended_lately(self, state: Path) -> None:
        operate(state, "UPDATE runs SET ended = '2099-12-20T00:00:00.000Z' WHERE run = 1")
        assert self.due(state, whole_days=12.0) == [run_id(1)]
        assert self.due(state, whole_days=11.9) == [run_id(0), run_id(1)]

    def test_all_runs_if_it_is_switched_off(self, state: Path) -> None:
        assert self.due(state, compact=False) == []

    def test_a_run_that_has_not_ended(self, state: Path) -> None:
        operate(state, "UPDATE runs SET ended = NULL, state = 'measuring' WHERE run = 1")
        operate(state, "UPDATE runs SET state = ? WHERE run = 2", RunState.WRITTEN.value)
        assert self.due(state) == []

    def test_the_last_run_that_measured_though_others_were_refused_since(self, state: Path) -> None:
        journal = Journal(state)
        for number in range(3, 6):
            journal.start_run(run_id(number), "verify", SETTINGS, "1.0", VirtualClock()).state(
                RunState.REFUSED, "not warm", final=True
            )
        journal.close()
        assert self.due(state) == [run_id(0), run_id(1)]

    def test_the_last_run_that_read_the_compensation(self, state: Path) -> None:
        operate(state, "DELETE FROM tables WHERE run = 3")
        assert self.due(state) == [run_id(0)]

    def test_a_state_directory_without_a_run(self, tmp_path: Path) -> None:
        assert self.due(tmp_path) == []
        Journal(tmp_path).close()
        assert self.due(tmp_path) == []


def test_a_compacted_run_is_not_continued(state: Path) -> None:
    compact_due(state)
    journal = Journal(state)
    with pytest.raises(PlanRefused, match="has been compacted and can no longer be resumed"):
        journal.continue_run(1, run_id(0), VirtualClock())
    again, recorded = journal.continue_run(3, run_id(2), VirtualClock())
    journal.close()
    assert (again.run, len(recorded.steps)) == (3, 80)


def test_a_reader_that_is_open_sees_the_run_before_and_after(state: Path) -> None:
    with open_journal(state) as reader:
        before = (reader.steps(1), reader.balls(1), reader.last_estimate(1))
        compact_due(state)
        assert (reader.steps(1), reader.balls(1), reader.last_estimate(1)) == before
        assert len(reader.steps(2)) == len(reader.steps(1)) == len(reader.steps(3))


def test_a_run_that_changes_while_it_is_packed_stays_whole(state: Path) -> None:
    record = packed_record(state, 1)
    assert record is not None
    operate(state, "DELETE FROM steps WHERE run = 1 AND ordinal = 5")
    before = all_that_is_read(state)
    with pytest.raises(JournalFailed, match="was changed while it was compacted"):
        store_packed(state, record)
    assert all_that_is_read(state) == before


def test_a_run_with_a_record_that_is_no_text_stays_whole(state: Path) -> None:
    operate(state, "UPDATE estimates SET record = x'00ff' WHERE run = 1")
    operate(state, "UPDATE steps SET detail = x'00ff' WHERE run = 2 AND ordinal = 1")
    assert compact_due(state) == [None, None]
    assert (state / run_id(0) / "estimate.json").is_file()


@pytest.mark.parametrize("table", ["steps SET detail", "balls SET record", "estimates SET record"])
def test_a_run_with_a_text_that_is_not_utf_8_stays_whole_and_the_next_is_compacted(state: Path, table: str) -> None:
    operate(state, f"UPDATE {table} = CAST(x'22ff22' AS TEXT) WHERE run = 1")
    first, second = compact_due(state)
    assert first is None
    assert second is not None


def _zeros(_: bytes) -> bytes:
    return compress_text(bytes(MAX_TEXT_BYTES + 1))


DAMAGE: dict[str, Callable[[bytes], bytes]] = {
    "a byte": lambda content: content[: len(content) // 2] + b"\xff" + content[len(content) // 2 + 1 :],
    "the end": lambda content: content[:-9],
    "all": lambda content: b"",
    "more": lambda content: content + b"x",
    "another text": lambda content: compress_text(b'{"steps": 1}'),
    "rows that are none": lambda content: compress_text(b'{"steps": [1], "balls": [], "temperatures": []}'),
    "short rows": lambda content: compress_text(b'{"steps": [[1]], "balls": [], "temperatures": []}'),
    "nested": lambda content: compress_text(200_000 * b"["),
    "a bomb": _zeros,
}


@pytest.mark.parametrize("what", DAMAGE)
def test_damage_of_a_compacted_record_is_told(state: Path, what: str) -> None:
    compact_due(state)
    with closing(sqlite3.connect(state / FILE_NAME)) as connection:
        [(content,)] = connection.execute("SELECT content FROM compacted_runs WHERE run = 1")
    operate(state, "UPDATE compacted_runs SET content = ? WHERE run = 1", DAMAGE[what](content))
    with pytest.raises(InputError, match="the journal is damaged: the record of a compacted run") as caught:
        read_record(state, run_id(0))
    assert "restore the journal from a copy" in caught.value.hint
    assert read_record(state, run_id(1)).balls == 40  # the others can still be read


@pytest.mark.parametrize("what", ["a byte", "the end", "all", "more", "a bomb"])
def test_damage_of_a_compacted_estimate_is_told(state: Path, what: str) -> None:
    compact_due(state)
    text = compress_text(ESTIMATE.encode())
    operate(state, "UPDATE estimates SET record = ? WHERE run = 1", DAMAGE[what](text))
    with open_journal(state) as reader, pytest.raises(InputError, match="the journal is damaged"):
        reader.last_estimate(1)


@pytest.mark.parametrize("what", ["a byte", "the end", "more", "a bomb"])
def test_damage_of_a_compressed_file_names_it(state: Path, what: str) -> None:
    compact_due(state)
    path = state / run_id(0) / "estimate.json.gz"
    path.write_bytes(DAMAGE[what](path.read_bytes()))
    with pytest.raises(InputError, match="the compressed text is") as caught:
        read_text(state / run_id(0) / "estimate.json")
    assert caught.value.where == {"file": str(path)}
    assert caught.value.hint


CELLS = st.none() | st.integers(-(2**63), 2**63 - 1) | st.floats(allow_nan=False, allow_infinity=False) | st.text()


@given(
    st.lists(st.tuples(*[CELLS] * 9), max_size=5),
    st.lists(st.tuples(*[CELLS] * 3), max_size=5),
    st.lists(st.tuples(*[CELLS] * 3), max_size=5),
)
def test_packed_rows_keep_every_bit(steps: list[Any], balls: list[Any], temperatures: list[Any]) -> None:
    rows = {"steps": steps, "balls": balls, "temperatures": temperatures}
    packed = PackedRun(rows)
    again = PackedRun.unpacked(compress_text(packed.text))
    assert repr({table: [tuple(row) for row in found] for table, found in again.rows.items()}) == repr(rows)
    assert again.balls == len(balls)


@pytest.mark.parametrize("text", ["", "a", "µ" * 1000, "x" * 4096])
def test_a_text_is_expanded_up_to_its_limit(text: str) -> None:
    data = text.encode()
    assert expand_text(compress_text(data), max(len(data), 1)) == data
    assert compress_text(data) == compress_text(data)


ON_A_FULL_DISK = """
import resource, signal, sys
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
from agent.cli.main import main
import agent.cli.history, agent.history.retention, agent.settings.load, agent.execution.journal_compaction
sys.dont_write_bytecode = True  # a module imported from now on would leave a truncated file for all later imports
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv.pop(1)),) * 2)
main(prog_name="volcal")
"""


def settings_file(directory: Path, state: Path) -> Path:
    text = (CONFIG / "case-study.toml").read_text(encoding="utf-8")
    for name in ("machines", "artefacts"):
        text = text.replace(f'"{name}/', f'"{CONFIG / name}/')
    text = text.replace('"../runs"', json.dumps(str(state)))
    path = directory / "volcal.toml"
    path.write_text(f"{text}\n[history]\nwhole_runs = 1\nwhole_days = 0.0\n", encoding="utf-8")
    return path


@pytest.mark.parametrize("limit", [100, 6_000, 20_000], ids=["file", "journal", "later"])
def test_a_full_disk_leaves_every_run_readable(state: Path, tmp_path: Path, limit: int) -> None:
    before = all_that_is_read(state)
    config = settings_file(tmp_path, state)
    command = [sys.executable, "-c", ON_A_FULL_DISK, str(limit), "history", "compact", "--config", str(config)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S, check=False)
    assert done.returncode in (2, 4), done.stderr
    assert "Traceback" not in done.stderr
    assert "error: " in done.stderr
    assert all_that_is_read(state) == before
    assert read_text(state / run_id(0) / "estimate.json") == ESTIMATE
    assert not [path for path in (state / run_id(0)).iterdir() if path.name.startswith(".")]
    assert len(compact_due(state)) == 2  # with space again, it is done
    assert all_that_is_read(state) == before


class TestCommand:
    def invoke(self, state: Path, tmp_path: Path, *options: str) -> Any:
        config = settings_file(tmp_path, state)
        return CliRunner().invoke(main, ["history", "compact", "--config", str(config), *options])

    def test_a_dry_run_says_what_would_be_saved_and_writes_nothing(self, state: Path, tmp_path: Path) -> None:
        before = (state / FILE_NAME).read_bytes()
        with ownership(state, "the service (process 1)"):
            result = self.invoke(state, tmp_path, "--dry-run", "--json")
        assert result.exit_code == 0, result.output
        said = json.loads(result.stdout)
        assert (said["dry_run"], said["left"], [run["run_id"] for run in said["runs"]]) == (True, 0, ["run-0", "run-1"])
        assert (state / FILE_NAME).read_bytes() == before
        assert (state / run_id(0) / "estimate.json").is_file()
        done = json.loads(self.invoke(state, tmp_path, "--json").stdout)
        assert done["runs"] == said["runs"]

    def test_the_file_becomes_smaller(self, state: Path, tmp_path: Path) -> None:
        before = all_that_is_read(state)
        said = json.loads(self.invoke(state, tmp_path, "--json").stdout)
        assert said["journal_after_bytes"] == (state / FILE_NAME).stat().st_size < said["journal_before_bytes"]
        assert all_that_is_read(state) == before

    def test_the_file_becomes_smaller_if_the_service_has_compacted_the_runs_before(
        self, state: Path, tmp_path: Path
    ) -> None:
        before = all_that_is_read(state)
        assert len(compact_due(state)) == 2
        said = json.loads(self.invoke(state, tmp_path, "--json").stdout)
        assert said["runs"] == []
        assert said["journal_after_bytes"] < said["journal_before_bytes"]
        assert all_that_is_read(state) == before
        again = json.loads(self.invoke(state, tmp_path, "--json").stdout)
        assert again["journal_after_bytes"] == again["journal_before_bytes"]

    def test_a_state_directory_without_a_journal_has_nothing_to_compact(self, tmp_path: Path) -> None:
        assert json.loads(self.invoke(tmp_path / "state", tmp_path, "--json").stdout)["runs"] == []

    def test_the_table_states_every_run_and_the_sum(self, state: Path, tmp_path: Path) -> None:
        result = self.invoke(state, tmp_path)
        assert result.exit_code == 0, result.output
        assert [word in result.stdout for word in ("run-0", "run-1", "run-2", "all")] == [True, True, False, True]
        assert "2 runs compacted; journal " in result.stderr
        assert "0 runs compacted" in self.invoke(state, tmp_path).stderr

    def test_nothing_is_written_while_another_process_owns_the_machine(self, state: Path, tmp_path: Path) -> None:
        before = (state / FILE_NAME).read_bytes()
        with ownership(state, "the service (process 1)"):
            result = self.invoke(state, tmp_path)
        assert result.exit_code == 4
        assert "the machine is owned by the service (process 1)" in result.stderr
        assert (state / FILE_NAME).read_bytes() == before


def test_the_last_run_that_worked_is_never_among_the_compactable_ones(state: Path) -> None:
    for whole in range(4):
        assert 3 not in {row.run for row in compactable_runs(state, whole, LATE)}


def test_a_leftover_of_an_interrupted_compaction_is_removed(state: Path) -> None:
    """The power failed between the compressed file and the removal of the other one."""
    folder = state / run_id(0)
    (folder / "estimate.json.gz").write_bytes(compress_text(b"half"))
    assert read_text(folder / "estimate.json") == ESTIMATE
    compact_due(state)
    assert sorted(path.name for path in folder.iterdir()) == ["estimate.json.gz", "report.html", "table.csv"]
    assert read_text(folder / "estimate.json") == ESTIMATE


def test_a_run_without_its_folder_is_compacted(state: Path) -> None:
    shutil.rmtree(state / run_id(0))
    assert len(compact_due(state)) == 2
