"""The calibration agent: plans, engine, journal, run, publication, reports and the command line."""
