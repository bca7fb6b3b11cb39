"""Predicted figures against instruments: scores, requests, and machines that agree with their estimate or do not."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import volcal
from agent.workpiece.acceptance_figure import draw_comparison
from agent.workpiece.instrument_comparison import InstrumentComparison, compare_with_instruments, instrument_request
from agent.workpiece.predicted_tests import AcceptanceRequest, PredictedTests, predict_acceptance
from campaigns.instruments.trials import one_machine
from simulators.scenario import read_scenario
from simulators.wire.instrument_requests import VirtualInstruments
from simulators.wire.shared_world import SharedWorld
from simulators.world.world import World
from twin.errors import DataError
from twin.workpiece.acceptance import acceptance_tests
from twin.workpiece.agreement import agrees, en_score

SCENARIO = Path(__file__).parents[3] / "config" / "simulators" / "case-study.toml"
FIGURES = 19
"""Three positionings, six straightnesses, three squarenesses, three circles and four diagonals."""
REPEATED = 12
"""A, E, R and B of each axis, on machines whose lost motion and repeatability were measured."""
ALL = FIGURES + REPEATED


def test_the_score_of_iso_13528() -> None:
    assert en_score(12.0, 3.0, 7.0, 4.0) == 1.0
    assert agrees(1.0)
    assert not agrees(-1.01)
    with pytest.raises(DataError, match="without uncertainty"):
        en_score(1.0, 0.0, 1.0, 0.0)
    with pytest.raises(DataError, match="negative"):
        en_score(1.0, -1.0, 1.0, 2.0)


def test_every_test_is_asked_where_it_was_predicted() -> None:
    """The requests state lines and circles in axis positions, whatever the tool."""
    ranges, offset = ((0.0, 4000.0), (0.0, 1300.0), (0.0, 1500.0)), np.array([0.0, 250.0, 0.0])
    tests = acceptance_tests(ranges, offset, np.array([1500.0, 500.0, 800.0]), (150.0,))
    asked = {test.feature.name: instrument_request(test, offset) for test in tests}
    assert len(asked) == FIGURES
    assert asked["M X"] == {
        "do": "interferometer",
        "from_mm": [0.0, 500.0, 800.0],
        "to_mm": [4000.0, 500.0, 800.0],
        "targets": 21,
    }
    assert asked["diagonal +-+"]["from_mm"] == [0.0, 1300.0, 0.0]
    assert asked["diagonal +-+"]["to_mm"] == [4000.0, 0.0, 1500.0]
    assert asked["EZY"]["across"] == "Z"
    assert asked["EZY"]["to_mm"] == [1500.0, 1300.0, 800.0]
    assert asked["squareness Z to X"] == {
        "do": "squareness",
        "lines_mm": [[[0.0, 500.0, 800.0], [4000.0, 500.0, 800.0]], [[1500.0, 500.0, 0.0], [1500.0, 500.0, 1500.0]]],
        "plane": "XZ",
        "targets": [21, 11],
    }
    ballbar = asked["G YZ 150"]
    assert ballbar["centre_mm"] == pytest.approx([1500.0, 500.0, 800.0])
    assert (ballbar["do"], ballbar["radius_mm"], ballbar["plane"]) == ("ballbar", 150.0, "YZ")


@pytest.mark.parametrize("corner", [(0.0, 0.0, 0.0), (4000.0, 1300.0, 1500.0), (4000.0, 0.0, 1500.0)])
def test_the_lines_of_a_squareness_may_meet_at_their_ends(corner: tuple[float, float, float]) -> None:
    ranges = ((0.0, 4000.0), (0.0, 1300.0), (0.0, 1500.0))
    for test in acceptance_tests(ranges, np.zeros(3), np.array(corner), ()):
        if not test.feature.name.startswith("squareness"):
            continue
        asked = instrument_request(test, np.zeros(3))
        for axis, (start, end) in zip(("XYZ".index(name) for name in asked["plane"]), asked["lines_mm"], strict=True):
            low, high = list(corner), list(corner)
            low[axis], high[axis] = ranges[axis]
            assert (start, end) == (low, high)


@pytest.fixture(scope="module")
def predicted(tmp_path_factory: pytest.TempPathFactory) -> PredictedTests:
    """Prediction from the shipped ball centres."""
    setup, folder = volcal.case_study(), tmp_path_factory.mktemp("identified")
    balls = volcal.read_balls(volcal.shipped_file("examples/case-study-balls.csv"), setup.machine)
    estimate = volcal.identify(balls, setup.machine, setup.artefact, order=5)
    volcal.write_estimate(estimate, folder / "estimate.json")
    volcal.write_table(volcal.compensation_table(estimate, balls), folder / "table.csv")
    return predict_acceptance(AcceptanceRequest(folder, None, False, None, (), None))


@pytest.fixture(scope="module")
def compared() -> InstrumentComparison:
    """A machine that shares no code with the program, without and with its table."""
    return one_machine("mixed", 0)


def test_a_machine_agrees_with_its_own_estimate(compared: InstrumentComparison) -> None:
    assert len(compared.figures) == 2 * ALL
    assert compared.agreeing >= 2 * ALL - 5
    assert not compared.contradicts
    document = compared.as_json()
    assert document["agreeing"] == compared.agreeing
    assert [figure["with_table"] for figure in document["figures"]] == [
        *[False] * FIGURES,
        *[True] * FIGURES,
        *[False] * REPEATED,
        *[True] * REPEATED,
    ]
    # the errors are large against what the instruments cannot tell, and the table makes them smaller
    plain, corrected = (
        [one["measured_um"] for one in document["figures"] if one["with_table"] is active][:FIGURES]
        for active in (False, True)
    )
    assert np.mean(np.abs(corrected)) < 0.7 * np.mean(np.abs(plain))


def test_another_machine_does_not_agree(predicted: PredictedTests) -> None:
    """The shipped ball centres were not measured on the machine of the shipped scenario."""
    instruments = VirtualInstruments(SharedWorld(World(read_scenario(SCENARIO))))
    found = compare_with_instruments(predicted, lambda request: instruments.measure(dict(request)), None)
    assert len(found.figures) == FIGURES
    assert found.contradicts
    assert "of 19 figures agree" in found.text


def test_the_table_is_measured_in_its_bank(predicted: PredictedTests) -> None:
    banks: list[object] = []

    def ask(request: Mapping[str, Any]) -> Mapping[str, Any]:
        banks.append(request["bank"])
        names = ("m", "straightness", "g_mean")
        figures = {f"{name}{end}_um": 1.0 for name in names for end in ("", "_u")}
        curves = {"position_mm": [0.0, 1.0], "mean_angle_rad": [0.0, 1.0], "mean_um": [0.0, 1.0]}
        return {"squareness_urad": 0.0, "squareness_u_urad": 1.0, **figures, **curves}

    found = compare_with_instruments(predicted, ask, 2)
    assert banks == [0] * FIGURES + [2] * FIGURES
    assert [figure.with_table for figure in found.figures] == [False] * FIGURES + [True] * FIGURES


def test_measured_curves_are_drawn_on_the_predicted_ones(compared: InstrumentComparison) -> None:
    drawn = draw_comparison(compared)
    assert drawn.png.startswith(b"\x89PNG")
    assert "measured without table" in drawn.svg
    assert "measured with table" in drawn.svg
