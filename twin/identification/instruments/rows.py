"""Readings of instruments as linear equations in the unknowns z that all positions of the artefact share."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from twin.arrays import Array
from twin.errors import DataError
from twin.identification.instruments.readings import InstrumentReadings, set_up_space, shared_errors
from twin.identification.normal import DirectInformation
from twin.identification.scales import Scales
from twin.identification.unknowns import Unknowns
from twin.machine.deviation_basis import deviation_basis
from twin.machine.error_model import ErrorModel

_ORDERS_UNRESOLVED = 4  # above the order of the model: middle of the waves that the modes of the misfit leave out


def reading_rows(readings: InstrumentReadings, unknowns: Unknowns) -> Array:
    """Return the derivatives (m, P) of the m readings, in mm or rad, with respect to the P unknowns z.

    Raises DataError if a value of an earlier report is no parameter of the model.
    """
    rows = np.zeros((readings.size, unknowns.blocks.size))
    if readings.parameters:
        for row, name in enumerate(readings.parameters):
            rows[row, _parameter(readings, unknowns.model, row, name)] = 1.0
        rows[:, unknowns.blocks.parameters] *= unknowns.scale
        return rows
    basis = deviation_basis(unknowns.model, readings.points, readings.tool_offset)
    field = np.einsum("ni,nip->np", readings.along, basis)
    if readings.about.any():
        field += np.einsum("ni,nip->np", readings.about, rotation_basis(unknowns.model, readings.points))
    rows[:, unknowns.blocks.parameters] = field * unknowns.scale
    if unknowns.modes is not None and readings.along.any():
        at_hand = basis if (readings.tool_offset == unknowns.modes.tool_offset).all() else None
        modes = unknowns.modes.at(readings.points, at_hand)
        rows[:, unknowns.blocks.misfit] = unknowns.misfit_mm * np.einsum("ni,niq->nq", readings.along, modes)
    return rows


def rotation_basis(model: ErrorModel, points: Array) -> Array:
    """Return the derivatives (n, 3, p) of the rotation in rad of the tool against the workpiece about X, Y and Z, at
    axis positions (n, 3), with respect to the p parameters.

    To first order a tool offset t adds ω × t to the deviation. The rotation therefore follows from the deviations of
    tools that are longer by 1 mm along X and along Y.
    """
    bare = deviation_basis(model, points, np.zeros(3))
    # ω × x = (0, ωz, -ωy) and ω × y = (-ωz, 0, ωx)
    of_x, of_y = (deviation_basis(model, points, tool) - bare for tool in np.eye(3)[:2])
    return np.stack((of_y[:, 2], -of_x[:, 2], of_x[:, 1]), axis=1)


def reading_covariance(readings: InstrumentReadings, unknowns: Unknowns) -> Array:
    """Return the covariance (m, m) of the readings about what the unknowns z say of them: that of the instrument, and
    that of errors of the machine whose wavelength is too short for the modes of the misfit.

    Two readings share the short errors the more, the nearer their axis positions are. The correlation is Gaussian; its
    length along each axis is that of a wave some orders above those of the model.
    """
    unresolved_mm2 = readings.unresolved_mm2
    if unresolved_mm2 is None:
        unresolved_mm2 = unknowns.unresolved_mm2(Scales())
    covariance = readings.stated_covariance
    if unresolved_mm2 == 0.0 or readings.parameters or not readings.along.any():
        return covariance
    highest = np.array(unknowns.model.highest_order) + _ORDERS_UNRESOLVED
    lengths = np.ptp(np.array(unknowns.model.ranges_mm), axis=1) / (math.pi * highest)
    apart = (readings.points[:, None] - readings.points[None]) / lengths
    correlation = np.exp(-0.5 * np.square(apart).sum(axis=2))
    return np.asarray(covariance + unresolved_mm2 * correlation * (readings.along @ readings.along.T))


def direct_information(instruments: Sequence[InstrumentReadings], unknowns: Unknowns) -> DirectInformation | None:
    """Return the information of all readings about the unknowns z, or None without instruments. The unknowns of the
    set-ups have been eliminated by projection."""
    if not instruments:
        return None
    parts = [_whitened(of_device, unknowns) for of_device in _by_device(instruments)]
    return DirectInformation(*(np.concatenate(each) for each in zip(*parts, strict=True)))


def _by_device(instruments: Sequence[InstrumentReadings]) -> list[list[InstrumentReadings]]:
    """Return the instruments in groups of the same device; one without a device is a group of its own."""
    found = dict[str | int, list[InstrumentReadings]]()
    for number, one in enumerate(instruments):
        found.setdefault(number if one.device is None else one.device, []).append(one)
    return list(found.values())


def _whitened(group: Sequence[InstrumentReadings], unknowns: Unknowns) -> tuple[Array, Array]:
    """Return rows (m, P) and target (m,) with unit noise of the m readings of instruments with the same device."""
    shared = np.concatenate(shared_errors(group))
    covariance = shared @ shared.T
    at, free = 0, list[Array]()
    for one in group:
        inside = slice(at, at + one.size)
        covariance[inside, inside] = reading_covariance(one, unknowns)
        free.append(np.pad(one.free, ((at, len(shared) - at - one.size), (0, 0))))
        at += one.size
    rows = np.concatenate([reading_rows(one, unknowns) for one in group])
    readings = np.concatenate([one.readings for one in group])
    size = unknowns.blocks.size
    white = np.linalg.solve(np.linalg.cholesky(covariance), np.column_stack((rows, readings, *free)))
    explained = set_up_space(white[:, size + 1 :])
    seen = white[:, : size + 1]
    seen = seen - explained @ (explained.T @ seen)
    return seen[:, :size], seen[:, size]


def _parameter(readings: InstrumentReadings, model: ErrorModel, row: int, name: str) -> int:
    if name not in model.names:
        raise DataError(
            f"'{name}' is no parameter of this error model",
            hint=f"its parameters are {', '.join(model.names[:3])} to {model.names[-1]}; a higher one needs --order",
            row=readings.line(row),
        )
    return model.names.index(name)
