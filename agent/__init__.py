"""Agent that calibrates a machine tool. Its packages contain the settings, the execution of steps, probing, planning,
results, runs, reports, the service and the command line.
"""
