"""G and M codes that are interpreted or passed on unchanged, and the reasons why other codes are refused.

A code is stored as ten times its number in the program, for example 911 for G91.1. The meanings of the codes are those
in RS-274/NGC (NISTIR 6556), LinuxCNC and Grbl 1.1. If Fanuc-like controllers interpret a code differently, the code is
refused, that is, the program is not corrected.
"""

from __future__ import annotations

from gcode.modal import SYSTEM_CODES
from gcode.words import Block

AXIS_LETTERS = "XYZ"
MOTIONS = (0, 10, 20, 30)

_GROUPS: dict[str, tuple[int, ...]] = {
    "motion": (*MOTIONS, 800),
    "plane": (170, 180, 190),
    "units": (200, 210),
    "distance": (900, 910),
    "arc centres": (901, 911),
    "feed mode": (930, 940, 950),
    "coordinate system": tuple(SYSTEM_CODES),
    "tool length": (430, 431, 490),
    "lathe radius": (80,),
    "one block only": (40, 100, 280, 281, 300, 301, 530, 920, 921, 922, 923),
    "cutter radius": (400,),
    "path": (610, 611, 640),
    "spindle mode": (960, 970),
    "retract": (980, 990),
    "scaling off": (500,),
    "rotation off": (690,),
    "polar off": (150,),
}
GROUP_OF = {code: name for name, codes in _GROUPS.items() for code in codes}

_OFFSETS = "it changes coordinates that only the controller knows"
_CUTTER = "cutter compensation shifts the path by a radius that only the controller knows"
_CYCLE = "a canned cycle contains moves that are not in the program"
_PROBING = "the end of a probing move is not known in advance"
_TURNED = "coordinates would be scaled, mirrored, rotated or polar"
_LATHE = "it belongs to a lathe"
REASONS: dict[int, str] = {
    50: "splines are not supported",
    51: "splines are not supported, and it may be a high-speed mode",
    52: "splines are not supported",
    53: "splines are not supported",
    70: _LATHE,
    160: _TURNED,
    310: _PROBING,
    330: _LATHE,
    331: "rigid tapping is synchronised with the spindle",
    **dict.fromkeys((380, 382, 383, 384, 385), _PROBING),
    **dict.fromkeys((410, 411, 420, 421), _CUTTER),
    432: "it adds tool lengths",
    440: "it subtracts the tool length, which controllers do differently",
    510: _TURNED,
    520: _OFFSETS,
    541: _OFFSETS,
    680: _TURNED,
    **dict.fromkeys((650, 660, 670), "macros and subprograms are not supported"),
    **dict.fromkeys((730, 740, 760, 810, 820, 830, 840, 850, 860, 870, 880, 890), _CYCLE),
}
HINTS: dict[str, str] = {
    _CUTTER: "Set the post-processor to write the path of the tool centre",
    _CYCLE: "Set the post-processor to write single moves",
    _OFFSETS: "Set the offsets before the program and give them to this command",
}

TOOL_CHANGE = 60
TOOL_NAMED = 610
"""Ten times the number of M61, which sets the number of the tool in the spindle."""

PROGRAM_END = (20, 300)
STOPS = frozenset((0, 10, 600, *PROGRAM_END))
"""M codes that take effect after the motion of their block, on every controller."""

FIRST = frozenset((30, 40, 70, 80))
"""M codes that take effect before or with the motion: those that switch the spindle or the coolant on."""

_BLENDING, _COOLANT_OFF = 640, 90
_M_GROUPS = {
    **dict.fromkeys((30, 40, 50), "spindle"),
    **dict.fromkeys((70, 80, _COOLANT_OFF), "coolant"),
    **dict.fromkeys((480, 490), "overrides"),
}

_CALLS = frozenset((960, 970, 980, 990))
_STATES = frozenset((700, 710, 720, 730))
_ROTARY = frozenset("ABCUVW")


def check_codes(block: Block, kept_g: frozenset[int]) -> None:
    """Raise FormatError if a block (program line) contains a G or M code that cannot be interpreted, or two G codes of
    the same group.
    """
    seen: set[str] = set()
    for code in block.g:
        group = GROUP_OF.get(code)
        if group is None:
            if code not in kept_g:
                _refuse_code(block, code)
        elif group in seen:
            block.refuse(f"two G codes for the {group} in one block")
        else:
            seen.add(group)
    for code in block.m:
        if code in _CALLS:
            block.refuse("subprograms are not supported", "Set the post-processor to write a single program")
        if code in _STATES:
            block.refuse(f"M{code // 10} saves or restores modal states on some controllers")


def check_letters(block: Block) -> None:
    """Raise FormatError if a block (program line) contains an O-word or the word of an axis that the compensation table
    does not have.
    """
    values = block.values
    if "O" in values:
        block.refuse("an O-word begins or calls a subprogram", "Set the post-processor to write a single program")
    rotary = _ROTARY.intersection(values)
    if rotary and not (40 in block.g and rotary == {"U"}):
        block.refuse(f"the table has no axis {min(rotary)}", "Only X, Y and Z can be corrected")


def remember_words(block: Block, words: dict[str, str]) -> None:
    """Record the words of groups that do not change the path in `words`, by the name of their group."""
    for letter, number, _ in block.tokens:
        if letter in ("F", "S"):
            words[letter] = letter + number
    for code in block.g:
        if GROUP_OF.get(code) == "path":
            parts = [letter + number for letter, number, _ in block.tokens if letter in ("P", "Q")]
            words["path mode"] = " ".join([f"G{code / 10:g}", *(parts if code == _BLENDING else ())])
    for code in block.m:
        group = _M_GROUPS.get(code)
        if group is not None:
            # M7 (mist) and M8 (flood) may be on together; only M9 switches them off.
            both = (
                group == "coolant" and code != _COOLANT_OFF and words.get(group, "M9") not in ("M9", f"M{code // 10}")
            )
            words[group] = f"M{code // 10}" if not both else "M7 M8"


def _refuse_code(block: Block, code: int) -> None:
    name = f"G{code // 10}" + (f".{code % 10}" if code % 10 else "")
    if code < 0:
        block.refuse("a G code is a number with at most one decimal")
    reason = REASONS.get(code)
    if reason is None:
        hint = f"If it neither moves the axes nor changes coordinates: --keep {name}"
        block.refuse(f"{name} is not supported", hint)
    block.refuse(f"{name} cannot be corrected, {reason}", HINTS.get(reason, ""))
