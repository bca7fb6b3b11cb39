"""Error field of earlier versions of the software, which measured lever arms from the zeros of the axes.

The field is written down anew, point by point with the Legendre series of numpy, and to first order.
"""

from __future__ import annotations

import numpy as np

from twin.machine.error_model import DIRECTIONS, ErrorModel, series_orders


def former_deviation(
    model: ErrorModel, axis_positions: np.ndarray, tool_offset: np.ndarray, parameters: np.ndarray
) -> np.ndarray:
    """Return the deviations (n, 3) in mm at axis positions (n, 3)."""
    return np.array([_at(model, point, tool_offset, parameters) for point in axis_positions])


def former_basis(model: ErrorModel, axis_positions: np.ndarray, tool_offset: np.ndarray) -> np.ndarray:
    """Return the derivative (n, 3, p) of the deviations with respect to the parameters."""
    columns = [former_deviation(model, axis_positions, tool_offset, unit) for unit in np.eye(model.size)]
    return np.stack(columns, axis=2)


def _at(model: ErrorModel, point: np.ndarray, tool_offset: np.ndarray, parameters: np.ndarray) -> np.ndarray:
    values = dict(zip(model.names, parameters, strict=True))
    low, high = np.array(model.ranges_mm).T
    share = (point - low) / (high - low)
    v, w = share[1], share[2]
    _, y, z = point
    arm, total = tool_offset.astype(float), np.zeros(3)
    for letter in model.chain.axes:
        axis = "XYZ".index(letter)
        motion = np.zeros(6)
        for row, direction in enumerate(DIRECTIONS):
            error = f"E{direction}{letter}"
            orders = series_orders(error, model.orders[error])
            series = np.zeros(orders.stop)
            series[orders.start :] = [values[f"{error}[{k}]"] for k in orders]
            motion[row] = np.polynomial.legendre.legval(2.0 * share[axis] - 1.0, series)
        if letter == "Z":
            term = {name: values.get(f"CROSS[{name}]", 0.0) for name in ("b0", "b1", "b2", "c0", "c1")}
            motion[1] += (term["b0"] + term["b1"] * w + term["b2"] * w**2) * v
            motion[3] += (term["c0"] + term["c1"] * w) * v
        carried = arm.copy()
        arm = arm + np.eye(3)[axis] * point[axis]
        total += motion[:3] + np.cross(motion[3:], carried if letter in model.chain.tool_side else arm)
    return total + np.array([values["B0Z"] * z - values["C0Y"] * y, -values["A0Z"] * z, 0.0])
