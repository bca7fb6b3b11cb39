"""Delay between the trip of the probe and the latching (storing) of the axis positions by the controller. It is
measured by touches of the pole of a ball at two feeds: the axes travel on during the delay, so that touches at the
higher feed are latched deeper.

A constant delay shifts all touches alike as long as all of them are made at the same feed. It then makes the effective
radius of the stylus smaller and leaves the ball centres as they are. A feed override that is turned meanwhile is
another matter, and so is a delay that varies.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from agent.execution.steps import Plan, Record
from agent.probing.probe_check import pole_depth_mm
from agent.probing.probing_parameters import ProbingParameters
from drivers.roles import Vector
from twin.units import S_PER_MIN, UM_PER_MM

SLOW_SHARE = 0.25
"""Lower feed as a fraction of the feed of the measuring touch."""
LAG_LIMIT_MM = 5e-3
"""Travel in mm between trip and latch at the feed of the measuring touch from which a warning is given. A feed override
of 80 % then changes each touch by 1 µm, which is the repeatability of a good probe."""
COVERAGE_FACTOR = 2.0
MS_PER_S = 1e3


@dataclass(frozen=True)
class LatchDelay:
    """Delay between trip and latch in ms, with its standard uncertainty. `lag_um` is the travel of the axes in µm
    during the delay, at the higher of the two feeds in mm/min. `touches` is the number of touches at each feed."""

    delay_ms: float
    sigma_ms: float
    lag_um: float
    feeds_mm_per_min: tuple[float, float]
    touches: int

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warning that the latch is late; empty if the lag is not reliably above the limit."""
        slow, fast = self.feeds_mm_per_min
        share = abs(self.lag_um) / UM_PER_MM - COVERAGE_FACTOR * self.sigma_ms / MS_PER_S * fast / S_PER_MIN
        if share <= LAG_LIMIT_MM:
            return ()
        if self.delay_ms < 0.0:
            return (
                f"Touches at {slow:g} mm/min are latched deeper than touches at {fast:g} mm/min. This is no delay "
                "of the latch; check the filter and the trigger force of the probe.",
            )
        return (
            f"The axis positions are latched {self.delay_ms:.1f} ms after the trip; at {fast:g} mm/min the axes travel "
            f"{self.lag_um:.1f} µm meanwhile. Compare with the delay in the data sheet of the probe's interface; if "
            "that is shorter, latch the positions in the drives or at a fast input, not in the PLC program. Lock the "
            "feed override during measurements.",
        )

    @property
    def text(self) -> str:
        slow, fast = self.feeds_mm_per_min
        return (
            f"{self.delay_ms:.2f} ms ± {COVERAGE_FACTOR * self.sigma_ms:.2f} ms (2σ) between trip and latch, from "
            f"{self.touches} touches each at {slow:g} and {fast:g} mm/min: {self.lag_um:.1f} µm at {fast:g} mm/min"
        )


def measure_latch_delay(key: str, centre: Vector, probing: ProbingParameters, touches: int) -> Plan[LatchDelay]:
    """Touch the pole of the ball at `centre` `touches` times at each of two feeds. The order slow, fast, fast, slow …
    cancels a linear drift.

    Raises MeasurementFault if a touch meets nothing.
    """
    fast_mm_per_s, slow_mm_per_s = probing.feed_mm_per_s, SLOW_SHARE * probing.feed_mm_per_s
    depths_mm: dict[float, list[float]] = {slow_mm_per_s: [], fast_mm_per_s: []}
    for number in range(2 * touches):
        feed = fast_mm_per_s if number % 4 in (1, 2) else slow_mm_per_s
        at_feed = replace(probing, feed_mm_per_s=feed, fast_touch=None)
        depths_mm[feed].append((yield from pole_depth_mm(f"{key}/touch-{number}", centre, at_feed)))
    result = latch_delay_of(depths_mm[slow_mm_per_s], depths_mm[fast_mm_per_s], probing)
    payload = {
        **vars(result),
        "text": result.text,
        "depths_um": [[d * UM_PER_MM for d in x] for x in depths_mm.values()],
    }
    yield Record(f"{key}/latch-delay", "decision", payload)
    for warning in result.warnings:
        yield Record(f"{key}/warning", "event", {"reason": warning})
    return result


def latch_delay_of(slow_mm: Sequence[float], fast_mm: Sequence[float], probing: ProbingParameters) -> LatchDelay:
    """Return the delay that explains why touches at the feed of the measuring touch (`fast_mm`) are latched deeper than
    touches at the lower feed (`slow_mm`). Both are positions along the stylus in mm."""
    count, fast = len(fast_mm), probing.feed_mm_per_s
    between = (1.0 - SLOW_SHARE) * fast
    # d = v t: the delay t is the slope of the depth over the feed. The scatter of these few touches may be smaller than
    # the probe's by chance.
    pooled = float(np.sqrt(0.5 * (np.var(slow_mm, ddof=1) + np.var(fast_mm, ddof=1))))
    sigma_mm = max(pooled, probing.touch_sigma_mm) * np.sqrt(2.0 / count)
    delay_s = (float(np.mean(fast_mm)) - float(np.mean(slow_mm))) / between
    return LatchDelay(
        delay_ms=delay_s * MS_PER_S,
        sigma_ms=float(sigma_mm) / between * MS_PER_S,
        lag_um=delay_s * fast * UM_PER_MM,
        feeds_mm_per_min=(SLOW_SHARE * fast * S_PER_MIN, fast * S_PER_MIN),
        touches=count,
    )
