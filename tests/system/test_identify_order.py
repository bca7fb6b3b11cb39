"""`volcal identify` with orders and with the estimate of an earlier night."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result
from hidden_machine import ARTEFACT_FILE, MACHINE_FILE, as_csv, hidden_machine, measured_rows

from agent.cli.offline_commands.identify import identify
from twin.artefact.position_set import parse_position_set
from twin.formats.estimate_file import StoredEstimate, parse_estimate


@pytest.fixture(scope="module")
def nights(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Return ball files of two nights of one machine and one bar."""
    folder, rng = tmp_path_factory.mktemp("nights"), np.random.default_rng(8)
    machine = hidden_machine(rng)
    files = []
    for expression in ("S3", "S2"):
        file = folder / f"{expression}.csv"
        file.write_text(as_csv(measured_rows(machine, parse_position_set(expression, 2), rng)))
        files.append(file)
    return files[0], files[1]


def run(balls: Path, out: Path, *more: str | Path, machine: Path = MACHINE_FILE) -> Result:
    arguments = [balls, "--machine", machine, "--artefact", ARTEFACT_FILE, "--out", out, *more, "--even-so", "--json"]
    return CliRunner().invoke(identify, [str(argument) for argument in arguments], prog_name="volcal identify")


def stored(out: Path) -> StoredEstimate:
    return parse_estimate((out / "estimate.json").read_text(), "estimate.json")


@pytest.fixture(scope="module")
def first(nights: tuple[Path, Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("first")
    done = run(nights[0], out)
    assert done.exit_code == 0, done.output
    return out


def test_the_evidence_chooses_and_says_so_everywhere(first: Path) -> None:
    document = stored(first).document
    (chosen,) = [entry for entry in document.order_evidence if entry.chosen]
    assert set(document.model.orders.values()) == {chosen.order}
    assert [entry.order for entry in document.order_evidence] == list(range(3, 10))
    assert document.provenance["order"] == "evidence"
    report = (first / "report.html").read_text()
    assert f"{chosen.order}, by evidence (ln, against the likeliest: 3: " in report


@pytest.mark.parametrize(("order", "size"), [("file", 90), ("4", 72), ("7", 126)])
def test_an_order_that_is_given_is_taken(nights: tuple[Path, Path], tmp_path: Path, order: str, size: int) -> None:
    done = run(nights[0], tmp_path / "out", "--order", order, "--no-report")
    assert done.exit_code == 0, done.output
    said = json.loads(done.output)
    assert (said["parameters"], said["order_evidence"]) == (size, {})
    assert stored(tmp_path / "out").model.size == size


def test_a_second_night_knows_what_the_first_one_found(nights: tuple[Path, Path], first: Path, tmp_path: Path) -> None:
    fused, aged = tmp_path / "fused", tmp_path / "aged"
    for out, more in ((fused, ()), (aged, ("--process-noise-um", "3"))):
        done = run(nights[1], out, "--carried-over", first / "estimate.json", "--no-report", *more)
        assert done.exit_code == 0, done.output
        assert stored(out).model == stored(first).model
    before, after, later = (np.diag(stored(out).covariance) for out in (first, fused, aged))
    assert (after <= before * (1.0 + 1e-9)).all()
    assert after.sum() < 0.95 * before.sum()
    assert (later > after).mean() > 0.9
    learned = stored(aged).carried_over().drift_factor
    text = f"estimate.json, changed since by 3 µm rms, times {learned.value:.2g} as learned"
    assert stored(aged).document.provenance["prior"] == text
    assert 0.05 < learned.value < 1.0  # the machine has not changed at all
    assert stored(fused).document.provenance["prior"] == "estimate.json, changed since by 0 µm rms"


def singular(document: dict) -> dict:
    covariance = document["carried_over"]["covariance"]
    for place, row in enumerate(covariance):
        row[:] = [0.0 if 5 in (place, column) else value for column, value in enumerate(row)]
    return document


def another_machine(document: dict) -> dict:
    document["model"]["ranges_mm"][0] = [0.0, 3990.0]
    return document


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (singular, ["singular", "unknown EXX[6]"]),
        (another_machine, ["does not belong to the machine", "axis ranges"]),
        (lambda document: {**document, "format": "volcal estimate 1"}, ["format"]),
    ],
)
def test_an_estimate_that_cannot_be_carried_over_is_named(
    nights: tuple[Path, Path], first: Path, tmp_path: Path, spoil: Callable[[dict], dict], words: list[str]
) -> None:
    file = tmp_path / "spoilt.json"
    file.write_text(json.dumps(spoil(json.loads((first / "estimate.json").read_text()))))
    done = run(nights[1], tmp_path / "out", "--carried-over", file)
    assert done.exit_code == 2
    assert "Traceback" not in done.output
    assert all(word in done.output for word in ["spoilt.json", *words]), done.output
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("more", "words"),
    [
        (("--order", "best"), "neither evidence nor file"),
        (("--order", "0"), "neither evidence nor file"),
        (("--process-noise-um", "1"), "--carried-over"),
        (("--carried-over", "nowhere.json"), "no such file"),
    ],
)
def test_options_that_make_no_sense(
    nights: tuple[Path, Path], tmp_path: Path, more: tuple[str, ...], words: str
) -> None:
    done = run(nights[0], tmp_path / "out", *more)
    assert done.exit_code == 2
    assert words in done.output


def test_a_family_of_zeros_has_nothing_to_identify(nights: tuple[Path, Path], tmp_path: Path) -> None:
    head, rest = MACHINE_FILE.read_text().split("[model.family]", 1)
    family, tail = rest.split("[deflection]", 1)
    family = re.sub(r"(_u\w+) = .*", r"\1 = 0.0", family)
    nothing = MACHINE_FILE.parent.joinpath("case-study-deflection.csv").read_text()
    (tmp_path / "case-study-deflection.csv").write_text(nothing)
    (tmp_path / "machine.toml").write_text(f"{head}[model.family]{family}[deflection]{tail}")
    done = run(nights[0], tmp_path / "out", machine=tmp_path / "machine.toml")
    assert done.exit_code == 2
    assert "nothing to identify" in done.output
    assert "machine.toml, key model.family" in done.output
