"""Predicted errors of the workpieces of a machine: files in, figures and a map out."""
