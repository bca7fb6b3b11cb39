"""Framework of the studies: inputs, output files, registry, simulation."""

from __future__ import annotations

import csv
import inspect
import json
from dataclasses import replace
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from matplotlib.figure import Figure
from study_case import study_case

from agent.cli.main import main
from agent.figures import FIGURE_ENDINGS
from agent.figures.style import picture
from agent.files import check_folder
from agent.planning.case_file import CASE_STUDY, load_case
from agent.studies import STUDIES, monte_carlo
from agent.studies.study import StudyResult, run_study
from agent.studies.study_files import document, format_rows, write_result
from drivers.errors import InputError
from twin.artefact.position_set import parse_position_set
from twin.errors import TwinError
from twin.identification import Options

SUFFIXES = {"png", "svg", "csv", "json"}


FIVE_BALLS = """
name = "five"
certificate = "drawing"
reference_temperature_c = 20.0
cte_per_k = 11.5e-6
cte_standard_uncertainty_per_k = 0.3e-6
ball_diameter_mm = 25.0
holder_length_mm = 60.0
standard_uncertainty_um = 0.8
balls = [[-750, -60, 15.5], [-375, -75.5, 0], [0, -60, -15.5], [375, -44.5, 0], [750, -60, 15.5]]
"""


def line(figure: Figure) -> None:
    figure.add_subplot().plot([0.0, 1.0], [0.0, 2.0], label="a line")


def result(**changes: object) -> StudyResult:
    made = {
        "name": "example",
        "title": "An example",
        "columns": ("balls", "vce_um", "set", "best"),
        "rows": [(3, 1.0 / 3.0, "S1", True), (np.int64(4), np.float64(2e-9), None, np.bool_(False))],
        "summary": {"vce_um": np.float64(2.5), "sets": ["S1"], "counts": np.arange(2), "inner": {"a": np.int64(1)}},
        "draw": line,
    }
    return StudyResult(**{**made, **changes})  # type: ignore[arg-type]


case = partial(study_case, seed=5)


def of_other_machines(_: object) -> StudyResult:
    return result(rows=[(3, "mill", "bar")], columns=("balls", "machine_name", "artefact_name"), subjects=SUBJECTS)


SUBJECTS = (("mill", "bar"), ("bridge", "long bar"))


def test_a_study_of_other_machines_names_them(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(STUDIES, "example", f"{__name__}:{of_other_machines.__name__}")
    found = run_study("example", case())
    assert found.columns == ("balls", "machine_name", "artefact_name")
    assert list(found.rows) == [(3, "mill", "bar")]
    summary = document(found)
    assert summary["subjects"] == [dict(zip(("machine", "artefact"), pair, strict=True)) for pair in SUBJECTS]
    assert not {"machine", "artefact", "balls", "stations"} & set(summary)
    figure = Figure()
    found.draw(figure)
    assert figure.get_suptitle() == "machine mill, artefact bar; machine bridge, artefact long bar"


@pytest.mark.parametrize(
    ("driver", "stated", "counted"),
    [("simulated-operator", 0.0, 3.0), ("simulated-operator", 2.0, 2.0), ("console-operator", 0.0, 0.0)],
)
def test_only_a_simulated_operator_is_replaced_by_a_person(driver: str, stated: float, counted: float) -> None:
    made = case()
    settings = made.job.settings
    name = settings.roles.operator
    changed = settings.model_copy(
        update={
            "timing": settings.timing.model_copy(update={"relocation_minutes": stated}),
            "devices": {**settings.devices, name: settings.devices[name].model_copy(update={"driver": driver})},
        }
    )
    assert replace(made, job=replace(made.job, settings=changed)).relocation_minutes == counted


class TestFiles:
    def test_all_four_are_written_and_say_the_same(self, tmp_path: Path) -> None:
        folder = tmp_path / "new" / "folder"
        files = write_result(result(), folder)
        assert set(files) == SUFFIXES
        assert {path.name for path in folder.iterdir()} == {f"example.{suffix}" for suffix in SUFFIXES}
        assert files["png"].read_bytes().startswith(b"\x89PNG\r\n\x1a\n")
        assert "<svg" in files["svg"].read_text()
        rows = list(csv.reader(files["csv"].read_text().splitlines()))
        assert rows == [["balls", "vce_um", "set", "best"], ["3", "0.33333333", "S1", "yes"], ["4", "2e-09", "", "no"]]
        said = json.loads(files["json"].read_text())
        wanted = {"vce_um": 2.5, "sets": ["S1"], "counts": [0, 1], "inner": {"a": 1}}
        assert said == {"study": "example", "title": "An example", **wanted}

    def test_the_same_result_gives_the_same_bytes(self, tmp_path: Path) -> None:
        first, second = (write_result(result(), tmp_path / name) for name in ("one", "two"))
        assert all(first[suffix].read_bytes() == second[suffix].read_bytes() for suffix in SUFFIXES)

    def test_a_value_that_json_cannot_hold_leaves_no_file(self, tmp_path: Path) -> None:
        with pytest.raises(ValueError, match="JSON"):
            write_result(result(summary={"vce_um": float("nan")}), tmp_path)
        assert list(tmp_path.iterdir()) == []

    def test_a_figure_that_fails_leaves_no_file(self, tmp_path: Path) -> None:
        def broken(_: Figure) -> None:
            raise ArithmeticError("no figure")

        with pytest.raises(ArithmeticError):
            write_result(result(draw=broken), tmp_path)
        assert list(tmp_path.iterdir()) == []

    def test_former_files_are_replaced(self, tmp_path: Path) -> None:
        write_result(result(), tmp_path)
        write_result(result(title="Another"), tmp_path)
        assert json.loads((tmp_path / "example.json").read_text())["title"] == "Another"

    def test_a_row_of_another_width_is_refused(self) -> None:
        with pytest.raises(ValueError, match="3 cells for 4 columns"):
            format_rows(result(rows=[(1, 2.0, "S1")]))

    def test_a_file_in_the_place_of_the_folder_is_found_out_before_the_work(self, tmp_path: Path) -> None:
        (tmp_path / "taken").write_text("")
        for folder in (tmp_path / "taken", tmp_path / "taken" / "below"):
            with pytest.raises(InputError, match="this is a file"):
                check_folder(folder)

    def test_the_figure_has_the_size_asked_for(self) -> None:
        drawn = picture("example", line, (4.0, 2.0))
        width, height = (int.from_bytes(drawn.png[at : at + 4], "big") for at in (16, 20))
        assert (width, height) == (600, 300)

    @pytest.mark.parametrize(
        ("name", "begin"), [("a.png", b"\x89PNG"), ("a.SVG", b"<?xml"), ("a.pdf", b"%PDF-"), ("a.b.PDF", b"%PDF-")]
    )
    def test_the_ending_says_the_format(self, name: str, begin: bytes) -> None:
        drawn, again = (picture("example", line, (4.0, 2.0)).in_format_of(Path(name)) for _ in range(2))
        content = drawn.encode() if isinstance(drawn, str) else drawn
        assert content.startswith(begin)
        assert drawn == again

    def test_an_ending_without_a_format_is_refused(self) -> None:
        with pytest.raises(InputError, match=r"must end with one of \.png, \.svg, \.pdf"):
            picture("example", line, (4.0, 2.0)).in_format_of(Path("a.jpg"))

    def test_every_ending_that_an_option_accepts_has_a_format(self) -> None:
        drawn = picture("example", line, (4.0, 2.0))
        assert all(drawn.in_format_of(Path(f"a{ending}")) for ending in FIGURE_ENDINGS)

    @pytest.mark.parametrize(
        "command", ["history trend", "history thermal", "fe import", "fe model", "fe compare", "predict"]
    )
    def test_a_figure_of_any_command_is_refused_by_its_ending(self, command: str) -> None:
        option = "--map" if command == "predict" else "--figure"
        result = CliRunner().invoke(main, [*command.split(), option, "x.jpg"])
        assert result.exit_code == 2
        assert f"Invalid value for '{option}': 'x.jpg' must end with one of .png, .svg, .pdf" in result.stderr


class TestCase:
    def test_positions_are_those_of_the_settings_unless_a_set_is_asked_for(self) -> None:
        assert case().positions() == load_case(CASE_STUDY, stations=2).positions
        assert case(position_set="S1").positions() == parse_position_set("S1", 2)
        assert case(position_set="S1").positions("S2") == parse_position_set("S2", 2)

    def test_a_position_file_may_stand_for_a_set(self, tmp_path: Path) -> None:
        listed = tmp_path / "own.csv"
        listed.write_text("station,azimuth_deg,elevation_deg\n2,30,10\n1,0,0\n")
        assert [p.station for p in case(position_set=str(listed)).positions()] == [2, 1]

    def test_an_unknown_set_is_named(self) -> None:
        with pytest.raises(TwinError, match="unknown position set 'S9'"):
            case(position_set="S1+S9").positions()

    def test_the_summary_says_what_the_numbers_rest_on(self) -> None:
        facts = case(position_set="S1").facts
        assert facts["machine"] == "case-study"
        assert (facts["stations"], facts["set"], facts["machines"], facts["seed"]) == (2, "S1", 4, 5)

    def test_progress_is_told_what_is_done_and_how_much_there_is(self) -> None:
        told: list[tuple[str, int, int]] = []
        made = case(progress=lambda *said: told.append(said))
        assert made.map(abs, [-1, 2, -3], "numbers") == [1, 2, 3]
        assert told == [("numbers", 0, 3), ("numbers", 1, 3), ("numbers", 2, 3), ("numbers", 3, 3)]


class TestRegistry:
    def test_names_are_those_of_a_command_line(self) -> None:
        assert all(name == name.lower() and " " not in name and "_" not in name for name in STUDIES)

    @pytest.mark.parametrize("name", sorted(STUDIES))
    def test_every_entry_is_a_function_of_a_case(self, name: str) -> None:
        module, _, attribute = STUDIES[name].partition(":")
        run = getattr(import_module(module), attribute)
        assert list(inspect.signature(run).parameters) == ["case"]
        assert (run.__doc__ or "").strip()


class TestClosedFormAndSimulation:
    """Whole study on a small case with deflection.

    The simulation lies within three standard errors of the closed form, which is precise enough to detect a missing
    influence.
    """

    @pytest.mark.parametrize(
        "options",
        [
            Options(formulation="centres", weights="full", use_prior=True),
            Options(formulation="distances", weights="unit", use_prior=True),
        ],
        ids=["centres, full weights", "distances, unit weights"],
    )
    def test_they_agree(self, options: Options, tmp_path: Path) -> None:
        file = tmp_path / "five.toml"
        file.write_text(FIVE_BALLS)
        job = load_case(CASE_STUDY, stations=2, artefact=file)
        said: dict[str, Any] = document(
            run_study("monte-carlo", case(job=job, options=options, machines=200, position_set="S3"))
        )
        assert (said["balls"], said["balls_measured"]) == (5, 60)
        closed, simulated = said["vce_closed_form"], said["vce_scales_as_stated"]
        for kind in ("raw", "aligned"):
            error = simulated[f"{kind}_standard_error_um"]
            assert error < 0.04 * closed[f"{kind}_um"]
            assert abs(simulated[f"{kind}_um"] - closed[f"{kind}_um"]) < 3.0 * error
            stated = (simulated[f"{kind}_um"] - closed[f"{kind}_um"]) / error
            assert said["deviation_in_standard_errors"][kind] == pytest.approx(stated)

    def test_the_study_gives_one_row_for_each_machine(self) -> None:
        made = monte_carlo.run(case())
        assert len(made.rows) == 4
        assert [row[0] for row in made.rows] == [0, 1, 2, 3]
        again = monte_carlo.run(case(machines=2))
        # One matrix product serves all machines, and BLAS may add in another order for another number of them.
        assert [row[:-1] for row in again.rows] == [pytest.approx(row[:-1], rel=1e-12) for row in list(made.rows)[:2]]
        assert [row[-1] for row in made.rows] == [None] * 4  # no machine is refused
        other = monte_carlo.run(case(machines=2, seed=6))
        assert list(other.rows) != list(again.rows)
        assert document(made)["vce_closed_form"] == document(other)["vce_closed_form"]
