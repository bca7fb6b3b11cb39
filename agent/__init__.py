"""Agent that calibrates a machine tool. Its packages contain the settings, the execution of measuring steps, the
probing of balls, the planning of runs, simulation studies, results, the history of all runs, reports, the control of
runs, the service and the command line. Terms are defined in docs/reference/glossary.md.
"""
