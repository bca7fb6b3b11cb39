"""The settings that are shipped, and the schema that is committed."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest
from volcal_command import volcal

from agent.model_files import load_artefact, load_machine
from agent.planning.design.artefact_costs import load_costs
from agent.planning.job_preparation import prepare_job
from agent.settings.load import load_settings
from agent.settings.schema import parse_settings
from drivers.registry import check_options
from simulators.scenario import read_scenario
from twin.errors import FormatError
from twin.finite_elements.structure_file import parse_structure

CONFIG = Path(__file__).resolve().parents[3] / "config"
READERS = {
    "machines": load_machine,
    "artefacts": load_artefact,
    "costs": load_costs,
    "simulators": read_scenario,
    "structures": lambda path: parse_structure(path.read_text(encoding="utf-8"), str(path)),
    "config": lambda path: prepare_job(load_settings(path), path.parent),
    "linuxcnc": lambda path: prepare_job(load_settings(path), path.parent),
    "examples": lambda path: [
        check_options(device["driver"], device["options"], name)
        for name, device in tomllib.loads(path.read_text())["devices"].items()
    ],
}


def test_committed_schema_is_the_present_one() -> None:
    printed = volcal("config", "schema")
    committed = (CONFIG / "schema" / "settings.json").read_text()
    assert printed.stdout == committed, "run `make schema`"


@pytest.mark.parametrize("path", sorted(CONFIG.rglob("*.toml")), ids=lambda path: str(path.relative_to(CONFIG)))
def test_every_shipped_file_loads(path: Path) -> None:
    assert READERS[path.parent.name](path)


def test_paths_are_relative_to_the_file_that_names_them(monkeypatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    settings = load_settings(CONFIG / "case-study.toml")
    assert settings.machine == CONFIG / "machines" / "case-study.toml"
    assert settings.state_directory == CONFIG.parent / "runs"


@pytest.mark.parametrize(
    ("former", "now", "key"),
    [
        ("stations = [1, 4]", "stations = [1, 5]", "station 5"),
        ('kind = "lockstep"', 'kind = "sundial"', "clock.kind"),
        ("port = 5021", "port = 70000", "clock.port"),
        ("[verification]", "[verification]\npositions_deg = []", "verification.positions_deg"),
        ("[procedure]", "[procedure]\ntouches_per_ball = 7", "procedure.touches_per_ball"),
        ("[stations]", "[mount]\ncolour = 1\n[stations]", "colour"),
        ("[stations]", "[probe]\ncolour = 1\n[stations]", "colour"),
        ("[stations]", "[mount]\npost_radius_mm = 1\n[stations]", "post_radius_mm"),
    ],
)
def test_wrong_value_names_file_and_key(former: str, now: str, key: str) -> None:
    text = (CONFIG / "case-study.toml").read_text()
    assert former in text
    with pytest.raises(FormatError) as caught:
        parse_settings(text.replace(former, now, 1), "volcal.toml")
    assert "volcal.toml" in str(caught.value)
    assert key in str(caught.value)
