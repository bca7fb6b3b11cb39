"""True figures of acceptance tests, from the displaced points of their lines and circles by fits of numpy alone."""

from __future__ import annotations

import numpy as np

from campaigns.features.true_features import Field
from twin.workpiece.acceptance import SLOPE_LENGTH_MM, AcceptanceTest

_AXES = {"X": 0, "Y": 1, "Z": 2}


def true_figure_mm(test: AcceptanceTest, field: Field) -> float:
    """Return the true figure of a test in mm in a field of displacements."""
    points = test.feature.points
    moved = field(points)
    match test.standard, test.feature.name.split():
        case "ISO 230-2", ("M", axis):
            return float(np.ptp(moved[:, _AXES[axis]]))
        case "ISO 230-1", ("squareness", second, "to", first):
            along, across = _AXES[first], _AXES[second]
            line = np.arange(len(points)) < int(np.argmax(points[:, across] != points[0, across]))
            slopes = [
                np.polyfit(points[chosen, one], moved[chosen, other], 1)[0]
                for chosen, one, other in ((line, along, across), (~line, across, along))
            ]
            return -float(sum(slopes)) * SLOPE_LENGTH_MM
        case "ISO 230-1", (error,):
            across, along = _AXES[error[1]], _AXES[error[2]]
            fitted = np.polyfit(points[:, along], moved[:, across], 1)
            return float(np.ptp(moved[:, across] - np.polyval(fitted, points[:, along])))
        case "ISO 230-4", ("G", plane, _):
            x, y = (points + moved - points.mean(axis=0))[:, [_AXES[name] for name in plane]].T
            # Kåsa: x² + y² = 2 a x + 2 b y + c
            a, b, _ = np.linalg.lstsq(np.stack((2.0 * x, 2.0 * y, np.ones_like(x)), axis=1), x**2 + y**2, rcond=None)[0]
            return float(np.ptp(np.hypot(x - a, y - b)))
        case "ISO 230-6", ("diagonal", _):
            lengths = np.linalg.norm(points + moved - points[0] - moved[0], axis=1)
            return float(np.ptp(lengths - np.linalg.norm(points - points[0], axis=1)))
    raise ValueError(f"no true figure is known for {test.feature.name}")
