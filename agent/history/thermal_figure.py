"""Figure of a drift that temperature sensors explain: measured errors with the explained part and its band, the
temperatures, and the effect of each sensor."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, MaxNLocator

from agent.figures.style import BAND_OPACITY, BLUE, ORANGE, PURPLE, QUIET, Picture, headed, picture
from agent.history.series import title_of

if TYPE_CHECKING:
    from agent.history.sensor_drift import SensorDrift

COVERAGE = 2.0
_ERRORS = 2
_HEADROOM = 0.12  # for the legend, relative to the height of the panel
_COLOURS = (BLUE, ORANGE, PURPLE, QUIET)
_SIZE_IN = (9.5, 6.4)


def draw_thermal(drift: SensorDrift, heading: str) -> Picture:
    """Return a figure of the drift, under the heading that names the machine."""
    return picture("thermal", headed(lambda figure: _panels(figure, drift), heading), _SIZE_IN)


def _panels(figure: Figure, drift: SensorDrift) -> None:
    panels = np.atleast_2d(figure.subplots(2, 2))
    errors = drift.moved_errors or tuple(np.argsort(_changes(drift))[::-1].tolist())
    for panel, place in zip(panels[0], errors[:_ERRORS], strict=False):
        _error(panel, drift, place)
    _temperatures(panels[1, 0], drift)
    _effects(panels[1, 1], drift)
    for panel in (*panels[0], panels[1, 0]):
        panel.xaxis.set_major_locator(MaxNLocator(nbins=4))
        panel.xaxis.set_major_formatter(FuncFormatter(lambda day, _: f"{drift.date(day):%Y-%m-%d}"))


def _changes(drift: SensorDrift) -> np.ndarray:
    """Return how much each parameter changed, in units of the error field; for a drift that nothing explains."""
    values = np.array([drift.history.nights[at].parameters for at in drift.found.nights.tolist()])
    return np.asarray(np.std(values, axis=0) * np.sqrt(np.diag(drift.form)))


def _error(panel: Axes, drift: SensorDrift, place: int) -> None:
    """Draw one parameter about its mean: measured, and the part that the temperatures explain."""
    unit, factor = drift.unit(place)
    nights = [drift.history.nights[at] for at in drift.found.nights.tolist()]
    values = factor * np.array([one.parameters[place] for one in nights])
    sigmas = factor * np.sqrt([one.covariance[place, place] for one in nights])
    explained, doubt = factor * drift.found.explained[:, place], factor * drift.found.explained_sigma[:, place]
    days, away = drift.days, values - values.mean()
    panel.errorbar(
        days, away, yerr=COVERAGE * sigmas, fmt="o", color=BLUE, markersize=3, elinewidth=0.6, label="measured (95 %)"
    )
    if drift.found.taken:
        middle = explained - explained.mean()
        panel.plot(days, middle, color=ORANGE, linewidth=1.4, label="explained (95 %)")
        low, high = middle - COVERAGE * doubt, middle + COVERAGE * doubt
        panel.fill_between(days, low, high, color=ORANGE, alpha=BAND_OPACITY, linewidth=0)
        panel.plot(days, away - middle, color=QUIET, linewidth=0.9, linestyle=":", label="not explained")
    panel.set_title(f"{title_of(drift.history.reference.model.names[place])}, change", loc="left")
    panel.set_ylabel(unit)
    _legend(panel)


def _temperatures(panel: Axes, drift: SensorDrift) -> None:
    days, readings = drift.days, drift.found.fit.drift.temperatures_c
    for place, name in enumerate(drift.found.sensors):
        taken = place in drift.found.fit.taken
        style, label = ("-", name) if taken else ("--", f"{name} (left out)")
        panel.plot(days, readings[:, place], style, color=_COLOURS[place], linewidth=1.2, label=label)
    panel.set_title("temperatures", loc="left")
    panel.set_ylabel("°C")
    _legend(panel)


def _effects(panel: Axes, drift: SensorDrift) -> None:
    """Draw the change of the most moved errors per K of each sensor taken."""
    panel.set_title("change per kelvin (95 %)", loc="left")
    taken = drift.found.fit.taken
    if not taken:
        panel.set_axis_off()
        panel.text(0.5, 0.5, "no sensor explains the drift", ha="center", va="center", transform=panel.transAxes)
        return
    mean, sigma = drift.found.coefficients
    places = drift.moved_errors
    rows = np.arange(len(places), dtype=np.float64)
    for number, sensor in enumerate(taken):
        factors = np.array([drift.unit(place)[1] for place in places])
        shift = 0.8 * ((number + 0.5) / len(taken) - 0.5)
        panel.errorbar(
            factors * mean[list(places), sensor],
            rows + shift,
            xerr=COVERAGE * factors * sigma[list(places), sensor],
            fmt="o",
            color=_COLOURS[sensor],
            markersize=4,
            elinewidth=1.0,
            label=drift.found.sensors[sensor],
        )
    panel.axvline(0.0, color=QUIET, linewidth=0.7)
    panel.set_yticks(rows, [title_of(drift.history.reference.model.names[place]) for place in places])
    panel.invert_yaxis()
    panel.set_xlabel("µm/K, µrad/K")
    panel.set_ylim(top=-1.2)
    panel.legend(fontsize="x-small", loc="upper right", frameon=False, ncols=4)


def _legend(panel: Axes) -> None:
    """Draw the legend in one row above the curves."""
    low, high = panel.get_ylim()
    panel.set_ylim(low, high + _HEADROOM * (high - low))
    panel.legend(fontsize="x-small", loc="upper left", frameon=False, ncols=4)
