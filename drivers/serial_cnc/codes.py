"""Texts for the numbers after ``error:`` and ``ALARM:`` in the lines of GRBL and grblHAL.

Sources of the numbers: gnea/grbl doc/csv/error_codes_en_US.csv and alarm_codes_en_US.csv (GRBL 1.1); grblHAL/core
errors.h and alarms.h for the numbers that GRBL does not have. The texts are not copied from these sources.
"""

from __future__ import annotations

ERRORS = {
    1: "a word does not begin with a letter",
    2: "a number is missing or malformed",
    3: "unknown $ command",
    4: "a value must not be negative",
    5: "homing is not enabled",
    6: "step pulse too short",
    7: "stored settings could not be read, defaults are in use",
    8: "a $ command that is allowed only while idle",
    9: "locked: alarm or jogging",
    10: "soft limits need homing",
    11: "line too long",
    12: "step rate too high",
    13: "safety door open",
    14: "line too long to be stored",
    15: "jog target outside the travel",
    16: "malformed jog command",
    17: "laser mode needs a PWM output",
    18: "reset",
    19: "a value must be positive",
    20: "unsupported G-code",
    21: "two words of one modal group",
    22: "no feed rate",
    23: "a value must be a whole number",
    24: "two words that both want the axes",
    25: "a word is repeated",
    26: "axis words are missing",
    27: "line number out of range",
    28: "a value word is missing",
    29: "coordinate system not supported",
    30: "G53 works with G0 and G1 only",
    31: "axis words that nothing uses",
    32: "arc without axis words in its plane",
    33: "target cannot be reached, or is where the axes are",
    34: "impossible arc radius",
    35: "arc without offset in its plane",
    36: "words that nothing uses",
    37: "tool length offset on another axis",
    38: "tool number too large",
    39: "value out of range",
    40: "waiting for a tool change",
    41: "spindle does not turn",
    43: "feed rate too high",
    44: "spindle speed out of range",
    45: "limit switch active",
    46: "homing required",
    50: "emergency stop active",
    51: "motor fault",
    52: "setting out of range",
    53: "setting disabled",
    79: "not allowed before the alarm is cleared",
}

LOCKED_ERRORS = frozenset({9, 45, 46, 50, 51, 79})

ALARM_HARD_LIMIT, ALARM_SOFT_LIMIT, ALARM_ABORTED, ALARM_PROBE_STATE, ALARM_NO_CONTACT = 1, 2, 3, 4, 5
ALARMS = {
    ALARM_HARD_LIMIT: "limit switch hit",
    ALARM_SOFT_LIMIT: "target outside the travel",
    ALARM_ABORTED: "reset in motion",
    ALARM_PROBE_STATE: "probe was not in its initial state",
    ALARM_NO_CONTACT: "probe found nothing within the travel",
    6: "reset while homing",
    7: "door opened while homing",
    8: "homing could not pull off a switch",
    9: "homing found no switch",
    10: "emergency stop",
    11: "homing required",
    12: "limit switch active",
    13: "probe tripped in a move that was not a probe cycle",
    14: "spindle fault",
    15: "homing could not square the gantry",
    16: "self-test failed",
    17: "motor fault",
    18: "homing failed",
}

POSITION_KEPT = frozenset({ALARM_SOFT_LIMIT, ALARM_PROBE_STATE, ALARM_NO_CONTACT, 13})
"""Alarms in which the position remains known, so the machine may be unlocked without homing."""
NEEDS_RESET = frozenset({ALARM_HARD_LIMIT, ALARM_SOFT_LIMIT, 10, 17})
"""Alarms after which the controller responds to nothing but a soft reset."""


def error_text(code: int) -> str:
    return f"{ERRORS.get(code, 'a reason that is not listed')} (error {code})"


def alarm_text(code: int | None) -> str:
    """Return the text of an alarm code.

    A `code` of None means that the controller is locked and has not given the reason.
    """
    if code is None:
        return "alarm lock: not homed since it was switched on or reset"
    return f"{ALARMS.get(code, 'an alarm that is not listed')} (alarm {code})"
