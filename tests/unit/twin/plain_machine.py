"""Machine as a plain loop over points with 4x4 matrices, written from the documentation only."""

import math

import numpy as np

AXES = "XYZ"


def shift(x, y, z):
    matrix = np.eye(4)
    matrix[:3, 3] = x, y, z
    return matrix


def turn(axis, angle):
    i, j = {"X": (1, 2), "Y": (2, 0), "Z": (0, 1)}[axis]
    matrix = np.eye(4)
    matrix[i, i] = matrix[j, j] = math.cos(angle)
    matrix[i, j], matrix[j, i] = -math.sin(angle), math.sin(angle)
    return matrix


def series(parameters, error, argument):
    total, before, now, order = 0.0, 0.0, 1.0, 0
    while order < 16:
        total += parameters.get(f"{error}[{order}]", 0.0) * now
        before, now = now, ((2 * order + 1) * argument * now - order * before) / (order + 1)
        order += 1
    return total


def axis_matrix(axis, position, ranges, parameters, workpiece_side):
    low, high = ranges[AXES.index(axis)]
    argument = 2.0 * (position["XYZ".index(axis)] - low) / (high - low) - 1.0
    error = {letter: series(parameters, f"E{letter}{axis}", argument) for letter in "XYZABC"}
    if axis == "Z":
        v = (position[1] - ranges[1][0]) / (ranges[1][1] - ranges[1][0])
        w = (position[2] - low) / (high - low)
        b0, b1, b2, c0, c1 = (parameters.get(f"CROSS[{t}]", 0.0) for t in ("b0", "b1", "b2", "c0", "c1"))
        error["Y"] += (b0 + b1 * w + b2 * w * w) * v
        error["A"] += (c0 + c1 * w) * v
    square = {
        "X": np.eye(4),
        "Y": turn("Z", parameters.get("C0Y", 0.0)),
        "Z": turn("Y", parameters.get("B0Z", 0.0)) @ turn("X", parameters.get("A0Z", 0.0)),
    }[axis]
    unit = [1.0 if letter == axis else 0.0 for letter in AXES]
    along = square[:3, :3] @ unit
    travel = shift(*((position["XYZ".index(axis)] - low) * along))
    moved = shift(error["X"], error["Y"], error["Z"])
    turned = turn("Z", error["C"]) @ turn("Y", error["B"]) @ turn("X", error["A"])
    return moved @ turned @ travel if workpiece_side else travel @ moved @ turned


def deviations(chain_text, ranges, points, tool, parameters):
    """Return the deviations of a machine; `parameters` by name, the chain as text from tool to workpiece."""
    links = chain_text.split("-")[1:-1]
    bed = links.index("bed")
    result = []
    for point in points:
        matrix = np.eye(4)
        for place in range(len(links) - 1, -1, -1):
            if place != bed:
                matrix = matrix @ axis_matrix(links[place], point, ranges, parameters, place > bed)
        travelled = np.array(point) - [low for low, _ in ranges]
        result.append((matrix @ [*tool, 1.0])[:3] - travelled - np.array(tool))
    return np.array(result)
