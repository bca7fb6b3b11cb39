"""`volcal predict` and `volcal acceptance` from files: figures, verdicts, pictures, and words for what cannot be."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import pytest
from click.testing import CliRunner, Result
from hypothesis import given
from hypothesis import strategies as st

import volcal
from agent.cli.offline_commands.acceptance import acceptance_command
from agent.cli.offline_commands.predict import predict_command
from agent.printable import no_formula

PLATE = volcal.shipped_file("examples/bearing-plate.csv")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with an estimate and a table, as `volcal identify` writes it."""
    setup, path = volcal.case_study(), tmp_path_factory.mktemp("identified")
    balls = volcal.read_balls(volcal.shipped_file("examples/case-study-balls.csv"), setup.machine)
    estimate = volcal.identify(balls, setup.machine, setup.artefact, order=5)
    volcal.write_estimate(estimate, path / "estimate.json")
    volcal.write_table(volcal.compensation_table(estimate, balls), path / "table.csv")
    return path


def predict(*arguments: object) -> Result:
    return CliRunner().invoke(predict_command, [str(argument) for argument in arguments], catch_exceptions=False)


def test_the_table_and_the_library_agree(folder: Path, tmp_path: Path) -> None:
    out, picture = tmp_path / "out.csv", tmp_path / "places.png"
    done = predict(PLATE, "--estimate", folder, "--at", "1000,500,400", "--json", "-o", out, "--map", picture)
    found = json.loads(done.stdout)
    assert done.exit_code == 0
    assert found["table"] == str(folder / "table.csv")
    library = volcal.predict_features(
        volcal.read_estimate(folder / "estimate.json"),
        volcal.read_features(PLATE),
        found["origin_mm"],
        table=volcal.read_table(folder / "table.csv"),
    )
    for one, stated in zip(library, found["features"], strict=True):
        assert one.with_table is not None
        assert stated["name"] == one.feature.name
        assert stated["with_table"]["expected_um"] == pytest.approx(1e3 * one.with_table.expected_mm, abs=1e-4)
        assert stated["without_table"]["expanded_um"] == pytest.approx(1e3 * one.without_table.expanded_mm, abs=1e-4)
    rows = list(csv.DictReader(out.read_text(encoding="utf-8").splitlines()))
    assert [row["name"] for row in rows] == [one.feature.name for one in library]
    assert picture.read_bytes().startswith(b"\x89PNG")
    shown = predict(PLATE, "--estimate", folder / "estimate.json", "--at", "1000,500,400").stdout
    assert all(one.feature.name in shown for one in library)
    assert "ISO 14253-1" in shown


def test_no_name_is_a_formula_for_a_spreadsheet(folder: Path, tmp_path: Path) -> None:
    """Names as OWASP lists them (CSV injection), and harmless ones, which stay as they are."""
    names = ["=HYPERLINK(1)", "+1", "-2+3", "@SUM(A1)", "bore A", "a=b", "'quoted"]
    lines = list(csv.reader(PLATE.read_text(encoding="utf-8").splitlines()))
    side = next(line for line in lines if line[:2] == ["side", "point"])
    rows = [[name, "point", str(100 * number), *side[3:]] for number, name in enumerate(names)]
    features, out = tmp_path / "features.csv", tmp_path / "out.csv"
    with features.open("w", encoding="utf-8", newline="") as text:
        csv.writer(text).writerows([*lines[:4], *rows])  # the header and three datum points
    done = predict(features, "--estimate", folder, "--at", "1000,500,400", "--no-table", "--json", "-o", out)
    assert [one["name"] for one in json.loads(done.stdout)["features"]][-len(names) :] == names
    written = [one["name"] for one in csv.DictReader(out.read_text(encoding="utf-8").splitlines())][-len(names) :]
    assert written == ["'=HYPERLINK(1)", "'+1", "'-2+3", "'@SUM(A1)", *names[4:]]


@given(st.text(min_size=1))
def test_what_begins_like_a_formula_is_text(name: str) -> None:
    shown = no_formula(name)
    assert shown.endswith(name)
    assert shown[0] not in "=+-@\t\r\n"


def test_without_the_table_something_stays_undecided(folder: Path) -> None:
    done = predict(PLATE, "--estimate", folder, "--no-table", "--at", "1000,500,400", "--json")
    found = json.loads(done.stdout)
    assert done.exit_code == 4
    assert found["table"] is None
    assert "undecided" in {one["without_table"]["conformity"] for one in found["features"]}


def test_the_best_place_is_no_worse_than_another(folder: Path) -> None:
    best = json.loads(predict(PLATE, "--estimate", folder, "--at", "best", "--height", 400, "--json").stdout)
    assert best["origin_mm"] == best["places"]["best_mm"]
    assert min(map(min, best["places"]["largest"])) < 1.0


@pytest.mark.parametrize(
    ("arguments", "code", "said"),
    [
        (["--at", "5000,500,400"], 2, "Place the workpiece elsewhere"),
        (["--at", "here"], 2, "'here' is not X,Y,Z in mm"),
        (["--at", "best"], 2, "--height belongs to --at best"),
        (["--at", "1000,500,400", "--height", "3"], 2, "--height belongs to --at best"),
        (["--at", "1000,500,400", "--map", "places.jpg"], 2, "'places.jpg' must end with one of .png, .svg, .pdf"),
        (["--at", "1000,500,400", "--table", "missing.csv"], 2, "there is no such file"),
        (["--at", "1000,500,400", "--table", "t.csv", "--no-table"], 2, "exclude each other"),
    ],
)
def test_what_cannot_be_predicted_is_said(folder: Path, arguments: list[str], code: int, said: str) -> None:
    done = predict(PLATE, "--estimate", folder, *arguments)
    assert done.exit_code == code
    assert said in done.output


def test_no_result_replaces_what_is_read(folder: Path, tmp_path: Path) -> None:
    plate = tmp_path / "plate.csv"
    plate.write_bytes(PLATE.read_bytes())
    done = predict(plate, "--estimate", folder, "--at", "1000,500,400", "-o", plate)
    assert done.exit_code == 2
    assert "would be replaced" in done.output
    assert plate.read_bytes() == PLATE.read_bytes()


@pytest.mark.parametrize("option", ["-o", "--map"])
@pytest.mark.parametrize("name", ["estimate.json", "table.csv", "table.json"])
def test_no_result_replaces_a_file_in_the_folder_of_the_estimate(tmp_path: Path, option: str, name: str) -> None:
    (tmp_path / name).write_text("of the run", encoding="utf-8")
    (tmp_path / "places.svg").symlink_to(tmp_path / name)
    target = tmp_path / (name if option == "-o" else "places.svg")
    done = predict(PLATE, "--estimate", tmp_path, "--at", "1000,500,400", option, target)
    assert done.exit_code == 2
    assert "would be replaced" in done.output
    assert (tmp_path / name).read_text(encoding="utf-8") == "of the run"


def test_the_map_does_not_replace_the_predictions(tmp_path: Path) -> None:
    both = tmp_path / "places.svg"
    done = predict(PLATE, "--estimate", tmp_path, "--at", "1000,500,400", "-o", both, "--map", both)
    assert done.exit_code == 2
    assert "would be replaced" in done.output
    assert not both.exists()


def test_an_estimate_that_is_none_is_refused(tmp_path: Path) -> None:
    (tmp_path / "estimate.json").write_text("{}", encoding="utf-8")
    done = predict(PLATE, "--estimate", tmp_path, "--at", "1000,500,400")
    assert done.exit_code == 2
    assert str(tmp_path / "estimate.json") in done.output


def accept(*arguments: object) -> Result:
    return CliRunner().invoke(acceptance_command, [str(argument) for argument in arguments], catch_exceptions=False)


def test_acceptance_tests_are_stated_and_drawn(folder: Path, tmp_path: Path) -> None:
    drawn = tmp_path / "drawn"
    done = accept("--estimate", folder, "--radius", 100, "--radius", 300, "--json", "--draw", drawn)
    assert done.exit_code == 0
    document = json.loads(done.stdout)
    tests = document["tests"]
    assert document["not_measured"] == ["not measured: A, A±, E, R, R±, B: the estimate is not in the folder of a run"]
    angles = [one for one in tests if one["figure"][1] in "ABC" and one["figure"][0] == "E"]
    assert len(angles) == 9
    assert all(one["with_table"] == one["without_table"] for one in angles)
    tests = [one for one in tests if one not in angles]
    assert [one["standard"] for one in tests].count("ISO 230-4") == 6
    spans = dict.fromkeys(("curve_um", "curve_with_table_um"), 0.0)
    for one in tests:
        assert one["without_table"]["low_um"] <= one["without_table"]["expected_um"] <= one["without_table"]["high_um"]
        if one["figure"].startswith("squareness"):
            assert "curve_um" not in one
            continue
        assert len(one["curve_um"]) == len(one["curve_expanded_um"]) == len(one["curve_with_table_um"])
        spans = {name: span + max(one[name]) - min(one[name]) for name, span in spans.items()}
    assert spans["curve_with_table_um"] < 0.2 * spans["curve_um"]
    assert (drawn / "acceptance.png").read_bytes().startswith(b"\x89PNG")
    assert (drawn / "acceptance.svg").read_text(encoding="utf-8").count("ISO 230-4") == 6
    shown = accept("--estimate", folder, "--no-table").stdout
    assert "range of the mean positioning deviations" in " ".join(shown.split())
    assert "with table" not in shown


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--radius", "900"], "leaves the travel of the machine"),
        (["--centre", "1,2"], "'1,2' is not X,Y,Z in mm"),
        (["--centre", "1,2,1e9"], "no place on a machine tool"),
        (["--table", "t.csv", "--no-table"], "exclude each other"),
    ],
)
def test_acceptance_tests_that_cannot_be_are_said(folder: Path, arguments: list[str], said: str) -> None:
    done = accept("--estimate", folder, *arguments)
    assert done.exit_code == 2
    assert said in done.output
