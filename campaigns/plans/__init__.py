"""Random plans, checked by a preflight and run on a simulated machine with errors.

The campaign searches for collisions and for bad plans that are not refused.
"""
