"""Series of values from night to night, computed from the runs of one machine.

There are series of the volumetric errors, of the 21 geometric errors and of each individual parameter of the error
model.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime

import numpy as np
from numpy.typing import NDArray

from agent.history.schema import StoredRun, utc_time
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
CHANGED_MACHINE = (Decision.FULL_NEEDED.value, Decision.FULL_DONE.value)
"""Decisions of runs that found the machine itself changed."""


@dataclass(frozen=True, eq=False)
class Series:
    """Series of the values that one quantity, such as a volumetric error, had in n runs of one machine.

    `nights` is the number of nights between the first run and each run, shape (n,). `values` contains the values in the
    unit `unit`, shape (n,). `sigmas` contains the standard uncertainties of the values in the same unit, shape (n,).
    `stated` is True if the standard uncertainties are known; otherwise all elements of `sigmas` are 1.

    `tolerance` is the absolute value that must not be reached, or None if there is none. `two_sided` is True if values
    may have either sign. `steps` contains the nights at which the machine or its table is known to have changed.
    `started_s` contains the starts of the runs in seconds since 1970, shape (n,).
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
    started_s: Array

    def same_as(self, other: Series) -> bool:
        """Return True if all that a trend is made from is the same in `other`."""
        fields_of = ("name", "title", "unit", "run_ids", "stated", "tolerance", "two_sided", "steps")
        arrays = ("nights", "values", "sigmas", "started_s")
        return all(getattr(self, one) == getattr(other, one) for one in fields_of) and all(
            np.array_equal(getattr(self, one), getattr(other, one)) for one in arrays
        )

    def date(self, night: float) -> datetime:
        """Return the UTC time of a night: between two runs by interpolation, and by the calendar outside them."""
        inside = min(max(night, self.nights[0]), self.nights[-1])
        at_s = float(np.interp(inside, self.nights, self.started_s)) + S_PER_DAY * float(night - inside)
        return datetime.fromtimestamp(at_s, UTC)


def all_series(runs: Sequence[StoredRun], settings: HistorySettings) -> tuple[Series, ...]:
    """Return all series of values that are computed from the runs of one machine. Series without values are omitted.

    The runs must be sorted, with the oldest run first.
    """
    timeline = _Timeline.of(runs)
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


@dataclass(frozen=True, eq=False)
class _Timeline:
    """Identities of the runs, their `nights` (`nights_of`) and their starts in seconds since 1970, each with the shape
    (n_runs,)."""

    run_ids: tuple[str, ...]
    nights: Array
    started_s: Array

    @classmethod
    def of(cls, runs: Sequence[StoredRun]) -> _Timeline:
        started_s = np.array([utc_time(run.started).timestamp() for run in runs])
        return cls(tuple(run.run_id for run in runs), nights_of(runs), started_s)


@dataclass(frozen=True, eq=False)
class _Values:
    """Values that one quantity had in n of the runs. `runs` contains the indices of these runs, `sigmas` the standard
    uncertainties of the values, NaN where they are not known; each has the shape (n,)."""

    runs: NDArray[np.intp]
    values: Array
    sigmas: Array

    @classmethod
    def joined(cls, parts: Sequence[_Values]) -> _Values:
        """Return the values of all `parts`, in the order of the runs."""
        runs = np.concatenate([part.runs for part in parts])
        order = np.argsort(runs)
        values, sigmas = (np.concatenate([getattr(part, name) for part in parts]) for name in ("values", "sigmas"))
        return cls(runs[order], values[order], sigmas[order])


def _volumetric(runs: Sequence[StoredRun], timeline: _Timeline, settings: HistorySettings) -> Iterable[Series]:
    """Yield three series: the volumetric error (VE) without a table, the VE with the table active at the end of each
    run, and the rms of the held-out balls with that table.
    """
    changed = _nights_where(runs, timeline, lambda run: run.night in CHANGED_MACHINE)
    anew = _nights_where(runs, timeline, lambda run: bool(run.accepted) and run.kind == "calibrate") + changed
    readings: tuple[tuple[str, Callable[[StoredRun], tuple[float | None, float | None]], float | None], ...] = (
        (BARE, lambda run: (run.ve_before_um, run.ve_before_sigma_um), settings.ve_bare_tolerance_um),
        (ACTIVE, lambda run: (run.acting_um, None), settings.ve_tolerance_um),
        (
            HELD_OUT,
            lambda run: (run.held_out_after_um if run.accepted else run.held_out_before_um, None),
            settings.held_out_tolerance_um,
        ),
    )
    for name, read, tolerance in readings:
        found = [(place, *read(run)) for place, run in enumerate(runs)]
        known = np.array([one for one in found if one[1] is not None], dtype=np.float64).reshape(-1, 3)  # None is NaN
        values = _Values(known[:, 0].astype(np.intp), known[:, 1], known[:, 2])
        steps = changed if name == BARE else anew
        yield _series(name, TITLES[name], "µm", values, timeline, tolerance, steps, two_sided=False)


def _errors(runs: Sequence[StoredRun], timeline: _Timeline, settings: HistorySettings) -> Iterable[Series]:
    """Yield the series of each geometric error, then the series of each parameter. The value of a geometric error is
    its largest absolute value along the axis.
    """
    tolerances = settings.parameter_tolerances
    steps = _nights_where(runs, timeline, lambda run: run.night in CHANGED_MACHINE)
    whole: dict[str, list[_Values]] = {}
    single: dict[str, list[_Values]] = {}
    units: dict[str, str] = {}
    for names, places in _runs_by_parameters(runs).items():
        units |= {one.name: one.unit for one in runs[places[0]].parameters}
        values = np.stack([runs[place].parameter_arrays.values for place in places])
        sigmas = np.stack([runs[place].parameter_arrays.sigmas for place in places])
        for error, columns in _by_error(names).items():
            chosen = list(columns.values())
            largest = _largest(list(columns), values[:, chosen], sigmas[:, chosen])
            whole.setdefault(error, []).append(_Values(places, *largest))
            units[error] = units[names[chosen[0]]]
        for column, name in enumerate(names):
            single.setdefault(name, []).append(_Values(places, values[:, column], sigmas[:, column]))
    for found, two_sided in ((whole, False), (single, True)):
        for name, parts in found.items():
            joined, tolerance = _Values.joined(parts), tolerances.get(name)
            title = title_of(name)
            yield _series(name, title, units[name], joined, timeline, tolerance, steps, two_sided=two_sided)


def _runs_by_parameters(runs: Sequence[StoredRun]) -> Mapping[tuple[str, ...], NDArray[np.intp]]:
    """Return the indices of the runs that have the same parameters, by the names of these parameters."""
    found: dict[tuple[str, ...], list[int]] = {}
    for place, run in enumerate(runs):
        if run.parameters:
            found.setdefault(run.parameter_arrays.names, []).append(place)
    return {names: np.array(places) for names, places in found.items()}


def title_of(parameter: str) -> str:
    """Return a readable title of the parameter `name` of the error model, such as `EXX slope`, `EYX bow` or `EXX order
    4`. The order is that of the Legendre polynomial.

    A name that is not the name of a Legendre coefficient is returned unchanged.
    """
    found = _COEFFICIENT.fullmatch(parameter)
    if found is None:
        return parameter
    return f"{found[1]} {_ORDER_NAMES.get(found[2], f'order {found[2]}')}"


def _by_error(names: Sequence[str]) -> Mapping[str, Mapping[int, int]]:
    """Return the places of the coefficients of each error motion among the parameters with these `names`, by the name
    of the error motion and then by Legendre order."""
    errors: dict[str, dict[int, int]] = {}
    for place, name in enumerate(names):
        found = _COEFFICIENT.fullmatch(name)
        if found is not None:
            errors.setdefault(found[1], {})[int(found[2])] = place
    return errors


def _largest(orders: Sequence[int], values: Array, sigmas: Array) -> tuple[Array, Array]:
    """Return the largest absolute value of an error along the axis in each of n runs, and the standard uncertainty at
    that point, each with the shape (n,). `values` and `sigmas`, shape (n, n_orders), are those of the coefficients.

    The coefficients are treated as uncorrelated because the history stores no covariances. Only the weight of a night
    depends on this standard uncertainty.
    """
    rows = legendre_values(np.linspace(-1.0, 1.0, _SAMPLES), max(orders))[list(orders)]
    along = np.abs(values @ rows)
    place = np.argmax(along, axis=1)
    sigma = np.sqrt(np.sum((sigmas * rows[:, place].T) ** 2, axis=1))
    return along[np.arange(len(along)), place], sigma


def _nights_where(
    runs: Sequence[StoredRun], timeline: _Timeline, changed: Callable[[StoredRun], bool]
) -> tuple[float, ...]:
    return tuple(float(night) for night, run in zip(timeline.nights, runs, strict=True) if changed(run))


def _series(
    name: str,
    title: str,
    unit: str,
    values: _Values,
    timeline: _Timeline,
    tolerance: float | None,
    steps: Sequence[float],
    *,
    two_sided: bool,
) -> Series:
    stated = bool((values.sigmas > 0.0).all())  # NaN, which stands for a value without uncertainty, is not above zero
    return Series(
        name=name,
        title=title,
        unit=unit,
        run_ids=tuple(timeline.run_ids[place] for place in values.runs.tolist()),
        nights=timeline.nights[values.runs],
        values=values.values,
        sigmas=values.sigmas if stated else np.ones_like(values.values),
        stated=stated,
        tolerance=tolerance,
        two_sided=two_sided,
        steps=tuple(sorted(set(steps))),
        started_s=timeline.started_s[values.runs],
    )
