"""Controllers' reading rules for their files, written from their documents in plain loops, independent of the writers.

Every reader takes the files by name and returns a function from axis positions (n, 3) to the correction that the
controller adds to them (n, 3), in mm. The documents are named in docs/reference/formats.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Mapping

import numpy as np

Files = Mapping[str, str]
Rule = Callable[[np.ndarray], np.ndarray]
Place = tuple[float, float, float]


def straight_line(position: float, nodes: list[float], values: list[float]) -> float:
    """Interpolate linearly between neighbours; the end value beyond an end."""
    if position <= nodes[0]:
        return values[0]
    for left in range(len(nodes) - 1):
        if position <= nodes[left + 1]:
            share = (position - nodes[left]) / (nodes[left + 1] - nodes[left])
            return values[left] + share * (values[left + 1] - values[left])
    return values[-1]


def linuxcnc(files: Files) -> Rule:
    """Apply usrmotLoadComp: rows of three numbers until one is not; trim = nominal - forward; motor = joint + trim."""
    joints = []
    for section in re.findall(r"\[JOINT_\d\]\n(.*)\n(.*)\n", files["ini-lines.txt"]):
        settings = dict(line.split(" = ") for line in section)
        assert settings["COMP_FILE_TYPE"] == "0"
        nominals: list[float] = []
        trims: list[float] = []
        for line in files[settings["COMP_FILE"]].split("\n"):
            try:
                nominal, forward, reverse = (float(word) for word in line.split())
            except ValueError:
                break
            assert forward == reverse
            assert not nominals or nominal > nominals[-1]
            if len(nominals) < 256:
                nominals.append(nominal)
                trims.append(nominal - forward)
        joints.append((nominals, trims))
    return lambda points: np.array(
        [[straight_line(p, *joint) for p, joint in zip(row, joints, strict=True)] for row in points]
    )


def matrixkins(files: Files) -> Rule:
    """Apply kinematicsInverse of matrixkins.comp: j[0] = x C_xx + y C_xy + z C_xz, and so on."""
    told = dict(line.removeprefix("setp matrixkins.").split() for line in files["matrixkins.hal"].splitlines())
    assert len(told) == 9

    def rule(points: np.ndarray) -> np.ndarray:
        moved = np.zeros_like(points)
        for n, row in enumerate(points):
            for joint, name in enumerate("xyz"):
                for axis, letter in enumerate("xyz"):
                    moved[n, joint] += row[axis] * float(told[f"C_{name}{letter}"])
        return moved - points

    return rule


def klipper_skew(files: Files) -> Rule:
    """Apply calc_skew of skew_correction.py with the factors of the profile; SET_SKEW must give the same ones."""
    told = dict(re.findall(r"(\w\w)_skew = (\S+)", files["skew-profile.cfg"]))
    xy, xz, yz = (float(told[plane]) for plane in ("xy", "xz", "yz"))
    for plane, lengths in re.findall(r"(XY|XZ|YZ)=(\S+)", files["set-skew.gcode"]):
        ac, bd, ad = (float(length) for length in lengths.split(","))
        side = math.sqrt(2.0 * ac * ac + 2.0 * bd * bd - 4.0 * ad * ad) / 2.0
        factor = math.tan(math.pi / 2.0 - math.acos((ac * ac - side * side - ad * ad) / (2.0 * side * ad)))
        assert abs(factor - float(told[plane.lower()])) < 1e-9

    def rule(points: np.ndarray) -> np.ndarray:
        x, y, z = points.T
        skewed = np.column_stack([x - y * xy - z * (xz - xy * yz), y - z * yz, z])
        return skewed - points

    return rule


def siemens_lec(files: Files, names: tuple[str, str, str] = ("X1", "Y1", "Z1")) -> Rule:
    """Apply K3 4.4.2: a positive value makes the machine axis move in the negative direction."""
    axes = []
    for name in names:
        lines = [line for line in files[f"{name}_EEC.INI"].splitlines() if not line.startswith(";")]
        assert lines[0] == f"%_N_{name}_EEC_INI"
        assert lines[1] == "CHANDATA(1)"
        assert lines[-1] == "M17"
        told = dict(line.split("=") for line in lines[2:-1])
        low, high, step = (float(told[f"$AA_ENC_COMP_{word}[0,{name}]"]) for word in ("MIN", "MAX", "STEP"))
        last = (high - low) / step
        assert abs(last - round(last)) < 1e-6
        assert told[f"$AA_ENC_COMP_IS_MODULO[0,{name}]"] == "0"
        values = [float(told[f"$AA_ENC_COMP[0,{place},{name}]"]) for place in range(round(last) + 1)]
        assert len(told) == len(values) + 4
        axes.append(([low + place * step for place in range(len(values))], values))
    return lambda points: (
        -np.array([[straight_line(p, *axis) for p, axis in zip(row, axes, strict=True)] for row in points])
    )


def siemens_cec(
    files: Files, names: tuple[str, str, str] = ("X1", "Y1", "Z1"), *, product_replaces: bool = False
) -> Rule:
    """Apply K3 4.4.3: the values of all tables of an output axis are added.

    A table with MULT_BY_TABLE gives the product with the table of that number (index + 1), in addition to its own value
    or, if `product_replaces`, instead of it; SD41300 selects the tables that are evaluated; the axis moves against the
    value.
    """
    lines = [line.split(" ;")[0] for line in files["NC_CEC.INI"].splitlines() if not line.startswith(";")]
    assert lines[:2] == ["%_N_NC_CEC_INI", "CHANDATA(1)"]
    assert lines[-1] == "M17"
    told = dict(line.split("=") for line in lines[2:-1])
    enabling = [line.split(" ;")[0] for line in files["CEC_ENABLE.SPF"].splitlines() if line.startswith("$")]
    enabled = {int(line.split("[")[1].split("]")[0]) for line in enabling if line.endswith("=1")}
    tables = {}
    for index in sorted({int(key.split("[")[1].rstrip("]")) for key in told if key.startswith("$AN_CEC_MIN")}):
        low, high, step = (float(told[f"$AN_CEC_{word}[{index}]"]) for word in ("MIN", "MAX", "STEP"))
        last = (high - low) / step
        assert abs(last - round(last)) < 1e-6
        assert told[f"$AN_CEC_DIRECTION[{index}]"] == told[f"$AN_CEC_IS_MODULO[{index}]"] == "0"
        values = [float(told[f"$AN_CEC[{index},{place}]"]) for place in range(round(last) + 1)]
        nodes = [low + place * step for place in range(len(values))]
        source, output = (
            names.index(told[f"$AN_CEC_{word}_AXIS[{index}]"].strip("()")) for word in ("INPUT", "OUTPUT")
        )
        tables[index] = (source, output, nodes, values, int(told[f"$AN_CEC_MULT_BY_TABLE[{index}]"]))

    def value(index: int, row: np.ndarray) -> float:
        source, _, nodes, values, _ = tables[index]
        return straight_line(row[source], nodes, values)

    def rule(points: np.ndarray) -> np.ndarray:
        total = np.zeros_like(points)
        for n, row in enumerate(points):
            for index, (_, output, _, _, multiplier) in tables.items():
                if index in enabled:
                    own = value(index, row)
                    product = own * value(multiplier - 1, row) if multiplier else 0.0
                    total[n, output] += product + (0.0 if multiplier and product_replaces else own)
        return -total

    return rule


def heidenhain(files: Files, names: str = "XYZ") -> Rule:
    """Apply [axis in the column of *.COM] = F(axis in whose column of *.CMA the file is listed).

    The active line counts, and the control moves against the entered error.
    """
    header, *rows = table_rows(files["CONFIG.CMA"])
    active = [row for row in rows if row["ACTIVE"] == "*"]
    assert len(active) == 1
    assert header == ["NR", "ACTIVE", *names]
    relations = []
    for source, name in enumerate(names):
        com_header, *com = table_rows(files[active[0][name] + ".COM"])
        assert com_header == ["NR", "AXISPOS", "BACKLASH", *names]
        assert len(com) <= 256
        nodes = [float(row["AXISPOS"]) for row in com]
        for output, column in enumerate(names):
            relations.append((source, output, nodes, [float(row[column]) for row in com]))

    def rule(points: np.ndarray) -> np.ndarray:
        total = np.zeros_like(points)
        for n, row in enumerate(points):
            for source, output, nodes, values in relations:
                total[n, output] -= straight_line(row[source], nodes, values)
        return total

    return rule


def table_rows(text: str) -> list:
    """Return the header, then rows by column name; columns begin where their names begin."""
    lines = text.splitlines()
    assert lines[0].startswith("BEGIN ")
    assert lines[0].endswith(" MM")
    assert lines[-1] == "[END]"
    starts = [match.start() for match in re.finditer(r"\S+", lines[1])]
    names = lines[1].split()
    ends = [*starts[1:], None]
    rows = [{name: line[a:b].strip() for name, a, b in zip(names, starts, ends, strict=True)} for line in lines[2:-1]]
    return [names, *rows]


def fanuc_pitch(files: Files, reference_mm: Place = (0.0, 0.0, 0.0)) -> Rule:
    """Apply B-63980EN 3620 ... 3624: number n belongs to the interval that ends (n - reference) intervals from the
    reference.

    Positions are counted from the reference point. In the positive direction the value of the interval is added, in the
    negative direction subtracted; it is output in the middle of the interval.
    """
    told = {}
    for line in files["parameters.txt"].split("\n")[1:-2]:
        parameter = re.fullmatch(r"N(\d+)Q1(A.*)", line)
        assert parameter is not None, line
        number, rest = parameter.groups()
        told[int(number)] = {int(axis): int(value) for axis, value in re.findall(r"A(\d)P(-?\d+)", rest)}
    data = {int(n) - 10000: int(v) for n, v in re.findall(r"N(\d+)Q0P(-?\d+)", files["pitch-error.txt"])}
    assert all(abs(value) <= 7 for value in data.values())

    def amount(axis: int, position: float) -> float:
        reference, low, high, magnification, interval = (told[number][axis] for number in range(3620, 3625))
        interval_mm, total = interval * 1e-3, 0
        for number in range(low, high + 1):
            middle = (number - reference - 0.5) * interval_mm
            if middle > 0.0 and position >= middle:
                total += data[number]
            if middle < 0.0 and position < middle:
                total -= data[number]
        return total * magnification * 1e-3

    def rule(points: np.ndarray) -> np.ndarray:
        return np.array([[amount(axis + 1, row[axis]) for axis in range(3)] for row in points - np.array(reference_mm)])

    return rule


def fanuc_3d(files: Files, reference_mm: Place = (0.0, 0.0, 0.0)) -> Rule:
    """Apply A-79351E: interpolate from the eight corners of the cell; the points are numbered X first."""
    told = {int(n): int(v) for n, v in re.findall(r"N(\d+)Q1L1P(-?\d+)", files["parameters.txt"])}
    counts = [told[10803 + axis] for axis in range(3)]
    references = [told[10806 + axis] for axis in range(3)]
    magnification = [told[10809 + axis] for axis in range(3)]
    intervals = [told[10812 + axis] * 1e-3 for axis in range(3)]
    assert max(counts) <= 25
    values = {}
    for line in files["points.csv"].splitlines()[1:]:
        number, *_, x, y, z = line.split(",")
        values[int(number)] = np.array([int(x), int(y), int(z)]) * magnification * 1e-3
    assert sorted(values) == list(range(1, math.prod(counts) + 1))

    def at(i: int, j: int, k: int) -> np.ndarray:
        return values[1 + i + counts[0] * (j + counts[1] * k)]

    def rule(points: np.ndarray) -> np.ndarray:
        from_first = (points - np.array(reference_mm)) / intervals + np.array(references) - 1
        return np.array([eight_corners(row, counts, at) for row in from_first])

    return rule


def eight_corners(cells: np.ndarray, counts: list[int], at: Callable[[int, int, int], np.ndarray]) -> np.ndarray:
    """Interpolate from the eight corners; `cells`: position in steps from the first point."""
    inside = [min(max(value, 0.0), count - 1.0) for value, count in zip(cells, counts, strict=True)]
    low = [min(int(value), count - 2) for value, count in zip(inside, counts, strict=True)]
    x, y, z = (value - start for value, start in zip(inside, low, strict=True))
    i, j, k = low
    return (
        at(i, j, k) * (1 - x) * (1 - y) * (1 - z)
        + at(i + 1, j, k) * x * (1 - y) * (1 - z)
        + at(i, j + 1, k) * (1 - x) * y * (1 - z)
        + at(i, j, k + 1) * (1 - x) * (1 - y) * z
        + at(i + 1, j + 1, k) * x * y * (1 - z)
        + at(i + 1, j, k + 1) * x * (1 - y) * z
        + at(i, j + 1, k + 1) * (1 - x) * y * z
        + at(i + 1, j + 1, k + 1) * x * y * z
    )


def neutral(files: Files) -> Rule:
    """Add the node values to the command there, and interpolate from the eight corners of the cell in between."""
    name = "table.csv" if "table.csv" in files else "compensation.csv"
    lines = [line.split(",") for line in files[name].splitlines()]
    assert lines[0][:6] == ["x_mm", "y_mm", "z_mm", "dx_um", "dy_um", "dz_um"]
    if name == "table.csv":
        assert json.loads(files["table.json"])["meaning"] == "added to the commanded axis position"
    rows = np.array([[float(cell) for cell in line[:6]] for line in lines[1:]])
    nodes = [sorted(set(rows[:, axis])) for axis in range(3)]
    counts = [len(line) for line in nodes]
    values = dict(zip(map(tuple, rows[:, :3]), rows[:, 3:] * 1e-3, strict=True))

    def at(i: int, j: int, k: int) -> np.ndarray:
        return values[nodes[0][i], nodes[1][j], nodes[2][k]]

    def rule(points: np.ndarray) -> np.ndarray:
        cells = [[straight_line(row[a], nodes[a], list(range(counts[a]))) for a in range(3)] for row in points]
        return np.array([eight_corners(np.array(row), counts, at) for row in cells])

    return rule


def isg(files: Files) -> Rule:
    """Apply TF5280: blocks between `#`, header with arguments and parameters, linear on the grid.

    The correction is minus the difference of the tool points of the chain with and without errors.
    """
    listed = dict(line.split() for line in files["volcomp.lis"].splitlines() if not line.startswith("#"))
    blocks = [read_block(block) for block in files["volcomp.csv"].split("\n#\n")]
    constants = dict(zip(blocks[0][0], blocks[0][1][0], strict=True))
    assert constants["A0Z"] == constants["B0Z"] == constants["C0Y"] == 0.0
    tool = np.array([constants["P0X"], constants["P0Y"], constants["P0Z"]])
    parameters = {}
    for header, rows in blocks[1:]:
        arguments = [name for name in header if name in ("X", "Y", "Z")]
        for column, name in enumerate(header[len(arguments) :], start=len(arguments)):
            parameters[name] = (
                arguments,
                lookup([row[: len(arguments)] for row in rows], [row[column] for row in rows]),
            )

    def error(name: str, row: np.ndarray) -> float:
        if name not in parameters:
            return 0.0
        arguments, value = parameters[name]
        return value([row["XYZ".index(letter)] for letter in arguments])

    def tool_point(row: np.ndarray, with_errors: bool) -> np.ndarray:
        """Return the tool point, from the workpiece to the tool; the first axes of the chain carry the workpiece."""
        matrix = np.eye(4)
        for place, axis in enumerate(listed["chain"]):
            six = [error(f"E{letter}{axis}", row) if with_errors else 0.0 for letter in "XYZABC"]
            moved = np.eye(4)
            moved["XYZ".index(axis), 3] = row["XYZ".index(axis)]
            wrong = np.eye(4)
            wrong[:3, 3] = six[:3]
            wrong[:3, :3] = small_turn(*six[3:])
            matrix = matrix @ (wrong @ moved if place < int(listed["workpiece_axes"]) else moved @ wrong)
        return (matrix @ [*tool, 1.0])[:3]

    return lambda points: np.array([tool_point(row, False) - tool_point(row, True) for row in points])


def read_block(text: str) -> tuple[list[str], list[list[float]]]:
    lines = [line for line in text.splitlines() if line and not line.startswith("//")]
    return lines[0].split(), [[float(word) for word in line.split()] for line in lines[1:]]


def lookup(arguments: list[list[float]], values: list[float]) -> Callable[[list[float]], float]:
    """Interpolate linearly in one argument, or bilinearly in two."""
    if len(arguments[0]) == 1:
        nodes = [row[0] for row in arguments]
        return lambda asked: straight_line(asked[0], nodes, values)
    firsts = sorted({row[0] for row in arguments})
    seconds = sorted({row[1] for row in arguments})
    by_place = {tuple(row): value for row, value in zip(arguments, values, strict=True)}

    def bilinear(asked: list[float]) -> float:
        along = [straight_line(asked[1], seconds, [by_place[f, s] for s in seconds]) for f in firsts]
        return straight_line(asked[0], firsts, along)

    return bilinear


def small_turn(a: float, b: float, c: float) -> np.ndarray:
    """Rotate about X, Y, Z, right-handed, to first order."""
    return np.array([[1.0, -c, b], [c, 1.0, -a], [-b, a, 1.0]])


def rule_at(name: str, files: Files, reference_mm: Place) -> Rule:
    """Return the rule of a format; the rules of Fanuc count positions from the reference point."""
    counted = {"fanuc-pitch": fanuc_pitch, "fanuc-3d": fanuc_3d}
    return counted[name](files, reference_mm) if name in counted else RULES[name](files)


RULES: dict[str, Callable[[Files], Rule]] = {
    "linuxcnc-comp": linuxcnc,
    "linuxcnc-matrixkins": matrixkins,
    "klipper-skew": klipper_skew,
    "siemens-lec": siemens_lec,
    "siemens-cec": siemens_cec,
    "isg-volcomp": isg,
    "fanuc-pitch": fanuc_pitch,
    "fanuc-3d": fanuc_3d,
    "heidenhain-com": heidenhain,
    "gcode-csv": neutral,
    "neutral": neutral,
}
