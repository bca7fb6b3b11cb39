"""Identification of a machine from measured ball centres, and prediction of its error."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from twin.arrays import Array, as_points, as_vector
from twin.artefact.artefact import Artefact
from twin.display import Displayed
from twin.errors import DataError
from twin.formats.ball_file import BallFile
from twin.formats.estimate_file import StoredEstimate
from twin.identification import Estimate, Options, identify_by_evidence, predicted_vce, residual_covariance
from twin.identification import identify as identify_model
from twin.identification.checks.measured_shape import check_shape
from twin.machine.forward_model import exact_deviation
from twin.machine.machine_description import MachineDescription
from twin.machine.rigid_motion import rigid_fields
from twin.machine.volumetric import QuadraticForm, VolumetricRms, evaluation_grid, rigid_part
from twin.thermal.artefact_temperature import assumed_uncertainty_k

AnyEstimate = Estimate | StoredEstimate
Order = int | Literal["evidence", "file"]


@dataclass(frozen=True, eq=False)
class Prediction(Displayed):
    """Estimated error of the uncompensated machine at n axis positions, with its uncertainty.

    `points_mm`, shape (n, 3), contains the axis positions. `error_mm`, shape (n, 3), contains the deviations of the
    tool centre point. `covariance_mm2`, shape (3n, 3n), is the covariance of the difference between true and estimated
    error. The rows and columns of the covariance are ordered by point, and for each point in the order x, y, z. The
    covariance includes errors that the model cannot represent.

    If `aligned` is True, the rigid motion that fits the error of the whole workspace best has been removed from true
    and estimated error. If it is False, the covariance includes the stated uncertainty of this motion.
    """

    points_mm: Array
    error_mm: Array
    covariance_mm2: Array
    aligned: bool

    def __repr__(self) -> str:
        motion = "removed" if self.aligned else "included"
        return f"<Prediction: error at {len(self.points_mm)} points, rigid motion {motion}>"

    @property
    def standard_uncertainty_mm(self) -> Array:
        """Standard uncertainty in mm of the estimated error at each of n points in the directions x, y and z, shape (n,
        3).
        """
        return np.sqrt(np.maximum(np.diagonal(self.covariance_mm2), 0.0)).reshape(-1, 3)

    def distance_error(self, first: int, second: int) -> tuple[float, float]:
        """Return the error in mm of the distance between two of the n points, given by their indices, and its standard
        uncertainty in mm.

        The error is positive if the machine produces the distance too long. The alignment has no influence on it.
        Errors of short wavelength count as independent at the two points, which is careful for distances below 400 mm:
        `predict_features` counts what was seen of them.
        Raises DataError if the points coincide or if there is no point with one of the indices.

        >>> ends = volcal.predict(estimate, [[500.0, 650.0, 750.0], [3500.0, 650.0, 750.0]])
        >>> error_mm, standard_uncertainty_mm = ends.distance_error(0, 1)
        >>> standard_uncertainty_mm > 0.0
        True
        """
        count = len(self.points_mm)
        if not (0 <= first < count and 0 <= second < count):
            raise DataError(f"there is no distance {first} to {second}", hint=f"Points are 0 to {count - 1}")
        between = self.points_mm[second] - self.points_mm[first]
        length = float(np.linalg.norm(between))
        if length == 0.0:
            raise DataError(f"the points {first} and {second} coincide", hint="Give two different points")
        weights = np.zeros((count, 3))
        weights[first], weights[second] = -between / length, between / length
        flat = weights.reshape(-1)
        variance = float(flat @ self.covariance_mm2 @ flat)
        return float(np.sum(weights * self.error_mm)), float(np.sqrt(max(variance, 0.0)))


@dataclass(frozen=True)
class RigidMotionUncertainty:
    """Standard uncertainty of the rigid motion between the estimated and the true error of the whole workspace.

    `translation_mm` applies to each of the three translations, and `rotation_rad` to each of the three rotations about
    the middle of the workspace. Balls of an artefact whose pose is unknown cannot show this motion. It depends on how
    the coordinate system in which the true error is stated was set. Raises DataError if a value is negative or not
    finite.
    """

    translation_mm: float
    rotation_rad: float

    def __post_init__(self) -> None:
        for value in (self.translation_mm, self.rotation_rad):
            if not (np.isfinite(value) and value >= 0.0):
                raise DataError(f"a standard uncertainty must be a finite number of at least 0, not {value:g}")


@dataclass(frozen=True)
class VolumetricErrors(Displayed):
    """Volumetric error before and after compensation.

    `before` is the estimated error of the uncompensated machine. `after` is the error that is expected if the machine
    is compensated with a table made from the estimate.
    """

    before: VolumetricRms
    after: VolumetricRms

    def __repr__(self) -> str:
        before, after = self.before.aligned_um, self.after.aligned_um
        return f"<VolumetricErrors: {before:.2f} µm, expected {after:.2f} µm after compensation>"


def identify(
    balls: BallFile,
    machine: MachineDescription,
    artefact: Artefact,
    *,
    order: Order = "evidence",
    options: Options | None = None,
) -> Estimate:
    """Identify the geometric errors of `machine` from the centres of the balls of `artefact`, and return them as an
    `Estimate`.

    `balls` are the measured ball centres. `order` is the Legendre order of the 18 error motions. It is a number, "file"
    for the orders of the machine file, or "evidence" for the order that the measurements support best. `options` sets
    the formulation (fit of ball centres or of distances between balls), the use of the prior population, the weights of
    the measurements and the treatment of outliers. If it states no uncertainty of the artefact's thermometer, 1 K is
    assumed, or 3 K if `balls` contain no temperature. Raises SingularSet if the measured positions cannot determine any
    parameter, and DataError if a measured ball is not on the artefact or if the measured points cannot be those of the
    artefact (unit, mirrored axis, ball numbers from the other end, artefact moved within a position).

    >>> estimate = volcal.identify(balls, setup.machine, setup.artefact, order=5)
    >>> estimate.rank, estimate.model.size
    (70, 90)
    >>> len(estimate.null_directions)
    20
    """
    options = _with_thermometer(options or Options(), balls)
    if isinstance(order, int):
        machine = machine.with_order(order)
    with balls.places_named():
        check_shape(balls.observations, artefact)
        if order == "evidence":
            return identify_by_evidence(lambda n: machine.with_order(n).family, balls.observations, artefact, options)
        return identify_model(machine.model, balls.observations, artefact, machine.family, options)


def _with_thermometer(options: Options, balls: BallFile) -> Options:
    """Return `options` with the uncertainty of the thermometer: as stated, that of the carried-over estimate, or a
    large one. The error of a temperature that was not read is another one each night."""
    carried, stated_k = options.carried_over, options.temperature_standard_uncertainty_k
    if carried is not None and not balls.temperature_was_read:
        carried = carried.for_another_thermometer()
    if stated_k is None and carried is not None:
        stated_k = carried.unknowns.artefact.thermometer_standard_uncertainty_k or None
    if stated_k is None:
        stated_k = assumed_uncertainty_k(balls.temperature_was_read)
    return replace(options, carried_over=carried, temperature_standard_uncertainty_k=stated_k)


def predict(estimate: Estimate, points_mm: ArrayLike, tool_offset_mm: ArrayLike | None = None) -> Prediction:
    """Predict the aligned error of the uncompensated machine, with its covariance, at n axis positions of shape (n, 3)
    in mm.

    Aligned means that the rigid motion that fits the error of the whole workspace best has been removed, as it is
    from every stated volumetric error. To compare a prediction with a true error, remove the rigid motion from the
    latter too, or use `predict_unaligned`.

    The error is predicted for the centre point of the tool with the offset `tool_offset_mm`, shape (3,). If
    `tool_offset_mm` is None, the tool used in the measurement is taken. Raises DataError if `tool_offset_mm` is None
    and several tools were used.

    >>> prediction = volcal.predict(estimate, [[0.0, 0.0, 0.0], [4000.0, 1300.0, 1500.0]])
    >>> prediction.error_mm.shape, prediction.covariance_mm2.shape
    ((2, 3), (6, 6))
    """
    points, offset = as_points(points_mm, "points"), tool_offset(estimate, tool_offset_mm)
    grid = evaluation_grid(estimate.model.ranges_mm)
    return Prediction(
        points_mm=points,
        error_mm=aligned_error(estimate, points, offset),
        covariance_mm2=residual_covariance(estimate, points, offset, aligned_over=grid),
        aligned=True,
    )


def predict_unaligned(
    estimate: Estimate,
    points_mm: ArrayLike,
    rigid_motion: RigidMotionUncertainty,
    tool_offset_mm: ArrayLike | None = None,
) -> Prediction:
    """Predict the error of the uncompensated machine without removal of a rigid motion, with its covariance, at n axis
    positions of shape (n, 3) in mm.

    The measurement does not show the rigid motion of the workspace: that of the estimate is a convention of the error
    model, and a true machine has another one. Its uncertainty `rigid_motion` must therefore be stated; it is added to
    the covariance. For the tool offset, see `predict`.

    >>> stated = volcal.RigidMotionUncertainty(translation_mm=0.01, rotation_rad=10e-6)
    >>> corner = [[4000.0, 1300.0, 1500.0]]
    >>> unaligned, aligned = volcal.predict_unaligned(estimate, corner, stated), volcal.predict(estimate, corner)
    >>> bool((unaligned.standard_uncertainty_mm > aligned.standard_uncertainty_mm).all())
    True
    """
    points, offset = as_points(points_mm, "points"), tool_offset(estimate, tool_offset_mm)
    middle = np.mean(estimate.model.ranges_mm, axis=1)
    # in a frame of 1 mm, a rotation by 1 rad displaces a point at 1 mm from its axis by 1 mm
    motions = rigid_fields(points, middle, 1.0).reshape(-1, 6)
    variance = np.repeat(np.square([rigid_motion.translation_mm, rigid_motion.rotation_rad]), 3)
    return Prediction(
        points_mm=points,
        error_mm=exact_deviation(estimate.model, points, offset, estimate.parameters),
        covariance_mm2=residual_covariance(estimate, points, offset) + (motions * variance) @ motions.T,
        aligned=False,
    )


def aligned_error(estimate: Estimate, points: Array, offset: Array) -> Array:
    """Return the estimated error (n, 3) in mm of the uncompensated machine at axis positions `points` (n, 3), for the
    tool offset `offset` (3,), after removal of the rigid motion that fits the error of the whole workspace best."""
    grid = evaluation_grid(estimate.model.ranges_mm)
    at_points, everywhere = (
        exact_deviation(estimate.model, positions, offset, estimate.parameters) for positions in (points, grid)
    )
    return at_points - rigid_part(grid + offset, everywhere, points + offset)


def volumetric_errors(estimate: Estimate, tool_offset_mm: ArrayLike | None = None) -> VolumetricErrors:
    """Return the volumetric error over the workspace before and after compensation with `estimate`, the identified
    machine errors.

    Each error is the root mean square of the length of the deviation on a grid of 60 x 20 x 20 points. It is given
    twice: raw (`raw_um`), and after the best rigid motion of the workspace has been removed (`aligned_um`).

    >>> errors = volcal.volumetric_errors(estimate)
    >>> errors.after.aligned_um < 0.5 * errors.before.aligned_um
    True
    """
    offset = tool_offset(estimate, tool_offset_mm)
    grid = evaluation_grid(estimate.model.ranges_mm)
    before = QuadraticForm.build(estimate.model, grid, offset).value(estimate.parameters)
    return VolumetricErrors(before, predicted_vce(estimate, grid, offset))


def tool_offset(estimate: AnyEstimate, tool_offset_mm: ArrayLike | None) -> Array:
    """Return `tool_offset_mm`, shape (3,), or the offset of the tool used in the measurement if `tool_offset_mm` is
    None.

    Raises DataError if `tool_offset_mm` is None and several tools were used in the measurement.
    """
    if tool_offset_mm is not None:
        return as_vector(tool_offset_mm, 3, "tool offset")
    if len(estimate.tool_offsets) != 1:
        count = len(estimate.tool_offsets)
        raise DataError(f"the estimate was measured with {count} tools", hint="Give tool_offset_mm of one of them")
    return np.asarray(estimate.tool_offsets[0], dtype=np.float64)
