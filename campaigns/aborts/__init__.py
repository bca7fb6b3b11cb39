"""One whole run, interrupted in every way at each of its steps.

After every interruption the machine must be as it was before the run.
"""
