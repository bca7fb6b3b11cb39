"""Planning of a run before anything moves: preparation of the job from the settings, measuring order, cycle time, and
preflight.
"""
