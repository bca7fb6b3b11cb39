"""Trial in which one whole run is repeated many times, each time with one kind of interruption at one of its steps.

All steps and all kinds of interruption are covered. After every interruption the machine must be in the state in which
it was before the run.
"""
