"""Trial in which one whole run is interrupted in every way at each of its steps.

After every interruption the machine must be in the state in which it was before the run.
"""
