"""Series of values from night to night, computed from the runs of one machine.

There are series of the volumetric errors, of the 21 geometric errors and of each individual parameter of the error
model.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from agent.history.schema import StoredParameter, StoredRun, utc_time
from agent.results.run_outcome import Decision
from agent.settings.history import HistorySettings
from twin.arrays import Array
from twin.machine.legendre import legendre_values
from twin.units import S_PER_DAY

BARE, ACTIVE, HELD_OUT = "ve_bare", "ve_acting", "held_out"
TITLES = {
    BARE: "VE without table",
    ACTIVE: "VCE with table",
    HELD_OUT: "rms of held-out balls",
}
_COEFFICIENT = re.compile(r"(E[XYZABC][XYZ])\[(\d+)\]")
_ORDER_NAMES = {"1": "slope", "2": "bow"}
_SAMPLES = 101
_CHANGED_MACHINE = (Decision.FULL_NEEDED.value, Decision.FULL_DONE.value)


@dataclass(frozen=True, eq=False)
class Series:
    """Series of the values that one quantity, such as a volumetric error, had in n runs of one machine.

    `nights` is the number of nights between the first run and each run, shape (n,). `values` contains the values in the
    unit `unit`, shape (n,). `sigmas` contains the standard uncertainties of the values in the same unit, shape (n,).
    `stated` is True if the standard uncertainties are known; otherwise all elements of `sigmas` are 1.

    `tolerance` is the absolute value that must not be reached, or None if there is none. `two_sided` is True if values
    may have either sign. `steps` contains the nights at which the machine or its table is known to have changed.
    """

    name: str
    title: str
    unit: str
    run_ids: tuple[str, ...]
    nights: Array
    values: Array
    sigmas: Array
    stated: bool
    tolerance: float | None
    two_sided: bool
    steps: tuple[float, ...]


def all_series(runs: Sequence[StoredRun], settings: HistorySettings) -> tuple[Series, ...]:
    """Return all series of values that are computed from the runs of one machine. Series without values are omitted.

    The runs must be sorted, with the oldest run first.
    """
    timeline = nights_of(runs)
    found = [*_volumetric(runs, timeline, settings), *_errors(runs, timeline, settings)]
    return tuple(series for series in found if len(series.values))


def nights_of(runs: Sequence[StoredRun]) -> Array:
    """Return the number of nights between the first of `runs` and each of them, shape (n_runs,).

    A run may record the number of nights since the last run whose result was accepted as reference. For such a run, the
    returned number is computed from the recorded number. For any other run, it is computed from the calendar.
    """
    nights: dict[str, float] = {}
    last = 0.0
    for count, run in enumerate(runs):
        if run.since in nights and run.nights is not None:
            last = max(nights[str(run.since)] + run.nights, last)
        elif count:
            gap = utc_time(run.started) - utc_time(runs[count - 1].started)
            last += max(gap.total_seconds(), 0.0) / S_PER_DAY
        nights[run.run_id] = last
    return np.array([nights[run.run_id] for run in runs])


@dataclass(frozen=True)
class _Point:
    night: float
    run_id: str
    value: float
    sigma: float | None


def _volumetric(runs: Sequence[StoredRun], timeline: Array, settings: HistorySettings) -> Iterable[Series]:
    """Yield three series: the volumetric error (VE) without a table, the VE with the table active at the end of each
    run, and the rms of the held-out balls with that table.
    """
    changed = _nights_where(runs, timeline, lambda run: run.night in _CHANGED_MACHINE)
    anew = _nights_where(runs, timeline, lambda run: bool(run.accepted) and run.kind == "calibrate") + changed
    readings: tuple[tuple[str, Callable[[StoredRun], tuple[float | None, float | None]], float | None], ...] = (
        (BARE, lambda run: (run.ve_before_um, run.ve_before_sigma_um), None),
        (ACTIVE, lambda run: (run.acting_um, None), settings.ve_tolerance_um),
        (
            HELD_OUT,
            lambda run: (run.held_out_after_um if run.accepted else run.held_out_before_um, None),
            settings.held_out_tolerance_um,
        ),
    )
    for name, read, tolerance in readings:
        points = [
            _Point(float(night), run.run_id, value, sigma)
            for night, run in zip(timeline, runs, strict=True)
            for value, sigma in [read(run)]
            if value is not None
        ]
        yield _series(name, TITLES[name], "µm", points, tolerance, changed if name == BARE else anew, two_sided=False)


def _errors(runs: Sequence[StoredRun], timeline: Array, settings: HistorySettings) -> Iterable[Series]:
    """Yield the series of each geometric error, then the series of each parameter. The value of a geometric error is
    its largest absolute value along the axis.
    """
    tolerances = settings.parameter_tolerances
    steps = _nights_where(runs, timeline, lambda run: run.night in _CHANGED_MACHINE)
    whole: dict[str, list[_Point]] = {}
    single: dict[str, list[_Point]] = {}
    units: dict[str, str] = {}
    for night, run in zip(timeline, runs, strict=True):
        for error, coefficients in _by_error(run.parameters).items():
            value, sigma = _largest(coefficients)
            whole.setdefault(error, []).append(_Point(float(night), run.run_id, value, sigma))
            units[error] = next(iter(coefficients.values())).unit
        for parameter in run.parameters:
            point = _Point(float(night), run.run_id, parameter.value, parameter.standard_uncertainty)
            single.setdefault(parameter.name, []).append(point)
            units[parameter.name] = parameter.unit
    for name, points in whole.items():
        yield _series(name, name, units[name], points, tolerances.get(name), steps, two_sided=False)
    for name, points in single.items():
        yield _series(name, title_of(name), units[name], points, tolerances.get(name), steps, two_sided=True)


def title_of(parameter: str) -> str:
    """Return a readable title of the parameter `name` of the error model, such as `EXX slope`, `EYX bow` or `EXX order
    4`. The order is that of the Legendre polynomial.

    A name that is not the name of a Legendre coefficient is returned unchanged.
    """
    found = _COEFFICIENT.fullmatch(parameter)
    if found is None:
        return parameter
    return f"{found[1]} {_ORDER_NAMES.get(found[2], f'order {found[2]}')}"


def _by_error(parameters: Sequence[StoredParameter]) -> Mapping[str, Mapping[int, StoredParameter]]:
    """Return the coefficients of each error motion, by the name of the error motion and then by Legendre order."""
    errors: dict[str, dict[int, StoredParameter]] = {}
    for parameter in parameters:
        found = _COEFFICIENT.fullmatch(parameter.name)
        if found is not None:
            errors.setdefault(found[1], {})[int(found[2])] = parameter
    return errors


def _largest(coefficients: Mapping[int, StoredParameter]) -> tuple[float, float]:
    """Return the largest absolute value of an error along the axis, and the standard uncertainty at that point.

    The coefficients are treated as uncorrelated because the history stores no covariances. Only the weight of a night
    depends on this standard uncertainty.
    """
    orders = list(coefficients)
    rows = legendre_values(np.linspace(-1.0, 1.0, _SAMPLES), max(orders))[orders]
    values = np.array([coefficients[order].value for order in orders])
    sigmas = np.array([coefficients[order].standard_uncertainty for order in orders])
    along = values @ rows
    place = int(np.argmax(np.abs(along)))
    return float(abs(along[place])), float(np.sqrt(np.sum((sigmas * rows[:, place]) ** 2)))


def _nights_where(
    runs: Sequence[StoredRun], timeline: Array, changed: Callable[[StoredRun], bool]
) -> tuple[float, ...]:
    return tuple(float(night) for night, run in zip(timeline, runs, strict=True) if changed(run))


def _series(
    name: str,
    title: str,
    unit: str,
    points: Sequence[_Point],
    tolerance: float | None,
    steps: Sequence[float],
    *,
    two_sided: bool,
) -> Series:
    sigmas = [point.sigma for point in points]
    stated = all(sigma is not None and sigma > 0.0 for sigma in sigmas)
    return Series(
        name=name,
        title=title,
        unit=unit,
        run_ids=tuple(point.run_id for point in points),
        nights=np.array([point.night for point in points]),
        values=np.array([point.value for point in points]),
        sigmas=np.array([sigma if stated and sigma is not None else 1.0 for sigma in sigmas]),
        stated=stated,
        tolerance=tolerance,
        two_sided=two_sided,
        steps=tuple(sorted(set(steps))),
    )
