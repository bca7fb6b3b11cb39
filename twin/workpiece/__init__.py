"""Prediction of the errors of the features of a workpiece that is machined, or measured, on an identified machine."""
