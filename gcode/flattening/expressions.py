"""Numbers, parameters and expressions in the text of a block.

Operators of the same precedence are evaluated from left to right, also powers. In descending order of precedence they
are: `**`; `*`, `/` and `MOD`; `+` and `-`; comparisons; `AND`, `OR` and `XOR`. Angles are in degrees. Numbers are equal
if they differ by less than 0.0001.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from functools import partial

from gcode.flattening.parameters import Key, ProgramParameters
from gcode.source import SourceLine
from gcode.words import LARGEST_NUMBER

_NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)")
_NAME = re.compile(r"<([^<>]*)>")
_FUNCTION = re.compile(r"[a-z]+")
_OPERATOR = re.compile(r"\*\*|[-+*/]|mod|eq|ne|gt|ge|lt|le|and|or|xor")
_EQUAL = 1e-4
_INTEGER = 1e-4
_MOST_NESTED = 50

_PRECEDENCE = {
    **dict.fromkeys(("and", "or", "xor"), 1),
    **dict.fromkeys(("eq", "ne", "gt", "ge", "lt", "le"), 2),
    **dict.fromkeys(("+", "-"), 3),
    **dict.fromkeys(("*", "/", "mod"), 4),
    "**": 5,
}


def _modulo(left: float, right: float) -> float:
    # fmod has the sign of the dividend, whereas MOD of LinuxCNC is never negative.
    rest = math.fmod(left, right)
    return rest + abs(right) if rest < 0.0 else rest


_BINARY: dict[str, Callable[[float, float], float]] = {
    "and": lambda a, b: float(a != 0.0 and b != 0.0),
    "or": lambda a, b: float(a != 0.0 or b != 0.0),
    "xor": lambda a, b: float((a != 0.0) != (b != 0.0)),
    "eq": lambda a, b: float(abs(a - b) < _EQUAL),
    "ne": lambda a, b: float(abs(a - b) >= _EQUAL),
    "gt": lambda a, b: float(a > b),
    "ge": lambda a, b: float(a >= b),
    "lt": lambda a, b: float(a < b),
    "le": lambda a, b: float(a <= b),
    "+": lambda a, b: a + b,
    "-": lambda a, b: a - b,
    "*": lambda a, b: a * b,
    "/": lambda a, b: a / b,
    "mod": _modulo,
    "**": math.pow,
}

_FUNCTIONS: dict[str, Callable[[float], float]] = {
    "abs": abs,
    "acos": lambda x: math.degrees(math.acos(x)),
    "asin": lambda x: math.degrees(math.asin(x)),
    "cos": lambda x: math.cos(math.radians(x)),
    "exp": math.exp,
    # FIX rounds down and FUP up, also below zero.
    "fix": math.floor,
    "fup": math.ceil,
    "ln": math.log,
    # Halves are rounded away from zero; `round` of Python would round them to even numbers.
    "round": lambda x: float(math.trunc(x + math.copysign(0.5, x))),
    "sin": lambda x: math.sin(math.radians(x)),
    "sqrt": math.sqrt,
    "tan": lambda x: math.tan(math.radians(x)),
}


class ExpressionReader:
    """Reader of the values in `code`, the text of a block in lower case without comments and white space.

    `at` is the index of the next character. Errors name the line `source`.
    """

    def __init__(self, source: SourceLine, code: str, parameters: ProgramParameters) -> None:
        self.source = source
        self.code = code
        self.at = 0
        self.computed = False
        self._parameters = parameters
        self._depth = 0

    @property
    def next(self) -> str:
        """Next character, or an empty string at the end."""
        return self.code[self.at : self.at + 1]

    def skip(self, sign: str) -> None:
        """Skip the character `sign`. Raises FormatError if another one follows."""
        if self.next != sign:
            self.source.refuse(f"'{sign}' is expected {self._place()}")
        self.at += 1

    def value(self) -> float:
        """Read a number, a parameter, an expression in brackets or a function."""
        number = _NUMBER.match(self.code, self.at)
        if number is not None:
            self.at = number.end()
            value = float(number[0])
            if abs(value) > LARGEST_NUMBER:
                self.source.refuse(f"a number {self._place()} has too many digits")
            return value
        self.computed = True
        sign = self.next
        # A sign belongs to its value and precedes every operator: -2**2 is 4.
        if sign in ("+", "-"):
            self.at += 1
            return -self.value() if sign == "-" else self.value()
        if sign == "#":
            return self._parameters.read(self.key(), self.source)
        if sign == "[":
            return self.expression()
        return self._function()

    def key(self) -> Key:
        """Read a parameter with its `#`, and return its number or name."""
        self.skip("#")
        name = _NAME.match(self.code, self.at)
        if name is not None:
            self.at = name.end()
            return name[1]
        number = self.value()
        if abs(number - round(number)) > _INTEGER or number < 0.0:
            self.source.refuse(f"a parameter has an integer number, not {number:g}")
        return round(number)

    def expression(self) -> float:
        """Read an expression in brackets."""
        self.computed = True
        self.skip("[")
        self._depth += 1
        if self._depth > _MOST_NESTED:
            self.source.refuse(f"brackets are nested more than {_MOST_NESTED} deep")
        value = self._operation(1)
        self.skip("]")
        self._depth -= 1
        return value

    def _operation(self, least: int) -> float:
        left = self.value()
        while True:
            operator = _OPERATOR.match(self.code, self.at)
            if operator is None or _PRECEDENCE[operator[0]] < least:
                return left
            self.at = operator.end()
            # Precedence climbing: the right operand contains only operators of higher precedence, so operators of the
            # same precedence are evaluated from left to right.
            right = self._operation(_PRECEDENCE[operator[0]] + 1)
            left = self._checked(partial(_BINARY[operator[0]], left, right), operator[0])

    def _function(self) -> float:
        found = _FUNCTION.match(self.code, self.at)
        name = found[0] if found else ""
        if found is None or (name not in _FUNCTIONS and name not in ("atan", "exists")):
            self.source.refuse(f"a number, a parameter or an expression is expected {self._place()}")
        self.at = found.end()
        if name == "exists":
            return self._exists()
        argument = self.expression()
        # ATAN has two arguments, ATAN[y]/[x], and gives the angle in all four quadrants.
        if name == "atan":
            self.skip("/")
            return math.degrees(math.atan2(argument, self.expression()))
        return self._checked(lambda: _FUNCTIONS[name](argument), name)

    def _exists(self) -> float:
        self.skip("[")
        key = self.key()
        self.skip("]")
        return float(self._parameters.find(key, self.source) is not None)

    def _checked(self, compute: Callable[[], float], name: str) -> float:
        try:
            value = float(compute())
        except (ValueError, ZeroDivisionError, OverflowError):
            value = math.nan
        if not math.isfinite(value):
            self.source.refuse(f"the result of {name.upper()} is not a finite number")
        return value

    def _place(self) -> str:
        return f"before '{self.code[self.at : self.at + 10]}'" if self.next else "at the end of the line"
