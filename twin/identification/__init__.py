"""Identification of the compensation model C from ball centres."""

from twin.identification.estimate import Estimate, Misfit
from twin.identification.identify import identify
from twin.identification.normal import Scales
from twin.identification.options import Options
from twin.identification.predicted import field_uncertainty, left_covariance, predicted_vce
from twin.observability import NullDirection

__all__ = [
    "Estimate",
    "Misfit",
    "NullDirection",
    "Options",
    "Scales",
    "field_uncertainty",
    "identify",
    "left_covariance",
    "predicted_vce",
]
