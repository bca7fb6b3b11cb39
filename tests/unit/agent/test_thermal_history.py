"""`volcal history thermal` and `volcal history now` on a season of a machine that shares no code with the program."""

from __future__ import annotations

import json
import shutil
import sqlite3
from datetime import timedelta
from functools import partial
from pathlib import Path
from typing import Any, Self

import numpy as np
import pytest
from click.testing import CliRunner, Result

from agent.cli import temperatures_now, thermal_history
from agent.cli.history import history_group
from agent.execution.run_lock import ownership, run_lock
from agent.runs.offline import thermometer_reading
from campaigns.foreign.score import true_error_um
from campaigns.sensors.season_files import SeasonFiles, run_id, write_season
from twin.formats.estimate_file import parse_estimate

NIGHTS, NUMBER, HOURS = 24, 0, 12


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> SeasonFiles:
    return write_season(tmp_path_factory.mktemp("season"), NUMBER, NIGHTS)


@pytest.fixture
def files(written: SeasonFiles, tmp_path: Path) -> SeasonFiles:
    """A copy that the test may change."""
    shutil.copytree(written.folder, tmp_path / "season")
    return SeasonFiles(tmp_path / "season", written.season)


def call(files: SeasonFiles, name: str, *options: object) -> Result:
    arguments = [name, "--config", str(files.settings), *map(str, options)]
    return CliRunner().invoke(history_group, arguments, prog_name="volcal history")


def called(files: SeasonFiles, name: str, *options: object) -> dict:
    result = call(files, name, *options, "--json")
    assert result.exit_code == 0, result.output
    return json.loads(result.stdout)


def refused(result: Result) -> str:
    assert result.exit_code == 2, result.output
    return result.stderr


def readings(files: SeasonFiles, hours: int) -> list[object]:
    return [
        text for name, value in files.temperatures_c(hours).items() for text in ("--temperature", f"{name}={value}")
    ]


def change_database(files: SeasonFiles, statement: str, *values: str) -> None:
    [database] = (files.folder / "state").glob("*.sqlite*")
    with sqlite3.connect(database) as connection:
        connection.execute(statement, values)
    connection.close()


class LookedAtThermometer:
    """Thermometer that only opens to look."""

    def __init__(self, readings: dict[str, float], reason: str = "") -> None:
        self.readings, self.reason, self.log = readings, reason, list[str]()

    def why_no_look(self) -> str:
        return self.reason

    def open_to_look(self, *, tables: bool = False) -> None:
        self.log.append("tables" if tables else "look")

    def close(self) -> None:
        self.log.append("close")

    def temperatures_c(self) -> dict[str, float]:
        assert self.log == ["look"]
        return self.readings


class ToldClient:
    """Client of a service that answers with `told`."""

    def __init__(self, told: dict[str, Any], _settings: object) -> None:
        self.told = told

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def get(self, path: str) -> dict[str, Any]:
        assert path == "/api/status"
        return self.told


class TestThermal:
    def test_the_drift_is_explained_and_drawn(self, files: SeasonFiles) -> None:
        found = called(files, "thermal", "--figure", files.folder / "thermal.png")
        taken = [one["name"] for one in found["sensors"] if one["taken"]]
        assert taken
        assert found["nights"] == NIGHTS
        assert found["left_out_nights"]["with_sensors_um"] < found["left_out_nights"]["without_sensors_um"]
        assert (files.folder / "thermal.png").read_bytes().startswith(b"\x89PNG")

    @pytest.mark.parametrize(("name", "begin"), [("drift.pdf", b"%PDF-"), ("drift.svg", b"<?xml")])
    def test_the_figure_has_the_format_of_its_ending(self, files: SeasonFiles, name: str, begin: bytes) -> None:
        called(files, "thermal", "--figure", files.folder / name)
        assert (files.folder / name).read_bytes().startswith(begin)

    def test_the_effect_of_the_ram_is_the_true_one(self, files: SeasonFiles) -> None:
        """The generator lets the scale of Y grow with the ram; a Legendre slope is half the change over the travel."""
        [(_, over_travel_mm, _, _)] = [one for one in files.season.thermal.effects if one[0] == "EYY"]
        found = called(files, "thermal", "--sensor", "ram")
        [effect] = [one["per_k"]["ram"] for one in found["errors"] if one["name"] == "EYY[1]"]
        assert abs(effect["value"] - 500.0 * over_travel_mm) < 3.0 * effect["standard_uncertainty"]
        assert abs(effect["value"]) > 5.0 * effect["standard_uncertainty"]

    def test_the_table_names_every_sensor(self, files: SeasonFiles) -> None:
        text = call(files, "thermal").stdout
        assert all(name in text for name in ("column", "ram", "bed", "air", "explains"))

    def test_a_sensor_that_sticks_is_left_out_and_named(self, files: SeasonFiles) -> None:
        change_database(files, "UPDATE volcal_temperatures SET mean = 21.5 WHERE sensor = 'ram'")
        [ram] = [one for one in called(files, "thermal")["sensors"] if one["name"] == "ram"]
        assert not ram["taken"]
        assert "stuck" in ram["reason"]

    def test_temperatures_that_do_not_change_are_refused(self, files: SeasonFiles) -> None:
        change_database(files, "UPDATE volcal_temperatures SET mean = 20.0 + 0.001 * random() / 9.3e18")
        assert "constant" in refused(call(files, "thermal"))

    def test_a_sensor_that_nobody_recorded_is_refused(self, files: SeasonFiles) -> None:
        message = refused(call(files, "thermal", "--sensor", "spindle"))
        assert "'spindle' (option --sensor). " in message
        assert "recorded sensors: air, artefact, bed, column, ram" in message

    @pytest.mark.parametrize(
        ("stated", "expected"),
        [
            ('["ram", "air", "ram"]', "the sensor 'ram' is named twice"),
            ('["ram", "artefact"]', "the sensor 'artefact' is one of temperature.artefact_sensors"),
        ],
    )
    def test_sensors_that_cannot_explain_a_drift_are_no_settings(
        self, files: SeasonFiles, stated: str, expected: str
    ) -> None:
        with files.settings.open("a", encoding="utf-8") as file:
            file.write(f"[temperature]\ndrift_sensors = {stated}\n")
        message = refused(call(files, "thermal"))
        assert expected in message
        assert f"file {files.settings}, key temperature.drift_sensors" in message

    @pytest.mark.parametrize(
        ("names", "expected"),
        [
            (["ram", "air", "ram"], "the sensor 'ram' is named twice"),
            (["ram", "artefact"], "does not explain a drift of the machine"),
            (["air", "bed", "column", "ram", "spindle"], "has recorded the sensor 'spindle'"),
        ],
    )
    def test_sensors_of_the_option_that_cannot_be_used_name_the_option(
        self, files: SeasonFiles, names: list[str], expected: str
    ) -> None:
        message = refused(call(files, "thermal", *(text for name in names for text in ("--sensor", name))))
        assert f"{expected} (option --sensor)" in message

    def test_a_sensor_of_the_settings_that_nobody_recorded_names_the_key(self, files: SeasonFiles) -> None:
        with files.settings.open("a", encoding="utf-8") as file:
            file.write('[temperature]\ndrift_sensors = ["spindle"]\n')
        message = refused(call(files, "thermal"))
        assert f"'spindle' (key temperature.drift_sensors, file {files.settings})" in message

    def test_more_recorded_sensors_than_can_be_used_name_the_key(self, files: SeasonFiles) -> None:
        change_database(
            files,
            "INSERT INTO volcal_temperatures (machine, run_id, sensor, lowest, mean, highest) "
            "SELECT machine, run_id, 'head', lowest, mean, highest FROM volcal_temperatures WHERE sensor = 'ram'",
        )
        message = refused(call(files, "thermal"))
        assert "5 sensors (air, bed, column, head, ram) are too many" in message
        assert "(key temperature.drift_sensors, " in message
        assert "(option --sensor)" in refused(
            call(
                files,
                "thermal",
                *[text for name in ("air", "bed", "column", "head", "ram") for text in ("--sensor", name)],
            )
        )

    def test_without_any_sensor_it_says_so(self, files: SeasonFiles) -> None:
        change_database(files, "DELETE FROM volcal_temperatures WHERE sensor <> 'artefact'")
        assert "no run has recorded a temperature sensor of the machine" in refused(call(files, "thermal"))

    def test_too_few_nights_are_refused(self, files: SeasonFiles) -> None:
        change_database(files, "DELETE FROM volcal_runs WHERE run_id > ?", run_id(5))
        change_database(files, "DELETE FROM volcal_parameters WHERE run_id > ?", run_id(5))
        assert "6 nights" in refused(call(files, "thermal"))

    def test_gaps_leave_nights_out(self, files: SeasonFiles) -> None:
        change_database(files, "DELETE FROM volcal_temperatures WHERE sensor = 'ram' AND run_id = ?", run_id(4))
        assert called(files, "thermal")["nights"] == NIGHTS - 1

    def test_a_night_whose_former_estimate_is_gone_does_not_count_it_again(self, files: SeasonFiles) -> None:
        (files.folder / "state" / run_id(10) / "estimate.json").unlink()
        found = called(files, "thermal")
        assert found["nights"] == NIGHTS - 2  # it, and the night that was fused with it
        assert found["nights_without_former_estimate"] == 2
        assert (found["nights_without_temperatures"], found["nights_without_file"]) == (0, 0)
        assert "note: 2 nights are left out: each was fused with the night before" in call(files, "thermal").stdout

    def test_a_calibration_in_full_whose_table_was_taken_back_needs_no_former_estimate(
        self, files: SeasonFiles
    ) -> None:
        state = files.folder / "state"
        shutil.copy(state / run_id(0) / "estimate.json", state / run_id(12) / "estimate.json")
        (state / run_id(11) / "estimate.json").unlink()
        change = "UPDATE volcal_runs SET night = 'former table restored' WHERE run_id = ?"
        change_database(files, change, run_id(12))
        assert called(files, "thermal")["nights_without_former_estimate"] == 1

    def test_a_calibration_without_file_counts_with_its_uncertainties(self, files: SeasonFiles) -> None:
        (files.folder / "state" / run_id(0) / "estimate.json").unlink()
        found = called(files, "thermal")
        assert (found["nights"], found["nights_without_file"]) == (NIGHTS - 1, 1)
        assert found["nights_without_former_estimate"] == 1

    def test_too_few_nights_whose_own_measurement_is_known_are_refused(self, files: SeasonFiles) -> None:
        for night in range(7, NIGHTS - 1):
            (files.folder / "state" / run_id(night) / "estimate.json").unlink()
        message = refused(call(files, "thermal"))
        assert "7 nights with an estimate are too few" in message
        assert "17 more were fused with an estimate whose file is gone" in message


class TestNow:
    def test_temperatures_and_positions_bring_the_estimate_nearer_to_the_truth(self, files: SeasonFiles) -> None:
        out, machine = files.folder / "now", files.season.machine_at(HOURS)
        balls = files.write_balls(HOURS)
        options = ("--at", files.at(HOURS).isoformat(), "--out", out, "--measured", balls)
        found = called(files, "now", *options, *readings(files, HOURS))
        left = [
            true_error_um(machine, parse_estimate(path.read_text(), path.name))
            for path in (
                files.folder / "state" / run_id(NIGHTS - 1) / "estimate.json",
                out / "predicted.json",
                out / "estimate.json",
            )
        ]
        assert left[1] < 0.8 * left[0]
        assert left[2] < 0.8 * left[0]
        assert found["age_days"] == pytest.approx(HOURS / 24.0)
        assert found["predicted"]["vce_um"] > found["then"]["vce_um"]
        assert found["measured"]["vce_um"] > left[2] / 2.0
        assert found["positions_fit"] is True

    def test_at_once_and_at_the_same_temperatures_nothing_changes(self, files: SeasonFiles) -> None:
        out = files.folder / "now"
        called(files, "now", "--at", files.at(0).isoformat(), "--out", out, *readings(files, 0))
        before = json.loads((files.folder / "state" / run_id(NIGHTS - 1) / "estimate.json").read_text())
        after = json.loads((out / "predicted.json").read_text())
        first, second = (np.array([one["value"] for one in each["parameters"]]) for each in (before, after))
        assert np.abs(second - first).max() < 3e-6  # mm: readings are rounded to 1 mK

    def test_without_temperatures_the_thermometer_is_read(
        self, files: SeasonFiles, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        device = LookedAtThermometer({**files.temperatures_c(6), "spindle": 30.0, "broken": float("nan")})
        monkeypatch.setattr(thermometer_reading, "create_device", lambda *_: device)
        monkeypatch.setattr(thermal_history, "utc_timestamp", lambda: files.at(6).isoformat())
        options = ("--out", files.folder / "now")
        found = called(files, "now", *options)
        assert device.log == ["look", "close"]
        assert found["temperatures_from"] == "twin"
        assert found["temperatures_c"] == pytest.approx(files.temperatures_c(6))
        stated = called(files, "now", "--at", files.at(6).isoformat(), *options, *readings(files, 6))
        assert stated["temperatures_from"] is None
        assert stated["errors"] == found["errors"]
        ram = files.temperatures_c(6)["ram"]
        device.log.clear()
        shown = call(files, "now", *options).stdout
        assert "temperatures (given by the device twin): air " in shown
        assert f"ram {ram:.2f} °C" in shown

    @pytest.mark.parametrize(
        ("device", "expected", "code"),
        [
            ({"look": "it would restart"}, "cannot be read: it would restart (device twin", 3),
            ({"readings": {"air": 20.0}}, "sensor ram, which explains the drift, is not known (device twin)", 2),
        ],
    )
    def test_a_thermometer_that_does_not_tell_is_named(
        self, files: SeasonFiles, monkeypatch: pytest.MonkeyPatch, device: dict[str, Any], expected: str, code: int
    ) -> None:
        found = LookedAtThermometer(device.get("readings", {}), device.get("look", ""))
        monkeypatch.setattr(thermometer_reading, "create_device", lambda *_: found)
        monkeypatch.setattr(thermal_history, "utc_timestamp", lambda: files.at(6).isoformat())
        result = call(files, "now", "--out", files.folder / "now")
        assert result.exit_code == code, result.output
        assert expected in result.stderr
        assert not (files.folder / "now").exists()

    def test_the_thermometer_of_a_machine_in_use_is_left_alone(
        self, files: SeasonFiles, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        device = LookedAtThermometer(files.temperatures_c(6))
        monkeypatch.setattr(thermometer_reading, "create_device", lambda *_: device)
        with run_lock(files.folder / "state", "20260314T030000Z-0000"):
            result = call(files, "now", "--out", files.folder / "now")
        assert "the machine is owned by run 20260314T030000Z-0000" in result.stderr
        assert "--temperature" in result.stderr
        assert device.log == []

    def test_the_temperatures_of_a_machine_of_the_service_are_those_it_has_read(
        self, files: SeasonFiles, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        told = {"temperatures_c": {**files.temperatures_c(6), "open wire": 850.0}, "temperatures_age_s": 1800.0}
        monkeypatch.setattr(temperatures_now, "Client", partial(ToldClient, told))
        now = files.at(6) + timedelta(seconds=8.0)
        monkeypatch.setattr(thermal_history, "utc_timestamp", now.isoformat)
        options = ("--out", files.folder / "now")
        with ownership(files.folder / "state", "the service"):
            message = call(files, "now", *options).stderr
            assert "the machine is owned by the service" in message  # half an hour ago is not now
            told["temperatures_age_s"] = 8.0
            found = called(files, "now", *options)
        assert found["temperatures_from"] == "twin"
        assert found["temperatures_c"] == pytest.approx(files.temperatures_c(6))
        stated = called(files, "now", "--at", files.at(6).isoformat(), *options, *readings(files, 6))
        assert stated["age_days"] == found["age_days"]
        assert stated["errors"] == found["errors"]

    @pytest.mark.parametrize(
        "told",
        [
            {},
            {"temperatures_c": {}, "temperatures_age_s": None},
            {"temperatures_c": {"air": "warm"}, "temperatures_age_s": 1.0},
            {"temperatures_c": {"air": 20.0}, "temperatures_age_s": -1.0},
            {"temperatures_c": [20.0], "temperatures_age_s": 1.0},
        ],
    )
    def test_a_service_without_a_reading_of_now_owns_the_machine(
        self, files: SeasonFiles, monkeypatch: pytest.MonkeyPatch, told: dict[str, Any]
    ) -> None:
        monkeypatch.setattr(temperatures_now, "Client", partial(ToldClient, told))
        with ownership(files.folder / "state", "the service"):
            result = call(files, "now", "--out", files.folder / "now")
        assert "the machine is owned by the service" in result.stderr
        assert "--temperature" in result.stderr

    def test_the_last_estimate_is_moved_even_if_nothing_is_learned_from_it(self, files: SeasonFiles) -> None:
        (files.folder / "state" / run_id(NIGHTS - 2) / "estimate.json").unlink()
        options = ("--at", files.at(6).isoformat(), "--out", files.folder / "now", *readings(files, 6))
        assert called(files, "now", *options)["run"] == run_id(NIGHTS - 1)

    def test_a_missing_temperature_is_named(self, files: SeasonFiles) -> None:
        message = refused(call(files, "now", "--at", files.at(6).isoformat(), "--out", files.folder / "now"))
        assert (
            "the temperature of the sensor ram, which explains the drift, is not known (option --temperature)"
            in message
        )

    def test_an_old_estimate_predicts_nothing(self, files: SeasonFiles) -> None:
        options = ("--at", files.at(24 * 9).isoformat(), "--out", files.folder / "now")
        assert "9.0 days" in refused(call(files, "now", *options, *readings(files, 6)))
        assert not (files.folder / "now").exists()

    @pytest.mark.parametrize(
        ("texts", "expected"),
        [
            (["column"], "'column' is not NAME=DEGREES"),
            (["column=warm"], "'column=warm' is not NAME=DEGREES"),
            (["column=nan"], "'column=nan' is not between -30 and 90"),
            (["column=inf"], "'column=inf' is not between -30 and 90"),
            (["column=294.6"], "'column=294.6' is not between -30 and 90"),  # kelvins
            (["ram=21", "ram=22"], "'ram' is stated twice"),
        ],
    )
    def test_a_temperature_that_is_none_is_refused(self, files: SeasonFiles, texts: list[str], expected: str) -> None:
        options = [each for text in texts for each in ("--temperature", text)]
        assert expected in refused(call(files, "now", "--out", files.folder / "now", *options))

    def test_a_time_that_is_none_in_utc_is_refused(self, files: SeasonFiles) -> None:
        options = ("--out", files.folder / "now", "--at", "0001-01-01T00:00+14:00")
        assert "is not a time" in refused(call(files, "now", *options))

    def test_positions_that_cannot_be_read_leave_nothing(self, files: SeasonFiles) -> None:
        out, balls = files.folder / "now", files.folder / "empty.csv"
        balls.write_text("", encoding="utf-8")
        options = ("--at", files.at(6).isoformat(), "--out", out, "--measured", balls)
        assert "empty.csv" in refused(call(files, "now", *options, *readings(files, 6)))
        assert not out.exists()

    def test_a_new_prediction_removes_the_estimate_and_table_of_the_former(self, files: SeasonFiles) -> None:
        out = files.folder / "now"
        out.mkdir()
        (out / "estimate.json").write_text('{"provenance": {"run_id": "identify-20260313T150000Z"}}', encoding="utf-8")
        (out / "table.csv").write_text("former", encoding="utf-8")
        called(files, "now", "--at", files.at(6).isoformat(), "--out", out, *readings(files, 6))
        assert [path.name for path in out.iterdir()] == ["predicted.json"]

    def test_a_temperature_that_the_nights_never_had_is_extrapolated(self, files: SeasonFiles) -> None:
        out, given = files.folder / "now", {**files.temperatures_c(6), "ram": 31.0}
        texts = [text for name, value in given.items() for text in ("--temperature", f"{name}={value}")]
        options = ("--at", files.at(6).isoformat(), "--out", out, "--measured", files.write_balls(6), *texts)
        [ram] = [one for one in called(files, "now", *options)["extrapolated"] if one["name"] == "ram"]
        assert (ram["value_c"], ram["of_run"]) == (31.0, False)
        assert (ram["lowest_c"], ram["highest_c"]) == pytest.approx((16.297, 19.724), abs=1e-3)
        sentence = "the sensor ram shows 31.00 °C now, but its effect was learned at 16.30 to 19.72 °C"
        for name in ("predicted.json", "estimate.json"):
            assert sentence in json.loads((out / name).read_text(encoding="utf-8"))["provenance"]["extrapolated"]
        assert f"note: {sentence}: the result is extrapolated" in call(files, "now", *options).stdout

    def test_temperatures_like_those_of_the_nights_are_not_extrapolated(self, files: SeasonFiles) -> None:
        out = files.folder / "now"
        options = ("--at", files.at(0).isoformat(), "--out", out, *readings(files, 0))
        assert called(files, "now", *options)["extrapolated"] == []
        assert "extrapolated" not in json.loads((out / "predicted.json").read_text(encoding="utf-8"))["provenance"]
        assert "extrapolated" not in call(files, "now", *options).stdout

    def test_the_folder_of_a_run_is_refused(self, files: SeasonFiles) -> None:
        run = files.folder / "state" / run_id(NIGHTS - 1)
        options = ("--at", files.at(6).isoformat(), "--out", run, *readings(files, 6))
        assert "would replace the estimate of a run" in refused(call(files, "now", *options))
        assert [path.name for path in run.iterdir()] == ["estimate.json"]

    def test_a_last_run_without_the_reading_is_named(self, files: SeasonFiles) -> None:
        last = run_id(NIGHTS - 1)
        change_database(files, "DELETE FROM volcal_temperatures WHERE sensor = 'ram' AND run_id = ?", last)
        options = ("--at", files.at(6).isoformat(), "--out", files.folder / "now", "--sensor", "ram")
        message = refused(call(files, "now", *options, "--temperature", "ram=21"))
        assert "no usable reading of the sensor ram" in message
        assert last in message

    def test_an_unknown_sensor_is_refused(self, files: SeasonFiles) -> None:
        options = ("--at", files.at(6).isoformat(), "--out", files.folder / "now", "--temperature", "spindle=30")
        assert "unknown sensor 'spindle' (option --temperature)" in refused(call(files, "now", *options))
