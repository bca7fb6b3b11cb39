"""Predicted errors of features of workpieces, compared with the true ones of machines that are known."""
