"""Wrong input through the real command: one clear line each, the exit code, and nothing written."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest
from nights import document
from volcal_command import refused, volcal

CONFIG = Path(__file__).resolve().parents[2] / "config"


@pytest.fixture
def good(tmp_path: Path, monkeypatch) -> str:
    """The shipped settings as text, their files named absolutely."""
    monkeypatch.chdir(tmp_path)
    text = (CONFIG / "case-study.toml").read_text()
    for folder in ("machines", "artefacts"):
        text = text.replace(f'"{folder}/', f'"{CONFIG}/{folder}/')
    return text.replace('"../runs"', '"state"')


def changed(former: str, now: str) -> Callable[[str], str]:
    def change(text: str) -> str:
        assert former in text
        return text.replace(former, now, 1)

    return change


SETTINGS = {
    "unknown key": (changed("[timing]", "[gates]\ncolour = 1\n[timing]"), ["'colour'", "gates.colour"]),
    "unknown key of a role": (changed("[roles]", "[roles]\ncolour = 1"), ["'colour'", "roles.colour"]),
    "unknown option of a driver": (
        changed("port = 5020", "port = 5020\ncolour = 1"),
        ["devices.cnc.options.colour"],
    ),
    "wrong option of a driver": (changed("port = 5020", "port = 99999"), ["devices.cnc.options.port", "65535"]),
    "no such driver": (changed('"modbus-cnc"', '"modbus-dnc"'), ["'modbus-dnc'", "devices.cnc.driver"]),
    "no such device": (changed('probe = "cnc"', 'probe = "prober"'), ["'prober'", "roles.probe"]),
    "no such tool": (changed('tool = "probe"', 'tool = "drill"'), ["'drill'", "key tool"]),
    "no number": (changed("[700.0,", "[nan,"), ["stations.places_mm[0][0]", "nan"]),
    "outside its bounds": (
        changed("[timing]", "[gates]\nmax_unmeasured_fraction = 20.0\n[timing]"),
        ["gates.max_unmeasured_fraction"],
    ),
    "key that resembles another": (
        changed("[timing]", "[gates]\nmax_remaining_fraction = 0.5\n[timing]"),
        ["key gates.max_remaining_fraction", "unknown key", "Did you mean"],
    ),
    "no TOML": (lambda text: text + "x = [", ["not valid TOML"]),
    "no machine file": (changed("machines/case-study.toml", "machines/none.toml"), ["none.toml"]),
    "proved by what it was made of": (
        changed("[verification]", "[verification]\npositions_deg = [[45.0, 0.0]]"),
        ["verification.positions_deg"],
    ),
    "station of a proof that is not there": (changed("stations = [1, 4]", "stations = [1, 5]"), ["station 5"]),
    "no room to park": (
        changed("[stations]", "[stations]\npark_distance_mm = 9000.0"),
        ["stations.park_distance_mm"],
    ),
}


# Another file is the one that is wrong, and the one that is named.
FOUND_TOGETHER = ("no machine file",)


@pytest.mark.parametrize("what", SETTINGS)
@pytest.mark.parametrize("command", ["calibrate", "check"])
def test_wrong_settings(good: str, what: str, command: str) -> None:
    change, words = SETTINGS[what]
    Path("volcal.toml").write_text(change(good))
    arguments = ["config", "check", "volcal.toml"] if command == "check" else ["calibrate"]
    code, line = refused(*arguments)
    assert code == 2
    for word in words:
        assert word in line
    assert ("volcal.toml" in line) is (what not in FOUND_TOGETHER)


def test_wrong_chain(good: str) -> None:
    machine = (CONFIG / "machines" / "case-study.toml").read_text()
    Path("machine.toml").write_text(machine.replace("tool-Y-Z-X-bed-workpiece", "tool-Y-Q-X-bed-workpiece"))
    text = good.replace(f"{CONFIG}/machines/case-study.toml", "machine.toml")
    Path("volcal.toml").write_text(text)
    code, line = refused("calibrate")
    assert code == 2
    assert "'Q'" in line
    assert "machine.toml" in line
    assert "key chain" in line


def test_no_settings_at_all(good: str) -> None:
    assert refused("calibrate", "--config", "none.toml") == (
        2,
        "there is no such file (file none.toml). check the path",
    )


POSITIONS = {
    "station without a place": ("7,0,0", 2, ["station 7", "p.csv", "stations.places_mm"]),
    "out of reach": ("1,90,0", 2, ["no position has three balls within the travel"]),
    "one out of reach": ("1,45,0\n1,0,45\n1,90,0", 2, ["position 3", "0 balls within reach", "p.csv"]),
    "one position only": ("1,45,0", 2, ["cannot separate machine errors from artefact errors", "p.csv"]),
    "no number": ("1,45,up", 2, ["'up' is not a finite number", "p.csv", "row 2", "column elevation_deg"]),
    "twice": ("1,45,0\n1,45,0", 2, ["p.csv", "row 3"]),
    "none": ("", 2, ["no position is listed", "p.csv"]),
}


@pytest.mark.parametrize("what", POSITIONS)
def test_wrong_position_file(good: str, what: str) -> None:
    listed, expected, words = POSITIONS[what]
    Path("volcal.toml").write_text(good)
    Path("p.csv").write_text(f"station,azimuth_deg,elevation_deg\n{listed}\n")
    code, line = refused("plan", "--position-set", "p.csv")
    assert code == expected
    for word in words:
        assert word in line


def test_column_missing_in_a_position_file(good: str) -> None:
    Path("volcal.toml").write_text(good)
    Path("p.csv").write_text("station,azimuth_deg\n1,45\n")
    code, line = refused("plan", "--position-set", "p.csv")
    assert code == 2
    assert "p.csv" in line
    assert "elevation_deg" in line


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--position-set", "S9"), ["'S9'", "S1, S2, S3"]),
        (("--stations", "9"), ["station 9", "procedure.stations"]),
    ],
)
def test_wrong_options(good: str, options: tuple[str, ...], words: list[str]) -> None:
    Path("volcal.toml").write_text(good)
    code, line = refused("calibrate", *options)
    assert code == 2
    for word in words:
        assert word in line


def test_proof_out_of_reach_is_refused_before_anything_moves(good: str) -> None:
    Path("volcal.toml").write_text(good.replace("[verification]", "[verification]\npositions_deg = [[90.0, 0.0]]"))
    Path("p.csv").write_text("station,azimuth_deg,elevation_deg\n1,45,0\n1,0,45\n")
    code, line = refused("plan", "--position-set", "p.csv")
    assert code == 2
    assert "verification.positions_deg" in line


def test_state_directory_that_is_a_file(good: str) -> None:
    Path("state").write_text("")
    text = good.replace('kind = "lockstep"', 'kind = "real"')
    Path("volcal.toml").write_text(text)
    code, line = refused("calibrate")
    assert code == 2
    assert "key state_directory" in line


def test_demo_into_a_file(good: str) -> None:
    Path("out").write_text("")
    code, line = refused("demo", "--out", "out")
    assert code == 2
    assert "out/simulator.log" in line


def test_run_that_preflight_refuses_writes_no_result(monkeypatch, tmp_path: Path) -> None:
    """Journal and history keep that it was asked for, and why nothing moved."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "p.csv").write_text("station,azimuth_deg,elevation_deg\n1,45,0\n")
    settings = document(tmp_path / "state", procedure={"position_set": "p.csv"}, verification={"stations": [1]})
    (tmp_path / "volcal.toml").write_text(toml(settings))
    result = volcal("calibrate", "--json", exit_code=2)
    outcome = json.loads(result.stdout)
    assert outcome["state"] == "refused"
    assert outcome["touches"] == 0
    assert outcome["report"] is None
    assert "cannot separate machine errors from artefact errors" in result.stderr
    left = sorted(path.name for path in (tmp_path / "state").iterdir())
    assert left == ["history.sqlite", "journal.sqlite", "run.lock"]


def toml(value: object) -> str:
    """A document of tables as TOML, inline from the second level on."""
    assert isinstance(value, dict)
    return "\n".join(f"{name} = {inline(part)}" for name, part in value.items()) + "\n"


def inline(value: object) -> str:
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{name} = {inline(part)}" for name, part in value.items()) + " }"
    return json.dumps(value)
