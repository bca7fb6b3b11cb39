"""The gates of a run, forecast from settings and files: sound set-ups pass with the defaults, others are named."""

from __future__ import annotations

from pathlib import Path

import pytest
from click.testing import Result
from volcal_command import volcal, volcal_json

CONFIG = Path(__file__).resolve().parents[3] / "config"
AXIS = "[axes.{}]\nrange_mm = [0.0, {}]\nrapid_mm_per_min = 20000.0\nacceleration_mm_per_s2 = 500.0\n"
MACHINE = (
    'name = "small"\nchain = "tool-Y-Z-X-bed-workpiece"\n[tools.probe]\noffset_mm = [0.0, 150.0, 0.0]\n'
    + "".join(AXIS.format(*axis) for axis in (("X", 800.0), ("Y", 500.0), ("Z", 400.0)))
)
BAR = """
name = "bar-500"
certificate = "example"
reference_temperature_c = 20.0
cte_per_k = 11.5e-6
cte_standard_uncertainty_per_k = 0.3e-6
ball_diameter_mm = 20.0
holder_length_mm = 60.0
standard_uncertainty_um = 0.8
"""
SETTINGS = """
machine = "machine.toml"
artefact = "bar.toml"
[devices.twin]
driver = "simulated"
options = { machine = "machine.toml", artefact = "bar.toml", stations_mm = [[250.0, 400.0, 200.0]] }
[roles]
machine = "twin"
probe = "twin"
store = "twin"
thermometer = "twin"
mount = "twin"
operator = "twin"
[stations]
places_mm = [[250.0, 400.0, 200.0], [550.0, 400.0, 200.0]]
[temperature]
standard_uncertainty_k = 0.1
"""


@pytest.fixture
def small(tmp_path: Path) -> Path:
    """Settings, with hardly more than what is required, of a machine of 800 × 500 × 400 mm with a bar of 500 mm."""
    heights = (15.5, 0.0, -15.5, 0.0)
    balls = [[62.5 * number - 250.0, -60.0 - heights[number % 4 - 1], heights[number % 4]] for number in range(9)]
    (tmp_path / "machine.toml").write_text(MACHINE)
    (tmp_path / "bar.toml").write_text(f"{BAR}balls = {balls}\n")
    (tmp_path / "volcal.toml").write_text(SETTINGS)
    return tmp_path / "volcal.toml"


def check(config: Path) -> Result:
    return volcal("config", "check", config, exit_code=None)


def test_a_small_machine_passes_with_the_defaults(small: Path) -> None:
    checked = check(small)
    assert checked.exit_code == 0, checked.output
    assert "refuse" not in checked.output
    document = volcal_json("plan", "--config", small)
    gates = {gate["gate"]: gate for gate in document["gates"]}
    assert all(gate["passes"] and not gate["remedy"] for gate in gates.values())
    assert gates["gain"]["expected"] > gates["gain"]["limit"] == 0.25
    assert gates["proof"]["expected"] > gates["proof"]["limit"] > 0.0
    assert 0.1 < gates["extrapolation"]["expected"] < 0.8


@pytest.mark.parametrize(
    "shipped",
    [path.relative_to(CONFIG).as_posix() for path in (*CONFIG.glob("*.toml"), *CONFIG.glob("linuxcnc/*.toml"))],
)
def test_the_shipped_settings_pass(shipped: str) -> None:
    checked = check(CONFIG / shipped)
    assert checked.exit_code == 0, checked.output
    assert "good." in checked.stdout


def test_a_run_that_will_be_refused_is_named_by_its_keys(small: Path) -> None:
    limits = {
        "probe_check.limit_um": "2.0",
        "gates.max_chi2": "0.9",
        "gates.min_degrees_of_freedom": "500",
        "gates.max_certificate_en": "0.5",
        "gates.max_change": "0.5",
        "gates.night_false_alarm": "0.9",
        "gates.max_correction_um": "5.0",
        "gates.max_slope_um_per_mm": "0.01",
        "gates.allow_extrapolation": "false",
        "gates.max_unmeasured_fraction": "0.2",
        "verification.min_gain": "0.9",
        "verification.max_chi2": "0.9",
    }
    for section in ("probe_check", "gates", "verification"):
        chosen = "".join(f"{key.split('.')[1]} = {limits[key]}\n" for key in limits if key.startswith(f"{section}."))
        small.write_text(f"{small.read_text()}[{section}]\n{chosen}")
    checked = check(small)
    assert checked.exit_code == 7, checked.output
    assert "good" not in checked.stdout
    # a right table is refused by its residuals, so the proof is expected to fail as well
    assert checked.stdout.count("refuse") == len(limits) + 1
    (line,) = checked.stderr.splitlines()
    assert line.startswith(
        "error: a run with these settings is expected to be refused: "
        "repeatability of the probe: 2.2 µm, required ≤ 2 µm; "
        "fit of the model: "
    )
    for key in (*limits, "verification.positions"):
        assert key in line
