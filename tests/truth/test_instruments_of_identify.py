"""`volcal identify --instrument` on the files of a foreign machine: a right and a wrong laser, and what is written."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from foreign_files import Folder

from agent.runs.offline.material import read_material
from agent.runs.offline.request import IdentificationRequest
from campaigns.foreign.artefact import STATIONS_MM, measure_at, tilted_bar
from campaigns.foreign.files import rows_of
from campaigns.foreign.machine import TOOL, ForeignMachine, foreign_machine
from drivers.errors import ConfigurationError, InputError
from twin.formats.estimate_file import parse_estimate
from twin.identification import Options

LINE = np.stack((np.linspace(100.0, 3900.0, 14), np.full(14, 650.0), np.full(14, 700.0)), axis=1)
FIRST_ROW = 6


def laser_text(machine: ForeignMachine, wrong_um_per_m: float) -> str:
    """Return the file of a laser line along X, from the true positions of the reflector."""
    shown = 1e3 * (machine.deviation(LINE) - machine.deviation(LINE[:1]))[:, 0]
    shown = shown + 1e-3 * wrong_um_per_m * (LINE[:, 0] - LINE[0, 0])
    head = [
        '# instrument = "laser"',
        f"# tool_offset_mm = {TOOL.tolist()}",
        "# sigma_um = 0.3",
        "# scale_um_per_m = 0.3",
    ]
    rows = [f"{x},{y},{z},{value:.4f}" for (x, y, z), value in zip(LINE, shown, strict=True)]
    return "\n".join([*head, "x_mm,y_mm,z_mm,reading_um", *rows]) + "\n"


def test_right_and_wrong_lasers_of_one_identification(tmp_path: Path) -> None:
    rng = np.random.default_rng(21)
    machine, bar = foreign_machine(rng), tilted_bar(rng, 5)
    seen = measure_at(machine, bar, [(place, ((0.0, 45.0), (90.0, -45.0))) for place in STATIONS_MM], rng).seen
    (tmp_path / "right.csv").write_text(laser_text(machine, 0.0))
    (tmp_path / "wrong.csv").write_text(laser_text(machine, 40.0))
    given = [option for name in ("wrong.csv", "right.csv") for option in ("--instrument", str(tmp_path / name))]
    folder = Folder(tmp_path)
    rows = rows_of(seen, per_station=2, first_position=0)
    done = folder.run(bar, rows, "--order", "3", "--json", *given, report=True)
    assert done.exit_code == 0, done.output
    wrong, right = json.loads(done.stdout)["instruments"]
    assert (wrong["name"], wrong["contradicts"], wrong["joined"]) == ("wrong.csv", True, False)
    assert (right["name"], right["contradicts"], right["joined"]) == ("right.csv", False, True)
    assert FIRST_ROW <= wrong["largest"]["row"] < FIRST_ROW + len(LINE)
    assert abs(wrong["largest"]["sigmas"]) > 4.0
    stored = parse_estimate((folder.out / "estimate.json").read_text(), "estimate.json")
    assert [check.name for check in stored.instruments if check.joined] == ["right.csv"]
    assert stored.document.provenance["instruments"] == "wrong.csv (not used), right.csv"
    page = (folder.out / "report.html").read_text()
    assert "wrong.csv (not used), right.csv" in page
    assert "Readings of other instruments" in page
    size = wrong["largest"]
    assert f"row {size['row']}: {abs(size['sigmas']):.1f} sigma, {size['size']:.1f} µm" in page
    assert "wrong.csv (laser) contradicts the ball centres and the other instruments" in page
    check_what_the_next_night_refuses(tmp_path, folder.out / "estimate.json")


def check_what_the_next_night_refuses(path: Path, estimate: Path) -> None:
    """Readings that the earlier estimate contains already, and a machine with another cross-effect."""
    machine = path / "machine.toml"
    files = (path / "balls.csv", machine, path / "bar.toml", path / "next", Options())
    with pytest.raises(ConfigurationError, match=r"the readings of right.csv are already part of the earlier estimate"):
        read_material(IdentificationRequest(*files, carried_over=estimate, instruments=(path / "right.csv",)))
    unused = IdentificationRequest(*files, carried_over=estimate, instruments=(path / "wrong.csv",))
    assert [one.name for one in read_material(unused).options.instruments] == ["wrong.csv"]
    machine.write_text(machine.read_text().replace("[model.family]", "[model]\ncross_effect = false\n[model.family]"))
    with pytest.raises(InputError, match=r"the cross-effect or the beams of the machine in .*machine.toml") as caught:
        read_material(IdentificationRequest(*files, carried_over=estimate))
    assert "estimate.json" in str(caught.value)


def test_a_file_that_cannot_be_used_is_named_with_row_and_column(tmp_path: Path) -> None:
    rng = np.random.default_rng(21)
    machine, bar = foreign_machine(rng), tilted_bar(rng, 5)
    seen = measure_at(machine, bar, [(place, ((0.0, 45.0),)) for place in STATIONS_MM[:2]], rng).seen
    path = tmp_path / "laser.csv"
    path.write_text(laser_text(machine, 0.0).replace("650.0,700.0", "650.0,1700.0", 1))
    folder = Folder(tmp_path)
    done = folder.run(bar, rows_of(seen), "--order", "3", "--instrument", str(path))
    assert done.exit_code == 2
    assert "laser.csv" in done.output
    assert "row 6" in done.output
    assert "z_mm" in done.output
    path.write_text(laser_text(machine, 0.0))
    twice = folder.run(bar, rows_of(seen), "--instrument", str(path), "--instrument", str(path))
    assert twice.exit_code == 2
    assert "a second file of an instrument has the same name" in twice.output
    assert not folder.out.exists()
