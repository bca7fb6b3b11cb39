"""A bar that moved while a position was measured: named as such, and not as many wrong balls."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from foreign_files import Folder

from campaigns.foreign.artefact import S1, S2, S3, ForeignBar, measure, straight_bar, tilted_bar
from campaigns.foreign.files import rows_of
from campaigns.foreign.machine import foreign_machine
from campaigns.foreign.score import family_of
from twin.artefact.observations import Observations
from twin.errors import PositionError, TwinError
from twin.identification import Options
from twin.identification.identify import accepted_rows

ORDER = 5
BARS = {"tilted": tilted_bar, "straight": lambda rng: straight_bar(rng, 0.005)}


def measurement(seed: int, bar: str, worse: float = 1.0, sets: tuple = S3) -> tuple[Observations, ForeignBar]:
    rng = np.random.default_rng(seed)
    machine, made = foreign_machine(rng, worse), BARS[bar](rng)
    return measure(machine, made, sets, np.random.default_rng(seed + 100)).seen, made


def slipped(seen: Observations, position: int, ball: int, size_um: float, seed: int) -> Observations:
    """Move the balls of one position, from `ball` on, by a shift and a small turn about their middle."""
    rng = np.random.default_rng(seed)
    later = (seen.position == position) & (seen.ball >= ball)
    points = seen.axis_positions.copy()
    shift, turn = rng.normal(size=(2, 3))
    arms = points[later] - points[later].mean(axis=0)
    points[later] += 1e-3 * size_um * (shift / np.linalg.norm(shift) + np.cross(turn / 2500.0, arms))
    return replace(seen, axis_positions=points)


def accepted(seen: Observations, bar: ForeignBar) -> np.ndarray:
    return accepted_rows(family_of(ORDER), seen, bar.artefact, Options()).mask


@pytest.mark.parametrize("bar", sorted(BARS))
@pytest.mark.parametrize(("ball", "size_um"), [(5, 30.0), (4, 100.0), (7, 15.0)])
def test_it_is_named(bar: str, ball: int, size_um: float) -> None:
    seen, made = measurement(1, bar)
    moved = slipped(seen, 7, ball, size_um, seed=3)
    with pytest.raises(PositionError, match=f"^position 7 moved between ball {ball - 1} and ball {ball} by") as caught:
        accepted(moved, made)
    stated = float(str(caught.value).partition("about ")[2].partition(" µm")[0])
    assert stated == pytest.approx(size_um, rel=0.35)


@pytest.mark.parametrize("worse", [3.0, 10.0])
def test_it_is_named_on_a_machine_outside_the_family(worse: float) -> None:
    seen, made = measurement(2, "tilted", worse)
    with pytest.raises(PositionError, match=r"^position 7 moved between ball 4 and ball 5 "):
        accepted(slipped(seen, 7, 5, 30.0, seed=3), made)


def test_the_order_of_the_rows_is_the_order_of_measuring() -> None:
    """Both end balls first: the bar slips after them, before ball 1."""
    seen, made = measurement(1, "tilted")
    inner = (seen.ball > 1) & (seen.ball < 9)
    points = seen.axis_positions.copy()
    points[(seen.position == 7) & inner] += [0.02, -0.01, 0.02]
    ends_first = replace(seen, axis_positions=points).select(np.argsort(inner, kind="stable"))
    with pytest.raises(PositionError, match=r"^position 7 moved between ball 10 and ball 2 by about 3[0-2] µm"):
        accepted(ends_first, made)


@pytest.mark.parametrize(
    ("seed", "bar", "worse"), [(1, "tilted", 1.0), (2, "straight", 1.0), (3, "tilted", 10.0), (4, "straight", 3.0)]
)
def test_two_hundred_positions_without_a_fault_raise_none(seed: int, bar: str, worse: float) -> None:
    """208 positions. On a machine far outside the family a single ball may be rejected, which is no slip."""
    seen, made = measurement(seed, bar, worse, S1 + S2 + S3)
    assert len(np.unique(seen.position)) == 52
    assert (~accepted(seen, made)).sum() <= (0 if worse == 1.0 else 2)


@pytest.mark.parametrize("seed", range(4))
def test_wrong_balls_are_rejected_and_no_slip(seed: int) -> None:
    """Two neighbours and a single one in another position."""
    seen, made = measurement(seed, "straight" if seed % 2 else "tilted")
    points, rng = seen.axis_positions.copy(), np.random.default_rng(seed)
    wrong = ((seen.position == 7) & np.isin(seen.ball, (6, 7))) | ((seen.position == 3) & (seen.ball == 5))
    points[wrong] += 0.04 * rng.choice([-1.0, 1.0], (3, 3))
    rejected = ~accepted(replace(seen, axis_positions=points), made)
    assert (rejected & wrong).sum() >= 2
    assert rejected.sum() <= 6


@pytest.mark.parametrize("seed", range(4))
def test_balls_that_are_a_millimetre_off_are_rejected(seed: int) -> None:
    """Errors as gross as these would take a machine a hundred times worse than its family, if they were believed."""
    seen, made = measurement(seed, "straight" if seed % 2 else "tilted")
    rng, points = np.random.default_rng(seed), seen.axis_positions.copy()
    wrong = rng.choice(seen.size, 3, replace=False)
    points[wrong] += rng.normal(0.0, 0.6, (3, 3))
    rejected = np.flatnonzero(~accepted(replace(seen, axis_positions=points), made))
    assert set(wrong.tolist()) <= set(rejected.tolist())
    assert len(rejected) <= 6


@pytest.mark.parametrize("shift", [1, 3])
def test_balls_with_the_numbers_of_their_neighbours_are_neither_slips_nor_accepted(shift: int) -> None:
    seen, made = measurement(1, "tilted")
    with pytest.raises(TwinError, match=r"check .*ball numbers"):
        accepted(replace(seen, ball=(seen.ball + shift) % 11), made)


def test_the_command_names_position_balls_and_row_of_the_file(tmp_path: Path) -> None:
    seen, bar = measurement(1, "tilted")
    rows = rows_of(slipped(seen, 7, 5, 30.0, seed=3), first_position=11)
    done = Folder(tmp_path).run(bar, rows)
    assert done.exit_code == 2
    assert "position 18 moved between ball 4 and ball 5 by about" in done.stderr
    row = next(k for k, row in enumerate(rows, start=2) if row["position"] == "18" and row["ball"] == "5")
    assert f"row {row}" in done.stderr
    assert "measure this position again or remove it" in done.stderr
    assert not (tmp_path / "out").exists()


def test_the_rest_of_the_file_is_good(tmp_path: Path) -> None:
    seen, bar = measurement(1, "tilted")
    rows = [row for row in rows_of(slipped(seen, 7, 5, 30.0, seed=3)) if row["position"] != "8"]
    assert Folder(tmp_path).run(bar, rows, "--order", "4").exit_code == 0
