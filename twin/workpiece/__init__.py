"""Prediction of the errors of the features of a workpiece that is machined on an identified machine."""
