"""Touches that are latched at exactly the same position again and again."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.errors import ProtocolError
from drivers.linuxcnc.device import LinuxCncProbing
from drivers.linuxcnc.settings import LinuxCncSettings
from drivers.repeated_latch import MOST_REPEATS, RepeatedLatch
from drivers.roles import Touch

START, TARGET = (100.0, 200.0, 300.0), (100.0, 210.0, 300.0)
OLD = (100.0, 204.00012, 300.0)


def test_an_old_value_that_is_reported_again_is_noticed() -> None:
    latches = RepeatedLatch(1.0)
    said = [latches.complaint(OLD, START, TARGET) for _ in range(MOST_REPEATS + 1)]
    assert said[:-1] == [""] * MOST_REPEATS
    assert said[-1].startswith(f"the last {MOST_REPEATS} repeated touches agree too well")


def test_an_old_value_of_the_fast_touch_in_each_measuring_touch_is_noticed() -> None:
    """Each place has a touch that finds it and one that measures it; only the second repeats a value."""
    latches = RepeatedLatch(1.0)
    said = []
    for place in range(MOST_REPEATS):
        x = 100.0 + 20.0 * place
        start, target, old = (x, 200.0, 300.0), (x, 210.0, 300.0), (x, 204.0 + 0.0123456 * (place + 1), 300.0)
        said += [latches.complaint(old, start, target), latches.complaint(old, start, target)]
    assert [bool(text) for text in said] == [False] * (2 * MOST_REPEATS - 1) + [True]


def test_one_touch_that_differs_is_enough() -> None:
    latches = RepeatedLatch(1.0)
    for number in range(5 * MOST_REPEATS):
        moved = 1e-5 * (number % MOST_REPEATS == 0)
        assert latches.complaint((100.0, 204.00012 + moved, 300.0), START, TARGET) == ""


@pytest.mark.parametrize("step_mm", [0.001, 0.004, 0.01])
def test_whole_steps_of_a_coarse_controller_often_agree(step_mm: float) -> None:
    latches = RepeatedLatch(1.0)
    coarse = tuple(round(value / step_mm) * step_mm for value in OLD)
    assert all(latches.complaint(coarse, START, TARGET) == "" for _ in range(5 * MOST_REPEATS))


@given(st.integers(0, 2**32 - 1))
def test_touches_that_scatter_are_never_complained_about(seed: int) -> None:
    """The controller has a resolution of 0.1 µm, and the probe repeats within 0.25 µm (1σ)."""
    scatter, latches = np.random.default_rng(seed), RepeatedLatch(1.0)
    for _ in range(200):
        y = round(204.00005 + 0.00025 * scatter.standard_normal(), 4)
        assert latches.complaint((100.0, y, 300.0), START, TARGET) == ""


def test_the_driver_of_linuxcnc_refuses_an_old_value() -> None:
    snapshot = SimpleNamespace(tool=0, tripped=True, probed=OLD, feed_override=1.0)
    limits = SimpleNamespace(rapid_mm_per_s=(100.0,) * 3, acceleration_mm_per_s2=(500.0,) * 3)
    session = SimpleNamespace(
        settings=LinuxCncSettings(),
        read_snapshot=lambda: snapshot,
        probe_healthy=lambda _: True,
        properties=SimpleNamespace(limits=limits, servo_period_s=1e-3),
        where={"device": "cnc"},
    )
    motion = SimpleNamespace(run=lambda *_: SimpleNamespace(snapshot=snapshot, start=START))
    probing = LinuxCncProbing(session, motion)  # type: ignore[arg-type]
    for _ in range(MOST_REPEATS):
        assert isinstance(probing.touch_towards(np.array(TARGET), 5.0), Touch)
    with pytest.raises(ProtocolError, match="agree too well") as caught:
        probing.touch_towards(np.array(TARGET), 5.0)
    assert caught.value.where == {"device": "cnc"}
    assert "debounce" in caught.value.hint
