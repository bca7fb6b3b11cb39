"""Artefact with the values of its digital certificate.

A certificate states the balls and not the parts that carry them, and its frame is that of the laboratory. Both come
from the artefact file of the same artefact, whose centres are nominal ones or those of an earlier certificate.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from twin.arrays import Array
from twin.artefact.artefact import Artefact
from twin.artefact.certificate import with_reference_lengths
from twin.artefact.straight_line import position_frames
from twin.errors import DataError
from twin.formats.digital_certificate.certificate import ArtefactCertificate
from twin.identification.poses import RowLayout, rigid_poses

LARGEST_DIFFERENCE_MM = 1.0
"""Difference of a certified centre from that of the artefact file beyond which they are not the same ball."""

LARGEST_DIAMETER_CHANGE_MM = 0.1
"""Difference of the ball diameters beyond which they are not the same balls."""


def certified_artefact(certificate: ArtefactCertificate, like: Artefact, origin: str) -> Artefact:
    """Return the artefact `like` with the values of `certificate`; `origin` is the text of its certificate.

    Certified centres are moved as a rigid body so that they fit those of `like` best, because no frame of a laboratory
    is that of the mount. Distances are joined to the centres of `like` and their uncertainties. What the certificate
    does not state remains as it is. Raise DataError if the balls, or their diameter, are not those of `like`.
    """
    _check_diameter(certificate, like)
    expansion = certificate.expansion or (like.cte_per_k, like.cte_standard_uncertainty_per_k)
    if certificate.centres is not None and certificate.covariance is not None:
        balls, covariance = _moved(certificate.centres, certificate.covariance, like)
        uncertified: tuple[int, ...] = ()
    else:
        uncertified = like.uncertified
        if len(certificate.distances) != like.count - 1:
            raise _count_error(len(certificate.distances) + 1, like)
        balls, covariance = _at_temperature(like, expansion, certificate.reference_temperature_c)
        together = certificate.distance_covariance
        if together is not None:
            balls, covariance = with_reference_lengths(balls, covariance, certificate.distances, together)
    return replace(
        like,
        certificate=origin,
        balls=balls,
        covariance=covariance,
        uncertified=uncertified,
        ball_diameter_mm=certificate.ball_diameter_mm or like.ball_diameter_mm,
        cte_per_k=expansion[0],
        cte_standard_uncertainty_per_k=expansion[1],
        reference_temperature_c=certificate.reference_temperature_c,
    )


def _check_diameter(certificate: ArtefactCertificate, like: Artefact) -> None:
    found = certificate.ball_diameter_mm
    if found is not None and abs(found - like.ball_diameter_mm) > LARGEST_DIAMETER_CHANGE_MM:
        raise DataError(
            f"the ball diameter of the certificate is {found:.4f} mm, that of the artefact '{like.name}' "
            f"{like.ball_diameter_mm:.4f} mm",
            hint="Check that the certificate is of this artefact, and that it states no radius",
        )


def _at_temperature(like: Artefact, expansion: tuple[float, float], temperature_c: float) -> tuple[Array, Array]:
    """Return the centres (N, 3) in mm of `like` at another reference temperature and their covariance (3N, 3N) in mm².
    `expansion` is the thermal expansion with its standard uncertainty, in 1/K."""
    warmer = temperature_c - like.reference_temperature_c
    arms = like.balls.reshape(-1)
    spread = (expansion[1] * warmer) ** 2 * np.multiply.outer(arms, arms)
    return np.asarray(like.balls * (1.0 + expansion[0] * warmer)), np.asarray(like.covariance + spread)


def _moved(centres: Array, covariance: Array, like: Artefact) -> tuple[Array, Array]:
    """Return the centres (N, 3) in mm and their covariance (3N, 3N) in mm² in the frame of the artefact `like`."""
    if len(centres) != like.count:
        raise _count_error(len(centres), like)
    here, there = centres, like.balls
    frame = position_frames(like, [np.arange(like.count)])[0]
    if frame is not None:
        # the roll about a straight artefact would be that of a few µm: the certificate's own is kept
        here, there = _on_a_line(centres), _on_a_line(like.balls)
    layout = RowLayout.of(np.zeros(like.count, dtype=np.int64))
    poses = rigid_poses(layout, here, there, nominal=np.eye(3)[None])
    rotation = poses.rotation[0]
    moved = centres @ rotation.T + poses.translation[0]
    apart = np.linalg.norm(moved - like.balls, axis=1)
    worst = int(apart.argmax())
    if apart[worst] > LARGEST_DIFFERENCE_MM:
        raise DataError(
            f"ball {worst} of the certificate is {apart[worst]:.3f} mm from that of the artefact '{like.name}'",
            hint="Check that the certificate is of this artefact, and that its balls are in the same order",
        )
    turned = np.kron(np.eye(like.count), rotation)
    spread = turned @ covariance @ turned.T
    return np.asarray(moved), np.asarray(0.5 * (spread + spread.T))


def _on_a_line(points: Array) -> Array:
    """Return the points (N, 3) projected onto the line that fits them best."""
    middle = points.mean(axis=0)
    along = np.linalg.svd(points - middle)[2][0]
    return np.asarray(middle + np.outer((points - middle) @ along, along))


def _count_error(count: int, like: Artefact) -> DataError:
    return DataError(
        f"the certificate is of {count} balls, the artefact '{like.name}' has {like.count}",
        hint="Check that the certificate is of this artefact",
    )
