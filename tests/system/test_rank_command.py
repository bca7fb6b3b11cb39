"""`volcal rank`: what it says of the case study, with one tool and with several, and what it says of wrong input."""

from __future__ import annotations

import json
import shutil
from functools import cache
from pathlib import Path

import pytest
from click.testing import CliRunner
from volcal_command import volcal

from agent.cli.main import main

CONFIG = Path(__file__).resolve().parents[2] / "config"
MACHINE = CONFIG / "machines" / "case-study.toml"
SETTINGS = CONFIG / "case-study.toml"
CASE = ("--case", "case-study")
COARSE = ("--grid", "20x10x10")
MORE_TOOLS = """
[tools.long]
offset_mm = [0.0, 450.0, 0.0]
[tools.side]
offset_mm = [0.0, 250.0, -100.0]
"""


def said(*arguments: str | Path) -> str:
    result = volcal("rank", *CASE, *arguments)
    return result.stdout


@cache
def case_study() -> dict:
    """The shipped case study as it stands."""
    return json.loads(said("--json"))


@pytest.fixture
def more_tools(tmp_path: Path) -> Path:
    shutil.copy(MACHINE.parent / "case-study-deflection.csv", tmp_path)
    (tmp_path / "m.toml").write_text(MACHINE.read_text().replace("[model]", MORE_TOOLS + "\n[model]", 1))
    return tmp_path / "m.toml"


class TestCaseStudy:
    def test_rank_and_names(self) -> None:
        found = case_study()
        assert (found["position_set"], found["formulation"], found["tools"]) == ("S3", "centres", ["probe"])
        assert (found["rank"], found["parameters"]) == (70, 90)
        assert "EBY[1..5]: not seen with one straight probe along Y" in found["null_summary"]
        assert len(found["null_directions"]) == 20
        assert not any(direction["changes_field"] for direction in found["null_directions"])
        assert found["balls"] == 264 - found["unreachable_balls"]

    def test_sigma_of_each_parameter(self) -> None:
        sigma = case_study()["sigma"]
        assert len(sigma) == 90
        assert sigma["EBY[1]"]["posterior"] == pytest.approx(sigma["EBY[1]"]["prior"], rel=1e-6)
        assert sigma["EYY[1]"]["prior"] == pytest.approx(8e-3 / 3**0.5)
        assert sigma["EYY[1]"]["posterior"] < 0.3 * sigma["EYY[1]"]["prior"]
        assert {one["unit"] for one in sigma.values()} == {"mm", "rad"}

    def test_the_unseen_field_at_every_tool(self) -> None:
        own, *others = case_study()["fields"]
        assert own["measured"]
        assert own["blind_um"] < 1e-3
        assert own["blind_um"] <= own["unseen_um"] < own["predicted_vce_um"] < own["prior_um"]
        assert [field["tool"] for field in others] == ["200 mm longer", "lateral +100 mm X", "lateral +100 mm Z"]
        for field in others:
            assert not field["measured"]
            assert 0.2 < field["blind_um"] < field["unseen_um"] < field["predicted_vce_um"] < field["prior_um"]
            assert field["unseen_um"] > own["unseen_um"]

    def test_the_vce_is_that_of_the_preflight(self) -> None:
        done = CliRunner().invoke(main, ["plan", "--config", str(SETTINGS), "--json"])
        planned = json.loads(done.stdout)
        assert planned["rank"] == case_study()["rank"]
        assert case_study()["fields"][0]["predicted_vce_um"] == pytest.approx(planned["predicted_vce_um"], rel=0.1)

    def test_one_certified_length_replaces_most_of_the_certificate(self) -> None:
        found, own = case_study()["certificate"], case_study()["fields"][0]
        assert found["present"] == "certificate"
        assert found["certificate"]["standard_uncertainty_um"] == pytest.approx(0.8)
        assert found["certificate"]["predicted_vce_um"] == pytest.approx(own["predicted_vce_um"], rel=1e-9)
        assert found["one_length"]["balls"] == [0, 10]
        assert found["one_length"]["standard_uncertainty_um"] == pytest.approx(0.8 * 2**0.5, rel=1e-3)
        assert 0.0 < found["one_length"]["cost_percent"] < 10.0
        assert found["nothing"]["cost_percent"] > 25.0
        assert found["nothing"]["predicted_vce_um"] > found["one_length"]["predicted_vce_um"]

    def test_advice_is_best_first(self) -> None:
        advice = case_study()["advice"]
        removed = [one["unseen_removed_um"] for one in advice]
        assert removed == sorted(removed, reverse=True)
        longer = next(one for one in advice if one["tool_offset_mm"] == [0.0, 450.0, 0.0])
        assert longer["rank_gained"] == 10
        assert longer["positions"] == 24
        aside = next(one for one in advice if one["tool_offset_mm"] == [0.0, 250.0, -100.0])
        assert aside["rank_gained"] == 15
        assert {one["added_set"] for one in advice if one["added_set"]} == {"S1", "S2"}

    def test_people_read_words(self) -> None:
        text = said(*COARSE)
        assert "Seen: 70 of 90 parameters" in text
        assert "EBZ[1..5]: not seen with one straight probe along Y" in text
        assert "CROSS[b1]" in text
        assert "What would show more, the most first:" in text
        assert "a probe 200 mm longer" in text
        assert max(map(len, text.splitlines())) < 140


def test_advice_comes_true(more_tools: Path) -> None:
    """With the tools that were proposed, rank and unseen field are what was said of them."""
    advice = {tuple(one["tool_offset_mm"]): one for one in case_study()["advice"] if one["tool_offset_mm"]}
    for name, offset in (("long", (0.0, 450.0, 0.0)), ("side", (0.0, 250.0, -100.0))):
        found = json.loads(said("--machine", more_tools, "--tool", "probe", "--tool", name, "--json"))
        assert found["tools"] == ["probe", name]
        assert found["rank"] == 70 + advice[offset]["rank_gained"]
        assert found["fields"][0]["unseen_um"] == pytest.approx(advice[offset]["fields"][0]["unseen_um"], rel=1e-6)
        assert found["fields"][1]["measured"]
        assert offset not in [tuple(one["tool_offset_mm"]) for one in found["advice"] if one["tool_offset_mm"]]


def test_a_file_may_say_which_tool_measures_what(more_tools: Path, tmp_path: Path) -> None:
    rows = [f"{s},{az},{el},{t}" for t in ("", "side") for s in (1, 2, 3, 4) for az, el in ((45, 0), (0, 45), (90, 45))]
    (tmp_path / "p.csv").write_text("\n".join(["station,azimuth_deg,elevation_deg,tool", *rows, ""]))
    found = json.loads(said("--machine", more_tools, "--set", tmp_path / "p.csv", "--json", *COARSE))
    assert found["tools"] == ["probe", "side"]
    assert [field["measured"] for field in found["fields"]][:2] == [True, True]
    assert not any("EBY" in line for line in found["null_summary"])


def test_both_formulations_leave_the_same_field_unseen() -> None:
    """Distances and centres with free poses leave the same directions undetermined."""
    fields = [
        json.loads(said("--set", "S2", "--formulation", way, "--json", *COARSE))["fields"][0]
        for way in ("centres", "distances")
    ]
    # Equal but for rounding, which depends on the BLAS of the CPU: measured differences are at most 6e-13 um of 5 um.
    assert fields[0]["unseen_um"] == pytest.approx(fields[1]["unseen_um"], rel=1e-9)


class TestWrongInput:
    @staticmethod
    def refused(*arguments: str | Path) -> str:
        result = CliRunner().invoke(main, ["rank", *CASE, *map(str, arguments)])
        assert result.exit_code == 2, (result.exit_code, result.output)
        assert result.stdout == ""
        [line] = result.stderr.strip().splitlines()
        return line.removeprefix("error: ")

    @pytest.mark.parametrize(
        ("rows", "words"),
        [
            ("1,45,0", ["cannot separate machine errors from artefact errors", "p.csv", "at least two positions"]),
            ("1,45,0\n1,45,up", ["'up' is not a finite number", "p.csv", "row 3", "elevation_deg"]),
            ("7,45,0\n1,0,45", ["station 7 has no location", "p.csv", "1, 2, 3, 4"]),
            ("1,90,0\n2,90,0", ["none of the 2 positions has three balls within reach", "p.csv"]),
            ("", ["no position is listed", "p.csv"]),
        ],
        ids=["identifies nothing", "no number", "no such station", "out of reach", "empty"],
    )
    def test_a_set_that_is_of_no_use(self, rows: str, words: list[str], tmp_path: Path) -> None:
        (tmp_path / "p.csv").write_text(f"station,azimuth_deg,elevation_deg\n{rows}\n")
        line = self.refused("--set", tmp_path / "p.csv")
        for word in words:
            assert word in line

    @pytest.mark.parametrize(
        ("arguments", "words"),
        [
            (["--set", "S9"], ["'S9'", "S1, S2, S3"]),
            (["--set", "none.csv"], ["no such file", "none.csv"]),
            (["--tool", "drill"], ["no tool 'drill'", "probe"]),
            (["--tool", "probe", "--tool", "drill"], ["no tool 'drill'", "case-study.toml", "probe"]),
            (["--grid", "60x1x20"], ["does not cover the workspace", "axis Y", "0 to 1300 mm"]),
            (["--machine", "none.toml"], ["no such file", "none.toml"]),
        ],
    )
    def test_a_wrong_option(self, arguments: list[str], words: list[str]) -> None:
        line = self.refused(*arguments)
        for word in words:
            assert word in line

    def test_a_deflection_grid_that_does_not_cover_the_workspace(self, tmp_path: Path) -> None:
        lines = (MACHINE.parent / "case-study-deflection.csv").read_text().splitlines()
        header = next(n for n, line in enumerate(lines) if line.startswith("x"))
        highest = max(float(line.split(",")[0]) for line in lines[header + 1 :])
        kept = [line for line in lines[header + 1 :] if float(line.split(",")[0]) < highest]
        (tmp_path / "case-study-deflection.csv").write_text("\n".join([*lines[: header + 1], *kept, ""]))
        shutil.copy(MACHINE, tmp_path / "m.toml")
        line = self.refused("--machine", tmp_path / "m.toml")
        assert "does not cover the travel" in line
        assert "deflection.grid" in line
        assert "m.toml" in line

    def test_a_file_of_bytes(self, tmp_path: Path) -> None:
        (tmp_path / "p.csv").write_bytes(b"\xff\xfe\x00")
        assert "not UTF-8 text" in self.refused("--set", tmp_path / "p.csv")
