"""A straight bar that is mounted end for end: the first position tells it, not the whole set."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from nights import CONFIG, SCENARIO, Night, short_document

from agent.errors import MeasurementFault
from agent.execution.journal_reader import open_journal
from agent.execution.states import RunState

BAR = CONFIG / "artefacts" / "straight-bar-1500.toml"
COUNT = 11


@pytest.fixture
def directory() -> Iterator[Path]:
    with TemporaryDirectory() as made:
        yield Path(made)


def bar_file(path: Path, balls: np.ndarray) -> str:
    """The shipped bar with other balls."""
    rows = ",\n".join(f"  [{x:.4f}, {y:.4f}, {z:.4f}]" for x, y, z in balls)
    text, replaced = re.subn(r"balls = \[\n.*?\n\]", f"balls = [\n{rows}\n]", BAR.read_text(), flags=re.DOTALL)
    assert replaced == 1
    path.write_text(text)
    return str(path)


def balls_of_a_bar() -> np.ndarray:
    """Balls on a line within some tenths of a millimetre, as bars are made that have a certificate."""
    rng = np.random.default_rng(7)
    line = np.stack([np.linspace(-750.0, 750.0, COUNT), np.full(COUNT, -60.0), np.zeros(COUNT)], axis=1)
    return np.asarray(line + rng.uniform(-0.15, 0.15, line.shape))


def test_a_bar_end_for_end_is_named_after_its_first_position(directory: Path) -> None:
    balls = balls_of_a_bar()
    turned = balls[::-1] * [-1.0, 1.0, -1.0]  # half a turn about the holders, and counted from the other end
    scenario = tomllib.loads(SCENARIO.read_text())
    scenario["machine"] = str(SCENARIO.parent / scenario["machine"])
    scenario["artefact"] = bar_file(directory / "standing.toml", turned)
    devices = {"twin": {"driver": "simulated", "options": scenario}}
    state = directory / "state"
    document = short_document(state, devices=devices)
    document["artefact"] = bar_file(directory / "certified.toml", balls)
    night = Night()
    ended = night.run(document, files=False)
    assert isinstance(ended.error, MeasurementFault)
    assert "the artefact is mounted end for end" in str(ended.error)
    assert ended.error.hint is not None
    assert "turn the artefact round" in ended.error.hint
    assert ended.outcome.state is RunState.FAULTED
    assert night.world is not None
    assert night.world.collisions == []
    with open_journal(state) as reader:
        run = reader.last_run()
        assert run is not None
        assert {ball.record["position"] for ball in reader.balls(run.run)} == {0}


def test_the_same_bar_as_certified_is_measured(directory: Path) -> None:
    scenario = tomllib.loads(SCENARIO.read_text())
    scenario["machine"] = str(SCENARIO.parent / scenario["machine"])
    certified = bar_file(directory / "certified.toml", balls_of_a_bar())
    devices = {"twin": {"driver": "simulated", "options": {**scenario, "artefact": certified}}}
    document = short_document(directory / "state", devices=devices) | {"artefact": certified}
    ended = Night().run(document, files=False)
    assert not isinstance(ended.error, MeasurementFault)
