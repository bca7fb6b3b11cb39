"""Additions to a certificate: uncertified balls, a common uncertainty of all lengths and measured lengths."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest

from twin.artefact.artefact_body import ArtefactBody, Beam, Rod
from twin.artefact.certificate import (
    TRACEABLE_PPM,
    BallDistance,
    best_known_length,
    has_certificate,
    with_length_uncertainty,
    with_reference_length,
    with_uncertified,
)
from twin.errors import DataError, FormatError, TwinError
from twin.formats.artefact_file import format_artefact, parse_artefact

TEXT = """
name = "bar"
cte_per_k = 11.5e-6
cte_standard_uncertainty_per_k = 0.3e-6
ball_diameter_mm = 25.0
standard_uncertainty_um = 0.8
balls = [[0.0, 0.0, 0.0], [300.0, 10.0, 0.0], [600.0, 0.0, 10.0], [900.0, -10.0, 0.0]]
"""
BALLS = np.array([[0.0, 0.0, 0.0], [300.0, 10.0, 0.0], [600.0, 0.0, 10.0], [900.0, -10.0, 0.0]])


def covariance() -> np.ndarray:
    root = np.random.default_rng(1).normal(size=(12, 12)) * 0.5e-3
    return np.asarray(root @ root.T + 1e-7 * np.eye(12))


def test_a_reference_length_is_a_weighted_least_squares_adjustment() -> None:
    """The certified coordinates and the length are adjusted together by Gauss-Newton on the exact distance."""
    first, second, length, sigma = 0, 3, 900.0571, 0.7e-3
    weights = np.linalg.inv(covariance())
    found = BALLS.reshape(-1).copy()
    for _ in range(5):
        points = found.reshape(-1, 3)
        line = points[second] - points[first]
        distance = np.linalg.norm(line)
        row = np.zeros(12)
        row[9:], row[:3] = line / distance, -line / distance
        normal = weights + np.outer(row, row) / sigma**2
        right = weights @ (BALLS.reshape(-1) - found) + row * (length - distance) / sigma**2
        found += np.linalg.solve(normal, right)
    balls, updated = with_reference_length(BALLS, covariance(), BallDistance((first, second), length, sigma))
    assert balls.reshape(-1) == pytest.approx(found, abs=1e-8)
    assert updated == pytest.approx(np.linalg.inv(normal), abs=1e-11)


def adjusted(lengths: list[BallDistance]) -> tuple[np.ndarray, np.ndarray]:
    balls, known = BALLS, covariance()
    for length in lengths:
        balls, known = with_reference_length(balls, known, length)
    return balls, known


def test_the_order_of_reference_lengths_does_not_matter() -> None:
    lengths = [BallDistance((0, 3), 900.0560, 1e-3), BallDistance((3, 1), 600.3340, 0.5e-3)]
    one, other = (adjusted(order) for order in (lengths, lengths[::-1]))
    assert one[0] == pytest.approx(other[0], abs=1e-9)
    assert one[1] == pytest.approx(other[1], abs=1e-11)


@pytest.mark.parametrize(("sigmas", "refused"), [(4.9, False), (5.1, True)])
def test_a_length_more_than_five_standard_deviations_off_is_refused(sigmas: float, refused: bool) -> None:
    distance = np.linalg.norm(BALLS[3] - BALLS[0])
    length = distance + sigmas * np.sqrt(2.0 * 0.8e-3**2 + 1e-3**2)
    text = TEXT + f"[[reference_lengths]]\nballs = [0, 3]\nlength_mm = {length:.9f}\nstandard_uncertainty_um = 1.0\n"
    if not refused:
        assert "length of balls 0 and 3 measured" in parse_artefact(text, "bar.toml").certificate
        return
    with pytest.raises(DataError, match=r"reference length of balls 0 and 3 .*, \|E_n\| = 2\.55 \(k = 2\)") as error:
        parse_artefact(text, "bar.toml")
    assert error.value.where == {"file": "bar.toml", "key": "reference_lengths"}


def test_a_common_length_uncertainty_lets_one_length_correct_all() -> None:
    known = with_length_uncertainty(BALLS, np.eye(12) * 1e-10, 50.0)
    distance = float(np.linalg.norm(BALLS[3] - BALLS[0]))
    length = BallDistance((0, 3), distance * (1.0 + 13e-6), 1e-5)
    balls, _ = with_reference_length(BALLS, known, length)
    for ball in (1, 2, 3):
        ratio = np.linalg.norm(balls[ball] - balls[0]) / np.linalg.norm(BALLS[ball] - BALLS[0])
        assert ratio - 1.0 == pytest.approx(13e-6, abs=0.2e-6)


def test_uncertified_balls_keep_their_centres_and_lose_their_certificate() -> None:
    artefact = parse_artefact("uncertified_balls = [2]\n" + TEXT, "bar.toml")
    assert artefact.uncertified == (2,)
    assert artefact.balls == pytest.approx(BALLS)
    assert np.sqrt(np.diagonal(artefact.covariance)) == pytest.approx(6 * [0.8e-3] + 3 * [1.0] + 3 * [0.8e-3])
    assert artefact.certificate == "nominal, not calibrated; uncertified balls: 2"


def test_correlations_of_an_uncertified_ball_are_dropped() -> None:
    widened = with_uncertified(covariance(), [1])
    assert not widened[3:6, [0, 1, 2, *range(6, 12)]].any()
    assert widened[3:6, 3:6] == pytest.approx(np.eye(3))
    others = np.array([0, 1, 2, *range(6, 12)])
    assert widened[np.ix_(others, others)] == pytest.approx(covariance()[np.ix_(others, others)])


@pytest.mark.parametrize(
    ("addition", "message"),
    [
        ("uncertified_balls = [4]\n", "ball 4 does not exist on an artefact with 4 balls"),
        ("uncertified_balls = [-1]\n", "ball -1 does not exist"),
        ("uncertified_balls = [0, 1]\n", "2 of 4 balls are uncertified, but at least three must be certified"),
    ],
)
def test_impossible_uncertified_balls_are_refused(addition: str, message: str) -> None:
    with pytest.raises(DataError, match=message) as error:
        parse_artefact(addition + TEXT, "bar.toml")
    assert error.value.where == {"file": "bar.toml", "key": "uncertified_balls"}


@pytest.mark.parametrize(
    ("section", "message"),
    [
        ("balls = [0, 9]\nlength_mm = 900.0\nstandard_uncertainty_um = 1.0\n", "ball 9 does not exist"),
        ("balls = [1, 1]\nlength_mm = 900.0\nstandard_uncertainty_um = 1.0\n", "two different balls"),
    ],
)
def test_impossible_reference_lengths_are_refused(section: str, message: str) -> None:
    with pytest.raises(DataError, match=message) as error:
        parse_artefact(TEXT + "[[reference_lengths]]\n" + section, "bar.toml")
    assert error.value.where == {"file": "bar.toml", "key": "reference_lengths"}


def test_a_reference_length_needs_an_uncertainty() -> None:
    with pytest.raises(FormatError, match="standard_uncertainty_um"):
        parse_artefact(TEXT + "[[reference_lengths]]\nballs = [0, 3]\nlength_mm = 900.0\n", "bar.toml")


ROUGH = TEXT.replace("standard_uncertainty_um = 0.8", "standard_uncertainty_um = 50.0")
END_LENGTH = "end_length_mm = 900.0900\nend_length_standard_uncertainty_um = 0.6\n"


def test_the_length_of_the_end_balls_is_a_reference_length() -> None:
    section = "[[reference_lengths]]\nballs = [0, 3]\nlength_mm = 900.09\nstandard_uncertainty_um = 0.6\n"
    one, other = parse_artefact(END_LENGTH + ROUGH, "bar.toml"), parse_artefact(ROUGH + section, "bar.toml")
    assert one.balls.tolist() == other.balls.tolist()
    assert one.covariance.tolist() == other.covariance.tolist()
    assert one.certificate == other.certificate
    assert np.linalg.norm(one.balls[3] - one.balls[0]) == pytest.approx(900.09, abs=1e-5)


def test_an_artefact_with_rough_centres_has_no_certificate_but_may_have_a_length() -> None:
    rough, long = parse_artefact(ROUGH, "bar.toml"), parse_artefact(END_LENGTH + ROUGH, "bar.toml")
    certified = parse_artefact("length_standard_uncertainty_ppm = 100.0\n" + TEXT, "bar.toml")
    partly = parse_artefact("uncertified_balls = [1]\n" + TEXT, "bar.toml")
    found = [has_certificate(one.balls, one.covariance) for one in (rough, long, certified, partly)]
    assert found == [False, False, True, True]
    best = best_known_length(long.balls, long.covariance)
    assert best.balls == (0, 3)
    assert best.length_mm == pytest.approx(900.09, abs=1e-5)
    assert best.standard_uncertainty_mm == pytest.approx(0.6e-3, rel=1e-3)
    assert best_known_length(rough.balls, rough.covariance).ppm > TRACEABLE_PPM > best.ppm


@pytest.mark.parametrize(
    ("text", "message", "key"),
    [
        ("end_length_mm = 900.0\n" + ROUGH, "give both 'end_length_mm' and", "(whole file)"),
        ("end_length_standard_uncertainty_um = 1.0\n" + ROUGH, "give both 'end_length_mm' and", "(whole file)"),
        (
            "end_length_mm = 900.7\nend_length_standard_uncertainty_um = 1.0\n" + ROUGH,
            r"\|E_n\| = 4\.56",
            "end_length_mm",
        ),
        (
            END_LENGTH + ROUGH.replace("[600.0, 0.0, 10.0]", "[900.0, 0.0, 10.0]"),
            "no two end balls: the pairs",
            "end_length_mm",
        ),
    ],
)
def test_an_impossible_end_length_is_refused(text: str, message: str, key: str) -> None:
    with pytest.raises(TwinError, match=message) as error:
        parse_artefact(text, "bar.toml")
    assert error.value.where == {"file": "bar.toml", "key": key}


@pytest.mark.parametrize(
    "body",
    [
        ArtefactBody(),
        ArtefactBody(3.0, tuple((x, y, z - 40.0) for x, y, z in BALLS.tolist()), None, ()),
        ArtefactBody(5.0, None, Beam(12.0, 20.0), (Rod("frame", (0.0, 0.0, -50.0), (900.0, 0.0, -50.0), 8.5),)),
    ],
)
def test_an_artefact_that_is_written_and_read_is_the_same(body: ArtefactBody) -> None:
    """Every field of the artefact, so that a new one is not forgotten in the file."""
    root = np.random.default_rng(2).normal(size=(12, 9)) * 1e-3
    written = replace(
        parse_artefact('holder_length_mm = 61.5\ncertificate = "A \\"b\\" µ"\n' + TEXT, "bar.toml"),
        covariance=with_uncertified(root @ root.T, [1]),
        uncertified=(1,),
        body=body,
        sag_mm=0.0 if body.beam is None else 3e-3,
        sag_standard_uncertainty_mm=0.0 if body.beam is None else 5e-4,
    )
    text, table = format_artefact(written, "covariance.csv", ("One note.",))
    found = parse_artefact(text, "again.toml", {"covariance.csv": table}.__getitem__)
    for field in fields(written):
        stated, read = getattr(written, field.name), getattr(found, field.name)
        if field.name == "certificate":
            assert read == stated + "; uncertified balls: 1"
        elif isinstance(stated, np.ndarray):
            assert read == pytest.approx(stated, rel=1e-12), field.name
        else:
            assert read == stated, field.name
