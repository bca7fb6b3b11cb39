"""Random part programs whose blocks contain codes of many modal groups in any order of their words.

Not every block is valid: which ones are is decided by the interpreters that read them.
"""

from __future__ import annotations

import random
from collections.abc import Callable

SYSTEMS = ("G54", "G55", "G56", "G59.3")
WORK_OFFSETS_MM = {"G54": (0.0, 0.0, 0.0), "G55": (31.5, -18.25, 12.0), "G56": (-7.0, 40.0, 3.5)}
"""Work offsets that each program sets at its beginning; those of the other systems are 0."""
TOOLS_MM = {1: (0.0, 0.0, 12.5), 2: (1.5, -2.25, 30.0)}
REFERENCES_MM = {"G28": (20.0, 10.0, 200.0), "G30": (-35.0, 22.0, 180.0)}

_PLANES = {"G17": (0, 1, 2), "G18": (2, 0, 1), "G19": (1, 2, 0)}
_CYCLES = ("G73", "G81", "G82", "G83", "G85", "G86", "G89")

# Codes of each modal group that a block may contain beside its motion, and the probability that it does. Tool changes
# are left out: rs274 without a machine takes the position after them from the last move, whatever offsets have changed
# since.
_MODES: tuple[tuple[float, tuple[str, ...]], ...] = (
    (0.25, ("G90", "G91")),
    (0.12, ("G20", "G21", "G21")),
    (0.08, ("G17", "G17", "G17", "G18", "G19")),
    (0.06, ("G90.1", "G91.1", "G91.1")),
    (0.08, ("G93", "G94", "G94", "G95")),
    (0.10, SYSTEMS),
    (0.06, ("G61", "G64", "G64 P0.01")),
    (0.05, ("G98", "G99")),
    (0.04, ("G40",)),
    (0.03, ("G97",)),
    (0.10, ("M3", "M4", "M5")),
    (0.08, ("M7", "M8", "M9")),
    (0.08, ("S100", "S2000")),
    (0.03, ("T1", "T2")),
    (0.08, ("G43", "G43 H1", "G43 H2", "G49")),
)


class ProgramAuthor:
    """Author of the random program with a seed.

    The plane and the units are followed roughly, so that arcs name the axes of their plane and lengths stay moderate.
    A program either changes units or has tool lengths: LinuxCNC 2.9 does not convert a tool length in effect to another
    unit, and goes wrong by 25 times the length.
    """

    def __init__(self, seed: int) -> None:
        self._random = random.Random(seed)  # noqa: S311  trials, not secrets
        self._inch = False
        self._plane = "G17"
        self._absolute = True
        self._changes_units = self._random.random() < 0.5

    def lines(self) -> list[str]:
        """Return the lines of the program, each with an N word and its line end."""
        offsets = [
            f"G10 L2 P{SYSTEMS.index(name) + 1} X{x:g} Y{y:g} Z{z:g}" for name, (x, y, z) in WORK_OFFSETS_MM.items()
        ]
        begin = ["G21 G90 G17 G94 G91.1 G54 G98 S500", "T1 M6", *offsets, f"G0 {self._axes((0, 1, 2))} F500"]
        blocks = [self._block() for _ in range(self._random.randint(4, 14))]
        return [f"N{10 * number} {text}\n" for number, text in enumerate([*begin, *blocks, "M2"], start=1)]

    def _block(self) -> str:
        draw = self._random
        groups: list[str] = []
        for probability, codes in _MODES:
            if draw.random() < probability:
                code = draw.choice(codes)
                if self._is_allowed(code):
                    groups.append(code)
                    self._follow(code)
        kinds: list[tuple[float, Callable[[], str]]] = [
            (5.0, self._line),
            (4.0, self._polar),
            (3.0, self._arc),
            (2.5, self._cycle),
            (1.5, self._words_alone),
            (1.0, self._offset),
            (0.8, self._datum),
            (0.7, self._reference),
            (0.5, self._machine),
            (0.5, self._tool_length),
            (1.0, lambda: draw.choice(("G80", "G4 P0.1", "", "G28.1", "G30.1"))),
        ]
        kind = draw.choices([kind for _, kind in kinds], [weight for weight, _ in kinds])[0]
        words = [word for part in (*groups, kind()) for word in part.split(" ") if word]
        inverse_time = any(word == "G93" for word in words)
        if inverse_time or draw.random() < 0.15:
            words.append(f"F{draw.choice((2, 5.5, 12)) if inverse_time else draw.choice((100, 250.5, 900))}")
        draw.shuffle(words)
        return self._spelled(words)

    def _follow(self, code: str) -> None:
        self._plane = code if code in _PLANES else self._plane
        self._inch = code == "G20" if code in ("G20", "G21") else self._inch
        self._absolute = code == "G90" if code in ("G90", "G91") else self._absolute

    def _is_allowed(self, code: str) -> bool:
        if code in ("G20", "G21"):
            return self._changes_units
        return not (self._changes_units and code.startswith("G43"))

    def _spelled(self, words: list[str]) -> str:
        """Return the text of a block in one of the spellings that mean the same."""
        draw = self._random
        texts = []
        for word in words:
            letter, number = word[0], word[1:]
            chance = draw.random()
            if letter in "GM" and len(number) == 1 and chance < 0.3:
                number = f"0{number}"
            elif letter in "XYZIJKR@^" and chance < 0.12:
                number = f"[{number} + 0.5 - 0.5]"
            texts.append((letter.lower() if draw.random() < 0.1 else letter) + number)
        text = draw.choice((" ", " ", "")).join(texts)
        return text + (" (note)" if draw.random() < 0.05 else "")

    def _number(self, largest: float) -> str:
        size = largest / (8.0 if self._inch else 1.0)
        return f"{self._random.uniform(-size, size):.{self._random.choice((0, 1, 3, 4))}f}"

    def _length(self) -> str:
        return self._number(60.0 if self._absolute else 25.0)

    def _some_axes(self) -> tuple[int, ...]:
        return tuple(axis for axis in range(3) if self._random.random() < 0.55) or (self._random.randrange(3),)

    def _axes(self, axes: tuple[int, ...]) -> str:
        return " ".join("XYZ"[axis] + self._length() for axis in axes)

    def _line(self) -> str:
        return f"{self._random.choice(('G0', 'G1', 'G1'))} {self._axes(self._some_axes())}"

    def _polar_words(self) -> str:
        which = self._random.choice(("@", "^", "@^", "@^"))
        words = [f"@{self._length()}" if "@" in which else "", f"^{self._number(200.0)}" if "^" in which else ""]
        return " ".join(filter(None, words)) + (f" Z{self._length()}" if self._random.random() < 0.3 else "")

    def _polar(self) -> str:
        return f"{self._random.choice(('G0', 'G1', 'G1', ''))} {self._polar_words()}"

    def _words_alone(self) -> str:
        """Return axis words for the motion or the cycle that is in effect."""
        return self._axes(self._some_axes())

    def _arc(self) -> str:
        draw = self._random
        first, second, normal = _PLANES[self._plane]
        code = draw.choice(("G2", "G3"))
        rise = f" {'XYZ'[normal]}{self._length()}" if draw.random() < 0.4 else ""
        turns = f" P{draw.randint(1, 3)}" if draw.random() < 0.2 else ""
        centre = f"{'IJK'[first]}{self._number(20.0)} {'IJK'[second]}{self._number(20.0)}"
        kind = draw.choice(("circle", "half", "radius", "polar"))
        if kind == "circle":
            return f"{code} {centre}{rise}{turns}"
        if kind == "half":
            # With G91 and G91.1, the end of half a circle is twice as far as its centre.
            a, b = (round(draw.uniform(-15.0, 15.0) / (8.0 if self._inch else 1.0), 3) for _ in range(2))
            ends = f"{'XYZ'[first]}{2.0 * a:.3f} {'XYZ'[second]}{2.0 * b:.3f}"
            return f"{code} {ends} {'IJK'[first]}{a:.3f} {'IJK'[second]}{b:.3f}{rise}{turns}"
        if kind == "radius":
            ends = f"{'XYZ'[first]}{self._length()} {'XYZ'[second]}{self._length()}"
            return f"{code} {ends}{rise} R{draw.choice((300, 450.5, 800))}"
        return f"{code} {self._polar_words()} R{draw.choice((300, 450.5, 800))}"

    def _cycle(self) -> str:
        draw = self._random
        code = draw.choice(_CYCLES)
        normal = "XYZ"[_PLANES[self._plane][2]]
        places = self._polar_words().split(" Z", maxsplit=1)[0]
        if draw.random() < 0.6:
            places = self._axes(tuple(axis for axis in self._some_axes() if "XYZ"[axis] != normal))
        scale = 8.0 if self._inch else 1.0
        words = f"{code} {places} {normal}{-draw.uniform(1.0, 20.0) / scale:.3f} R{draw.uniform(0.0, 15.0) / scale:.2f}"
        if code in ("G73", "G83"):
            words += f" Q{draw.uniform(2.0, 6.0) / scale:.2f}"
        if code in ("G82", "G86", "G89"):
            words += " P0.1"
        return words + (f" L{draw.randint(1, 3)}" if draw.random() < 0.2 else "")

    def _offset(self) -> str:
        draw = self._random
        return f"G10 L{draw.choice((2, 20))} P{draw.randint(0, 3)} {self._axes(self._some_axes())}"

    def _datum(self) -> str:
        code = self._random.choice(("G92", "G92", "G92.1", "G92.2", "G92.3"))
        return f"{code} {self._axes(self._some_axes())}" if code == "G92" else code

    def _reference(self) -> str:
        code = self._random.choice(("G28", "G30"))
        return f"{code} {self._axes(self._some_axes())}" if self._random.random() < 0.8 else code

    def _machine(self) -> str:
        return f"G53 {self._random.choice(('G0', 'G1'))} {self._axes(self._some_axes())}"

    def _tool_length(self) -> str:
        if self._changes_units:
            return "G49"
        return f"G43.1 {self._axes(self._some_axes())}"
