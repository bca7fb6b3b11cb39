"""Touches of one ball after each of several homings of the axes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from agent.execution.steps import CheckPermissions, CheckProbe, HomeAxes, MoveTo, Plan, ReadPosition, Record
from agent.probing.ball import FittedBall, measure_ball, point
from agent.probing.position import PositionRules
from agent.probing.preparation import DatumBall
from twin.arrays import Array
from twin.units import UM_PER_MM

PREFIX = "homing"


def touch_after_homings(datum: DatumBall, rules: PositionRules, homings: int) -> Plan[tuple[FittedBall, ...]]:
    """Home the axes `homings` times and measure the ball `datum` after each homing.

    Before a homing, the probe stands in the retreat plane, the end of travel that no part of the artefact or mount
    reaches, beside the station. Artefact and mount are not moved. Raises MeasurementFault if the ball is not found
    again.
    """
    probing = replace(rules.probing, stop_on_failure=True)
    centre, found = datum.found.centre_mm, []
    for number in range(1, homings + 1):
        key = f"{PREFIX}/{number}"
        yield from _home(key, datum.position.station, rules)
        yield from _go_to(key, centre, rules)
        ball = yield from measure_ball(f"{key}/ball-{datum.ball:02d}", centre, probing, probing.narrow_search)
        assert isinstance(ball, FittedBall)  # noqa: S101  a lost ball stops the plan
        off_um = UM_PER_MM * (ball.centre_mm - centre)
        yield Record(f"{key}/found", "event", {"centre_mm": ball.centre_mm, "off_um": off_um})
        found.append(ball)
    above = rules.retreat.withdrawn_from(centre, probing)
    yield MoveTo(f"{PREFIX}/leave", point(rules.retreat.at_retreat_plane(above)))
    return tuple(found)


def _home(key: str, station: int, rules: PositionRules) -> Plan[None]:
    yield CheckPermissions(f"{key}/permissions")
    here = np.array((yield ReadPosition(f"{key}/here")))
    yield MoveTo(f"{key}/retreat", point(rules.retreat.at_retreat_plane(here)))
    yield MoveTo(f"{key}/park", point(rules.retreat.park_location(here, station)))
    yield HomeAxes(f"{key}/home")
    yield CheckPermissions(f"{key}/homed")
    yield CheckProbe(f"{key}/probe")


def _go_to(key: str, centre: Array, rules: PositionRules) -> Plan[None]:
    """Move in the retreat plane to the ball at `centre`, and along the stylus to the front of it."""
    here = np.array((yield ReadPosition(f"{key}/from")))
    above = rules.retreat.withdrawn_from(centre, rules.probing)
    yield MoveTo(f"{key}/return", point(rules.retreat.at_retreat_plane(here)))
    yield MoveTo(f"{key}/enter", point(rules.retreat.at_retreat_plane(above)))
    yield MoveTo(f"{key}/approach", point(above))
