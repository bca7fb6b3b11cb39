"""Contacts in a deviated field compared with plain bisection of the distance between tip and ball."""

import math
from types import SimpleNamespace

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from simulators.world.contact import ContactSolver
from simulators.world.field import TipShift
from twin.collision.motion_law import straight_path

REACH = 15.5
CENTRE = (1000.0, 800.0, 700.0)
TOOL = (0.0, 250.0, 0.0)


def field(positions: np.ndarray) -> np.ndarray:
    """Return a field worse than a machine's: 0.05 mm, changing by up to 0.1 µm per mm."""
    return 0.05 * np.sin(positions[:, [1, 2, 0]] / 500.0 + [0.3, 1.0, 2.0])


def gap(axis_position: np.ndarray) -> float:
    tip = axis_position + TOOL + field(axis_position[None])[0]
    return math.dist(tip, CENTRE) - REACH


@given(
    st.floats(-math.pi, math.pi),
    st.floats(-1.2, 1.2),
    st.floats(0.5, 40.0),
    st.floats(-10.0, 10.0),
    st.floats(-10.0, 10.0),
)
@settings(max_examples=80, deadline=None)
def test_contact_is_where_bisection_finds_it(turn, rise, away, aside_x, aside_z) -> None:
    direction = np.array([math.cos(turn) * math.cos(rise), math.sin(turn) * math.cos(rise), math.sin(rise)])
    middle = np.array(CENTRE) - TOOL
    start = middle - direction * (REACH + 1.0 + away)
    aim = middle + np.array([aside_x, 0.0, aside_z])
    solver = ContactSolver(TOOL, REACH, TipShift(field))
    path = straight_path(tuple(start.tolist()), tuple(aim.tolist()))
    found = solver.first(path, SimpleNamespace(balls=(CENTRE,)), None)  # type: ignore[arg-type]

    low, high = 0.0, path.length
    assert gap(np.array(path.at(low))) > 0.0 > gap(np.array(path.at(high)))
    for _ in range(60):
        half = 0.5 * (low + high)
        low, high = (half, high) if gap(np.array(path.at(half))) > 0.0 else (low, half)
    assert found is not None
    assert abs(found.distance - low) < 1e-6  # 1 nm; the whole field is 50 µm
