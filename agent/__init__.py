"""Agent that calibrates a machine tool. Its packages contain the settings, the execution of steps, probing, planning,
studies, results, history, reports, runs, the service and the command line.
"""
