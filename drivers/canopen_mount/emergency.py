"""Texts of the error codes in emergency messages (EMCY) and in object 0x603F (CiA 301 table 26, CiA 402-2 annex).

A code that is not in the table of this module gets the text of the most specific error class to which it belongs.
"""

from __future__ import annotations

_TEXTS: dict[int, str] = {
    0x0000: "no error",
    0x1000: "generic error",
    0x2000: "current",
    0x2200: "current inside the device",
    0x2300: "current at the output",
    0x2310: "continuous over-current",
    0x2320: "short circuit or earth leakage",
    0x2340: "short circuit between phases",
    0x2350: "load level (I²t)",
    0x3000: "voltage",
    0x3100: "mains voltage",
    0x3200: "voltage inside the device",
    0x3210: "DC link over-voltage",
    0x3220: "DC link under-voltage",
    0x3300: "output voltage",
    0x4000: "temperature",
    0x4200: "device temperature",
    0x4210: "device too hot",
    0x4300: "drive temperature",
    0x4310: "drive too hot",
    0x5000: "device hardware",
    0x5100: "supply inside the device",
    0x5400: "power section",
    0x5530: "non-volatile memory",
    0x6000: "device software",
    0x6100: "internal software",
    0x6300: "data record",
    0x6320: "parameter",
    0x7000: "additional modules",
    0x7100: "power module",
    0x7110: "brake chopper",
    0x7120: "motor",
    0x7121: "motor blocked",
    0x7122: "motor or commutation",
    0x7300: "sensor",
    0x7305: "incremental encoder 1",
    0x7306: "incremental encoder 2",
    0x7310: "speed sensor",
    0x7320: "position sensor",
    0x8000: "monitoring",
    0x8100: "communication",
    0x8110: "CAN overrun, objects lost",
    0x8120: "CAN in error passive mode",
    0x8130: "life guard or heartbeat",
    0x8140: "recovered from bus off",
    0x8150: "CAN-ID collision",
    0x8200: "protocol",
    0x8210: "PDO not processed, wrong length",
    0x8300: "torque control",
    0x8400: "velocity control",
    0x8500: "position control",
    0x8600: "positioning controller",
    0x8611: "following error",
    0x8612: "reference limit",
    0x8700: "sync controller",
    0x9000: "external error",
    0xF000: "additional functions",
    0xFF00: "device specific",
}


def emergency_text(code: int) -> str:
    """Return an error code with its text, for example ``0x8611 following error``."""
    for mask in (0xFFFF, 0xFFF0, 0xFF00, 0xF000):
        # 0x0000 is in the table as "no error"; a code whose masked value is 0 must not get this text.
        if code & mask in _TEXTS and (code & mask or not code):
            return f"0x{code:04X} {_TEXTS[code & mask]}"
    return f"0x{code:04X} unknown error code"
