"""`volcal design` as people run it: files that `volcal plan` takes, and one clear line for every wrong input."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import pytest
from volcal_command import refused, volcal, volcal_json

from twin.formats.position_set_file import parse_positions

CONFIG = Path(__file__).resolve().parents[2] / "config"
COARSE = ("--grid-deg", "90")
CASE = ("--case", "case-study")


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def changed_settings(former: str, now: str) -> str:
    text = (CONFIG / "case-study.toml").read_text()
    for folder in ("machines", "artefacts"):
        text = text.replace(f'"{folder}/', f'"{CONFIG}/{folder}/')
    assert former in text
    Path("settings.toml").write_text(text.replace(former, now, 1))
    return "settings.toml"


def test_a_designed_set_is_one_that_plan_takes_and_values_alike():
    said = volcal_json("design", *CASE, "--slot", "24min", "--verify-set", "--out", "set.csv", "--grid-deg", "45")
    written = parse_positions(Path("set.csv").read_text(), "set.csv")
    assert [position.station for position in written] == [row["station"] for row in said["positions"]]
    assert len(written) >= 2
    assert said["machine_minutes"] <= 24.0
    assert said["rehearsed"] is True
    orientations = dict.fromkeys((row["azimuth_deg"], row["elevation_deg"]) for row in said["held_out"])
    listed = f"positions_deg = {[list(one) for one in orientations]}\nstations = [1, 4]"
    planned = ("--config", changed_settings("stations = [1, 4]", listed), "--position-set", "set.csv")
    plan = volcal_json("plan", *planned, exit_code=7)
    assert said["machine_minutes"] == plan["machine_minutes"]
    assert said["minutes_by_phase"] == plan["minutes_by_phase"]
    assert sum(plan["minutes_by_phase"].values()) == pytest.approx(plan["machine_minutes"], abs=0.003)
    # preflight fits know the radius from the qualification, so their centres are a little better than planned
    assert plan["predicted_vce_um"] == pytest.approx(said["expected_vce_um"], rel=1e-2)
    assert plan["predicted_vce_raw_um"] == pytest.approx(said["expected_vce_raw_um"], rel=1e-2)
    share = said["expected_vce_um"] / said["expected_ve_um"]
    assert said["valuation"] == pytest.approx(100.0 * (1.0 - share))
    held_out = parse_positions(Path("set-verify.csv").read_text(), "set-verify.csv")
    assert not set(held_out) & set(written)
    _assert_front(said)


def _assert_front(said: dict[str, Any]) -> None:
    """CSV and JSON say the same; along the best points more time is a smaller error; the design is one of them."""
    rows = list(csv.DictReader(Path("set-front.csv").read_text().splitlines()))
    assert [int(row["positions"]) for row in rows] == [point["positions"] for point in said["front"]]
    best = [point for point in said["front"] if point["best"]]
    minutes, errors = [p["minutes"] for p in best], [p["vce_um"] for p in best]
    assert minutes == sorted(minutes)
    assert errors == sorted(errors, reverse=True)
    [design] = [point for point in said["front"] if point["design"]]
    assert design["vce_um"] == pytest.approx(said["expected_vce_um"])
    assert Path("set-front.png").read_bytes().startswith(b"\x89PNG")
    assert "<svg" in Path("set-front.svg").read_text()


def test_planned_readings_of_a_laser_make_the_same_positions_worth_more():
    rows = "".join(f"{x},250,200,0.0\n" for x in range(0, 801, 100))
    Path("laser.csv").write_text(
        '# instrument = "laser"\n# tool = "probe"\n# sigma_um = 0.3\nx_mm,y_mm,z_mm,reading_um\n' + rows
    )
    asked = ("design", "--case", "mill", "--positions", "3", *COARSE, "--out", "set.csv")
    alone, joined = volcal_json(*asked), volcal_json(*asked, "--instrument", "laser.csv")
    assert (alone["instruments"], joined["instruments"]) == ([], ["laser.csv"])
    assert len(joined["positions"]) == len(alone["positions"]) == 3
    assert joined["expected_vce_um"] < alone["expected_vce_um"]


def test_a_file_of_planned_readings_that_is_none_is_refused():
    Path("laser.csv").write_text('# instrument = "laser"\nx_mm,y_mm,z_mm,reading_um\n1,2,3,0\n')
    code, line = refused("design", *CASE, "--positions", "3", *COARSE, "--instrument", "laser.csv")
    assert code == 2
    assert "laser.csv" in line


def test_a_target_is_kept_and_the_search_for_an_artefact_shows_every_way():
    said = volcal_json(
        *("design", *CASE, "--target-vce", "6.5", "--touches", "5,9", "--balls", "7", "--out", "set.csv", *COARSE)
    )
    assert said["expected_vce_um"] <= 6.5
    assert [(way["touches_per_ball"], way["artefact_balls"]) for way in said["variants"]] == [(5, 7), (9, 7)]
    [best] = [way for way in said["variants"] if way["best"]]
    reached = [way["machine_minutes"] for way in said["variants"] if not way["reason"]]
    assert best["machine_minutes"] == min(reached)
    assert said["rehearsed"] is False


def test_free_stations_are_places_that_plan_takes_and_values_alike():
    asked = ("design", "--case", "bridge", "--positions", "3", *COARSE, "--out", "set.csv")
    free = volcal_json(*asked, "--free-stations")
    assert free["rehearsed"] is True
    assert str(free["places_mm"]) not in (CONFIG / "bridge.toml").read_text()
    text = (CONFIG / "bridge.toml").read_text()
    for folder in ("machines", "artefacts"):
        text = text.replace(f'"{folder}/', f'"{CONFIG}/{folder}/')
    lines = [f"places_mm = {free['places_mm']}" if line.startswith("places_mm") else line for line in text.splitlines()]
    Path("settings.toml").write_text("\n".join(lines))
    plan = volcal_json("plan", "--config", "settings.toml", "--position-set", "set.csv", exit_code=None)
    assert plan["machine_minutes"] == free["machine_minutes"]
    assert plan["predicted_vce_um"] == pytest.approx(free["expected_vce_um"], rel=2e-2)


def test_stations_with_a_mount_of_their_own_are_not_moved():
    code, line = refused("design", "--case", "two-mounts", "--positions", "3", *COARSE, "--free-stations")
    assert code == 2
    assert "each of them has a mount of its own" in line


def test_people_are_shown_what_a_machine_reads():
    result = volcal("design", *CASE, "--positions", "3", "--verify-set", *COARSE)
    for words in ("benefit", "S3 of the settings", "passed: no collision", "positions_deg = [[", "design.csv"):
        assert words in result.stdout


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((), ["no goal is given", "exactly one of --slot, --positions or --target-vce"]),
        (("--slot", "20min", "--positions", "4"), ["2 goals are given", "exactly one"]),
        (("--slot", "0min"), ["above zero"]),
        (("--positions", "1"), ["cannot separate machine errors from artefact errors"]),
        (("--slot", "0.05h", *COARSE), ["3 min are too short", "shortest two take", "min"]),
        (("--target-vce", "0.2", *COARSE), ["0.20 µm cannot be reached", "µm remain"]),
        (("--positions", "4", "--grid-deg", "7"), ["7° does not divide 90°", "--grid-deg"]),
        (("--positions", "4", "--out", "set.txt"), ["written as CSV", "set.csv"]),
        (("--positions", "4", "--tool", "hammer"), ["no tool 'hammer'", "probe"]),
        (("--positions", "4", "--touches", "6"), ["no pattern of 6 touches", "--touches"]),
        (("--positions", "4", "--machine", "nowhere.toml"), ["no such file", "nowhere.toml"]),
        (("--positions", "900", *COARSE), ["positions can be measured, but 900 were requested"]),
    ],
)
def test_wrong_input_is_one_clear_line(arguments: tuple[str, ...], words: list[str]):
    code, line = refused("design", *CASE, *arguments)
    assert code == 2
    for word in words:
        assert word in line


@pytest.mark.parametrize(("option", "text"), [("--slot", "soon"), ("--touches", "five"), ("--stations", "0")])
def test_what_is_no_number_is_refused_by_its_option(option: str, text: str):
    code, line = refused("design", *CASE, option, text)
    assert code == 2
    assert option in line


def test_a_station_without_a_place_and_one_out_of_reach_name_the_settings():
    settings = changed_settings("[procedure]", "[procedure]\nstations = [9]")
    code, line = refused("design", "--config", settings, "--positions", "4")
    assert code == 2
    assert "station 9" in line
    assert settings in line
    far = "places_mm = [[9700.0, 9000.0, 750.0], [1567.0, 1000.0, 750.0]"
    settings = changed_settings("places_mm = [[700.0, 1000.0, 750.0], [1567.0, 1000.0, 750.0]", far)
    code, line = refused("design", "--config", settings, "--positions", "4")
    assert code == 2
    assert "station 1" in line
