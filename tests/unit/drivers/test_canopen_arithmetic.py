"""Tests of the pure parts of the CANopen mount: scale, duration of a turn, state table, settings."""

from __future__ import annotations

import math
import tomllib
from pathlib import Path
from typing import Any

import pytest
from canopen_rig import axis_settings
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from drivers.canopen_mount.emergency import emergency_text
from drivers.canopen_mount.scale import AxisScale, turn_duration_s
from drivers.canopen_mount.settings import CanopenMountSettings
from drivers.canopen_mount.states import ENABLE_TRANSITIONS, DriveState, drive_state


def scale(**changes: Any) -> AxisScale:
    stated = {
        "counts_per_revolution": 4096,
        "motor_revolutions": 203,
        "shaft_revolutions": 9,
        "direction": 1,
        "offset_deg": 0.0,
    }
    return AxisScale.of(**(stated | changes))


def test_counts_by_hand() -> None:
    """4096 * 203 / 9 = 92387.555... counts per turn; a quarter is 23096.888..., rounded 23097."""
    assert scale().counts(90.0) == 23097
    assert scale().counts(-90.0) == -23097
    assert scale(direction=-1).counts(90.0) == -23097
    assert scale(offset_deg=-90.0).counts(0.0) == 23097
    assert scale().angle_deg(23097) == pytest.approx(23097 * 360 / 92387.5555555555, abs=1e-9)


@pytest.mark.parametrize(("angle", "counts"), [(0.5, 0), (1.5, 2), (2.5, 2), (-0.5, 0), (-1.5, -2), (2.5000001, 3)])
def test_ties_go_to_even(angle: float, counts: int) -> None:
    assert scale(counts_per_revolution=360, motor_revolutions=1, shaft_revolutions=1).counts(angle) == counts


@given(
    counts=st.integers(-(2**31) + 1, 2**31 - 1),
    direction=st.sampled_from([1, -1]),
    offset=st.floats(-360.0, 360.0),
    motor=st.integers(1, 500),
    shaft=st.integers(1, 20),
    encoder=st.integers(1000, 2**20),
)
def test_counts_survive_conversion_to_degrees_and_back(
    counts: int, direction: int, offset: float, motor: int, shaft: int, encoder: int
) -> None:
    there = scale(
        counts_per_revolution=encoder,
        motor_revolutions=motor,
        shaft_revolutions=shaft,
        direction=direction,
        offset_deg=offset,
    )
    assert there.counts(there.angle_deg(counts)) == counts


def integrated_duration_s(distance: float, speed: float, acceleration: float, step: float = 1e-4) -> float:
    """Simulate a turn in small steps: accelerate while the remaining angle exceeds the braking angle."""
    velocity = gone = elapsed = 0.0
    while gone < distance:
        brake = velocity**2 / (2 * acceleration)
        slower = distance - gone <= brake
        velocity = max(step * acceleration, velocity - step * acceleration) if slower else velocity
        velocity = velocity if slower else min(speed, velocity + step * acceleration)
        gone += velocity * step
        elapsed += step
    return elapsed


@pytest.mark.parametrize(
    ("distance", "speed", "acceleration"), [(90.0, 10.0, 50.0), (0.5, 10.0, 50.0), (2.0, 10.0, 50.0)]
)
def test_duration_against_small_steps(distance: float, speed: float, acceleration: float) -> None:
    expected = integrated_duration_s(distance, speed, acceleration)
    assert turn_duration_s(-distance, speed, acceleration) == pytest.approx(expected, abs=5e-3)


def test_no_turn_takes_no_time() -> None:
    assert turn_duration_s(0.0, 10.0, 50.0) == 0.0


@pytest.mark.parametrize(
    ("statusword", "state"),
    [
        (0x0000, DriveState.NOT_READY),
        (0x0250, DriveState.SWITCH_ON_DISABLED),
        (0x0231, DriveState.READY),
        (0x0633, DriveState.SWITCHED_ON),
        (0x1637, DriveState.OPERATION_ENABLED),
        (0x0617, DriveState.QUICK_STOP_ACTIVE),
        (0x021F, DriveState.FAULT_REACTION),
        (0x023F, DriveState.FAULT_REACTION),
        (0x0218, DriveState.FAULT),
        (0x0238, DriveState.FAULT),
    ],
)
def test_statewords_as_drives_send_them(statusword: int, state: DriveState) -> None:
    assert drive_state(statusword) is state


def test_undefined_pattern_is_no_state() -> None:
    assert drive_state(0x0002) is None


@given(st.integers(0, 0xFFFF))
def test_only_seven_bits_make_the_state(statusword: int) -> None:
    assert drive_state(statusword) is drive_state(statusword & 0x6F)


def test_every_state_leads_to_operation_enabled() -> None:
    for start in DriveState:
        state, path_s = start, 0.0
        for _ in DriveState:
            if state is not DriveState.OPERATION_ENABLED:
                path_s += ENABLE_TRANSITIONS[state].within_s
                state = ENABLE_TRANSITIONS[state].target
        assert state is DriveState.OPERATION_ENABLED
        assert math.isfinite(path_s)


@pytest.mark.parametrize(
    ("code", "text"),
    [
        (0x8611, "0x8611 following error"),
        (0x8613, "0x8613 positioning controller"),
        (0x2311, "0x2311 continuous over-current"),
        (0x23F0, "0x23F0 current at the output"),
        (0xFF07, "0xFF07 device specific"),
        (0x0000, "0x0000 no error"),
        (0x0042, "0x0042 unknown error code"),
    ],
)
def test_emergency_texts(code: int, text: str) -> None:
    assert emergency_text(code) == text


def mount_settings(**changes: Any) -> dict[str, Any]:
    return {
        "interface": "virtual",
        "channel": "x",
        "azimuth": axis_settings(5),
        "elevation": axis_settings(6),
        **changes,
    }


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"elevation": axis_settings(5)}, "both have node id 5"),
        ({"azimuth": axis_settings(5, lower_deg=10.0, upper_deg=10.0)}, "not below"),
        ({"azimuth": axis_settings(5, encoder_counts_per_revolution=2**30)}, "0x607A holds at most 2147483647"),
        ({"azimuth": axis_settings(128)}, "less than or equal to 127"),
        ({"azimuth": axis_settings(5, colour="blue")}, "Extra inputs"),
        ({"heartbeat_ms": 2000, "heartbeat_timeout_s": 3.0}, "less than two periods of 2000 ms"),
        ({"bitrate": 500_000}, "Extra inputs"),
    ],
)
def test_invalid_settings(changes: dict[str, Any], text: str) -> None:
    with pytest.raises(ValidationError, match=text):
        CanopenMountSettings.model_validate(mount_settings(**changes))


def test_settings_of_the_reference_page() -> None:
    page = Path(__file__).parents[3] / "docs" / "reference" / "canopen-mount.md"
    example = page.read_text(encoding="utf-8").split("```toml\n")[1].split("```")[0]
    options = tomllib.loads(example)["devices"]["mount"]["options"]
    settings = CanopenMountSettings.model_validate(options)
    assert settings.azimuth.scale.counts(90.0) == 2_621_440  # 131072 * 80 / 4
    assert settings.options == {"bitrate": 500_000}
