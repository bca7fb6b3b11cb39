"""Reading with clear errors, writing completely or not at all."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from agent.files import create_directory, read_text, translated, write_all_atomically, write_atomically
from agent.model_files import load_artefact, load_machine, load_positions
from drivers.errors import ConfigurationError, InputError
from twin.errors import FormatError

CONFIG = Path(__file__).parents[3] / "config"


class TestReading:
    def test_a_missing_file_is_named(self, tmp_path: Path) -> None:
        with pytest.raises(InputError, match="no such file") as caught:
            read_text(tmp_path / "balls.csv")
        assert caught.value.where == {"file": str(tmp_path / "balls.csv")}
        assert caught.value.exit_code == 2

    def test_a_directory_is_refused_as_a_file(self, tmp_path: Path) -> None:
        with pytest.raises(ConfigurationError, match="directory"):
            read_text(tmp_path, error=ConfigurationError)

    def test_a_path_through_a_file_is_refused(self, tmp_path: Path) -> None:
        (tmp_path / "file").write_text("x")
        with pytest.raises(InputError, match="cannot be read: not a directory"):
            read_text(tmp_path / "file" / "balls.csv")

    def test_the_line_of_the_first_byte_that_is_not_utf8_is_named(self, tmp_path: Path) -> None:
        path = tmp_path / "old.csv"
        path.write_bytes(b"first\nsecond \xb5m\n")
        with pytest.raises(InputError, match="UTF-8") as caught:
            read_text(path)
        assert caught.value.where["line"] == "2"

    def test_a_byte_order_mark_is_dropped(self, tmp_path: Path) -> None:
        path = tmp_path / "balls.csv"
        path.write_bytes(b"\xef\xbb\xbfposition,station\n")
        assert read_text(path) == "position,station\n"


class TestTranslation:
    def test_message_locations_and_hint_survive(self) -> None:
        with pytest.raises(InputError) as caught, translated(InputError, file="known-above", run=7):
            raise FormatError("no number", hint="write a number", file="balls.csv", row=3)
        assert caught.value.message == "no number"
        assert caught.value.hint == "write a number"
        assert caught.value.where == {"file": "balls.csv", "row": "3", "run": "7"}

    def test_other_errors_pass(self) -> None:
        with pytest.raises(ZeroDivisionError), translated():
            raise ZeroDivisionError


class TestShippedFiles:
    def test_the_case_study_loads_with_its_deflection_grid(self) -> None:
        machine = load_machine(CONFIG / "machines" / "case-study.toml")
        assert str(machine.model.chain) == "tool-Y-Z-X-bed-workpiece"
        assert machine.deflection is not None

    def test_the_ball_bar_loads(self) -> None:
        assert len(load_artefact(CONFIG / "artefacts" / "ball-bar-1500.toml").balls) == 11

    def test_a_missing_deflection_grid_is_named(self, tmp_path: Path) -> None:
        text = (CONFIG / "machines" / "case-study.toml").read_text()
        (tmp_path / "m.toml").write_text(text)
        with pytest.raises(ConfigurationError, match="no such file") as caught:
            load_machine(tmp_path / "m.toml")
        assert caught.value.where["file"] == str(tmp_path / "case-study-deflection.csv")

    def test_positions_load_in_order(self, tmp_path: Path) -> None:
        path = tmp_path / "set.csv"
        path.write_text("station,azimuth_deg,elevation_deg\n2,45,-10\n1,0,0\n")
        assert [(p.station, p.azimuth_deg, p.elevation_deg) for p in load_positions(path)] == [(2, 45, -10), (1, 0, 0)]


class TestWriting:
    def test_all_files_appear_readable_and_nothing_else(self, tmp_path: Path) -> None:
        out = tmp_path / "deep" / "out"
        write_all_atomically(out, {"a.txt": "1 µm\n", "b.txt": "2\n"})
        assert sorted(path.name for path in out.iterdir()) == ["a.txt", "b.txt"]
        assert (out / "a.txt").read_bytes() == "1 µm\n".encode()
        assert (out / "a.txt").stat().st_mode & 0o777 == 0o644

    def test_an_old_file_is_replaced(self, tmp_path: Path) -> None:
        path = tmp_path / "a.txt"
        path.write_text("old")
        write_atomically(path, "new")
        assert path.read_text() == "new"

    def test_a_failure_in_the_last_file_leaves_the_old_ones(self, tmp_path: Path) -> None:
        (tmp_path / "a.txt").write_text("old")
        (tmp_path / "b.txt").mkdir()
        with pytest.raises(InputError, match="there is a directory in place of"):
            write_all_atomically(tmp_path, {"a.txt": "new", "b.txt": "new"})
        assert (tmp_path / "a.txt").read_text() == "old"
        assert sorted(path.name for path in tmp_path.iterdir()) == ["a.txt", "b.txt"]

    def test_a_file_where_the_directory_should_be(self, tmp_path: Path) -> None:
        (tmp_path / "out").write_text("here")
        for target in (tmp_path / "out", tmp_path / "out" / "deeper"):
            with pytest.raises(InputError, match="a directory is needed"):
                write_all_atomically(target, {"a.txt": "new"})

    def test_a_full_disk_leaves_the_old_file(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        path = tmp_path / "a.txt"
        path.write_text("old")

        def no_space(_handle: int) -> None:
            raise OSError(28, "No space left on device")

        monkeypatch.setattr(os, "fsync", no_space)
        with pytest.raises(InputError, match="no space left on the disk"):
            write_atomically(path, "new")
        assert path.read_text() == "old"
        assert [item.name for item in tmp_path.iterdir()] == ["a.txt"]

    def test_the_data_is_on_the_disk_before_the_name_and_the_name_before_the_return(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        calls: list[str] = []
        sync, replace = os.fsync, Path.replace

        def record_sync(handle: int) -> None:
            calls.append("sync directory" if Path(f"/proc/self/fd/{handle}").resolve().is_dir() else "sync file")
            sync(handle)

        def record_replace(self: Path, target: Path) -> Path:
            calls.append("replace")
            return replace(self, target)

        monkeypatch.setattr(os, "fsync", record_sync)
        monkeypatch.setattr(Path, "replace", record_replace)
        write_atomically(tmp_path / "a.txt", "new")
        assert calls == ["sync file", "replace", "sync directory"]


def test_each_created_directory_is_on_the_disk_with_its_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    synced: list[Path] = []
    monkeypatch.setattr(os, "fsync", lambda handle: synced.append(Path(f"/proc/self/fd/{handle}").resolve()))
    create_directory(tmp_path / "a" / "b")
    assert set(synced) == {tmp_path, tmp_path / "a"}
    synced.clear()
    create_directory(tmp_path / "a" / "b")
    assert synced == []


def test_a_file_that_is_too_large_is_not_read(tmp_path: Path) -> None:
    path = tmp_path / "balls.csv"
    with path.open("wb") as file:
        file.truncate(10**12)  # it takes no place on the disk
    with pytest.raises(InputError, match="larger than 64 MB") as caught:
        read_text(path)
    assert caught.value.where == {"file": str(path)}


def test_a_device_without_an_end_is_not_read() -> None:
    with pytest.raises(InputError, match="larger than 64 MB"):
        read_text(Path("/dev/zero"))
