"""Tests of the measured data against the artefact and the model: shape of the artefact, outliers, slipped positions and
the certificate of the artefact.

`measured_shape` is called before an identification, the others are called by it.
"""
