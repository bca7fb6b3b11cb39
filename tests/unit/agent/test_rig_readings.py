"""Readings of the rig that are not numbers."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import pytest

from agent.errors import MeasurementFault
from agent.execution.engine import Engine
from agent.execution.rig import Rig
from agent.thermal.settling import SettlingRules, read_conditions
from drivers.clock import VirtualClock


def rig_reading(readings_c: dict[str, float]) -> Rig:
    device: Any = SimpleNamespace(temperatures_c=lambda: readings_c)
    return Rig({}, device, device, {}, device, device, device, VirtualClock())


@pytest.mark.parametrize("broken", [math.nan, math.inf, -math.inf])
def test_a_thermometer_that_gives_no_number_gives_no_reading(broken: float) -> None:
    engine = Engine(rig_reading({"artefact": broken, "machine": 20.5}).actions())
    with pytest.raises(MeasurementFault, match="no reading of artefact; readings: machine"):
        engine.run(read_conditions("ball-00", SettlingRules(), None))
    engine = Engine(rig_reading({"artefact": 21.0, "machine": broken}).actions())
    found = engine.run(read_conditions("ball-00", SettlingRules(), None))
    assert (found.artefact_c, found.machine_c) == (21.0, None)
