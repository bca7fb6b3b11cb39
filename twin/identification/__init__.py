"""Identification of the error model that is used for compensation, from measured ball centres."""

from twin.identification.checks.certificate_check import BallCheck
from twin.identification.checks.common_scale import CommonScale
from twin.identification.checks.shift_pattern import EstimatedShift, PatternTest
from twin.identification.checks.step_in_run import StepInRun
from twin.identification.estimate import Estimate, Misfit
from twin.identification.evidence import OrderEvidence
from twin.identification.identify import identify
from twin.identification.observability import NullDirection
from twin.identification.options import Options
from twin.identification.order import identify_by_evidence
from twin.identification.predicted import (
    FieldKnowledge,
    expected_rms,
    field_uncertainty,
    predicted_vce,
    regional_forms,
    residual_covariance,
    shared_with_artefact,
)
from twin.identification.prior_from_estimate import CarriedOverPrior, DriftFactor, process_noise
from twin.identification.scales import OUTSIDE_FAMILY, Scales

__all__ = [
    "OUTSIDE_FAMILY",
    "BallCheck",
    "CarriedOverPrior",
    "CommonScale",
    "DriftFactor",
    "Estimate",
    "EstimatedShift",
    "FieldKnowledge",
    "Misfit",
    "NullDirection",
    "Options",
    "OrderEvidence",
    "PatternTest",
    "Scales",
    "StepInRun",
    "expected_rms",
    "field_uncertainty",
    "identify",
    "identify_by_evidence",
    "predicted_vce",
    "process_noise",
    "regional_forms",
    "residual_covariance",
    "shared_with_artefact",
]
