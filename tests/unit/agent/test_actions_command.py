"""`volcal actions` from files: shims and feet of a machine file, and words for what cannot be proposed."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

import volcal
from agent.cli.offline_commands.actions import actions_command
from agent.language.sentences import german
from agent.workpiece.proposed_actions import action_text, unknown_guides_text
from twin.workpiece.action_fields import ActionKind, MechanicalAction, RaisedFoot, Shim

MACHINE = volcal.shipped_file("machines/case-study.toml")
GUIDES = """
[axes.X.guide]
shoes_mm = 600.0
centre_mm = [0.0, -500.0, -400.0]
[axes.Z.guide]
shoes_mm = 500.0
centre_mm = [-100.0, -600.0, 0.0]
"""
FEET = "".join(
    f'[[feet]]\nname = "{name}"\nat_mm = [{x}, {y}]\n'
    for name, x, y in (
        ("left front", -300, -200),
        ("right front", 4300, -200),
        ("left rear", -300, 900),
        ("4", 4300, 900),
    )
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with an estimate, and with the machine file that states guides and feet."""
    setup, path = volcal.case_study(), tmp_path_factory.mktemp("identified")
    balls = volcal.read_balls(volcal.shipped_file("examples/case-study-balls.csv"), setup.machine)
    volcal.write_estimate(volcal.identify(balls, setup.machine, setup.artefact, order=5), path / "estimate.json")
    _bend_the_rail(path / "estimate.json")
    text = MACHINE.read_text(encoding="utf-8")
    grid = MACHINE.parent / "case-study-deflection.csv"
    (path / "machine.toml").write_text(text.replace('grid = "', f'grid = "{grid.parent}/') + GUIDES + FEET)
    return path


def _bend_the_rail(file: Path) -> None:
    """Add a rail of X to the estimate that lies 30 µm higher in the middle, with the slope of this parabola."""
    document = json.loads(file.read_text(encoding="utf-8"))
    added = {"EZX[2]": -20e-3, "EBX[1]": 3.0 * 20e-3 / 2000.0}
    for one in document["parameters"]:
        one["value"] += added.get(one["name"], 0.0)
    file.write_text(json.dumps(document), encoding="utf-8")


def actions(*arguments: object) -> Result:
    return CliRunner().invoke(actions_command, [str(argument) for argument in arguments], catch_exceptions=False)


def test_the_machine_file_adds_shims(folder: Path) -> None:
    plain, known = (
        json.loads(actions(folder, "--json", *more).stdout) for more in ((), ("--machine", folder / "machine.toml"))
    )
    assert not any(one["kind"] == "straightness" for one in plain["actions"])
    assert known["ve_before"]["expected_um"] == pytest.approx(plain["ve_before"]["expected_um"], rel=2e-3)
    expected = [known["ve_before"]["expected_um"], *(one["ve_after"]["expected_um"] for one in known["actions"])]
    assert len(expected) <= 6
    assert expected == sorted(expected, reverse=True)
    assert expected[-1] <= plain["actions"][-1]["ve_after"]["expected_um"]
    shimmed = [one for one in known["actions"] if one["kind"] == "straightness"]
    assert shimmed
    assert shimmed[0] is known["actions"][0]
    assert (shimmed[0]["axis"], shimmed[0]["towards"]) == ("X", "Z")
    amounts_um = [shim["amount_um"] for shim in shimmed[0]["shims"]]
    assert amounts_um[2] < 1.0
    assert amounts_um[0] == amounts_um[-1] > 15.0
    for one in shimmed:
        assert one["axis"] in "XZ"
        assert len(one["shims"]) == 5
        ends, *between, _ = one["shims"]
        assert min(shim["amount_um"] for shim in one["shims"]) == 0.0
        assert max(abs(shim["amount_um"] - ends["amount_um"]) - shim["expanded_um"] for shim in between) > 0.0
        assert all(f"= {shim['at_mm']:.0f} mm" in one["text"] for shim in between)
    for one in known["actions"]:
        if one["kind"] == "level":
            assert min(one["raised_feet_um"].values()) == 0.0
            assert set(one["raised_feet_um"]) == {"left front", "right front", "left rear", "4"}


def test_people_read_units_and_what_is_not_known(folder: Path) -> None:
    shown = actions(folder).stdout
    assert "µm/m" in shown
    assert "under the rails of X, Y, Z are not proposed" in " ".join(shown.split())
    partly = " ".join(actions(folder, "--machine", folder / "machine.toml").stdout.split())
    assert "under the rails of Y are not proposed" in partly
    assert "axes.Y.guide" in partly


SHIMS = tuple(
    Shim(1000.0 * place - 500.0, 1e-3 * amount, 1e-3) for place, amount in enumerate((9.7, 0.9, 0.0, 4.0, 9.7))
)
BENT = MechanicalAction(ActionKind.STRAIGHTNESS, "X", "Z", 1e-2, 1e-3, 3000.0, 0.0, SHIMS)
RAISED = (RaisedFoot("left front", 3e-3), RaisedFoot("4", 0.0), RaisedFoot("right rear", 4e-3))
TWISTED = MechanicalAction(ActionKind.LEVEL, "X", "X", 2e-6, 1e-6, 4000.0, 0.0, (), RAISED)


@pytest.mark.parametrize(
    ("english", "told"),
    [
        (
            action_text(BENT),
            "Führung von X mit Beilagen in Richtung +Z ausrichten, von einem Ende zum anderen: 9,7 µm, 0,9 µm "
            "(X = 500 mm), 0,0 µm (X = 1500 mm), 4,0 µm (X = 2500 mm), 9,7 µm",
        ),
        (
            action_text(TWISTED),
            "Führung von X nivellieren: um +X drehen, um -1,0 µm/m bei X = 0 mm und +1,0 µm/m bei 4000 mm; diese Füße "
            "des Betts anheben: left front: 3 µm, right rear: 4 µm",
        ),
        (
            f"What helps most: {action_text(TWISTED)} (VE without table 5.2 to 4.9 µm)",
            "Am meisten hilft: Führung von X nivellieren: um +X drehen, um -1,0 µm/m bei X = 0 mm und +1,0 µm/m bei "
            "4000 mm; diese Füße des Betts anheben: left front: 3 µm, right rear: 4 µm (VE ohne Tabelle von 5,2 auf "
            "4,9 µm)",
        ),
        (
            unknown_guides_text(("X", "Z")),
            "Beilagen unter den Führungen von X, Z werden nicht vorgeschlagen: Eine Beilage kippt auch den Schlitten. "
            "Den Abstand seiner Führungswagen in der Maschinendatei angeben (axes.X.guide) und diese Datei mit "
            "--machine nennen.",
        ),
    ],
)
def test_actions_with_several_places_are_told_in_german(english: str, told: str) -> None:
    assert german(english) == told
    assert unknown_guides_text(()) == ""


@pytest.mark.parametrize(
    ("former", "now", "said"),
    [
        ("[0.0, 4000.0]", "[0.0, 3900.0]", "another machine than the estimate"),
        ("shoes_mm = 600.0", "shoes_mm = 0.0", "axes.X.guide.shoes_mm"),
        ("shoes_mm = 600.0", "shoes_mm = 1e-9", "axes.X.guide.shoes_mm"),
        ("shoes_mm = 500.0", "shoes_mm = 5000.0", "axes.Z.guide.shoes_mm"),
        ("centre_mm = [0.0, -500.0, -400.0]", "", "axes.X.guide.centre_mm"),
        ('name = "4"\nat_mm = [4300, 900]', 'name = "left rear"\nat_mm = [4300, 900]', "is listed twice"),
        ("at_mm = [4300, 900]", "at_mm = [4300, inf]", "feet[3].at_mm[1]"),
        ('[[feet]]\nname = "4"\nat_mm = [4300, 900]\n', "", "3 feet cannot twist a bed"),
        ("at_mm = [-300, 900]", "at_mm = [100, -200]", "cannot twist the bed"),
    ],
)
def test_a_machine_file_that_cannot_be_meant_is_one_clear_line(
    folder: Path, tmp_path: Path, former: str, now: str, said: str
) -> None:
    text = (folder / "machine.toml").read_text(encoding="utf-8")
    assert former in text
    (tmp_path / "machine.toml").write_text(text.replace(former, now, 1))
    done = actions(folder, "--machine", tmp_path / "machine.toml")
    assert done.exit_code == 2
    assert said in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
