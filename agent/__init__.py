"""Calibration agent: settings, execution, probing, planning, results, runs, reports, service and command line."""
