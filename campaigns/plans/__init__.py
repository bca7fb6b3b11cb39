"""Trial with random plans, which are checked by a preflight and run on a simulated machine with errors.

The trial searches for collisions and for bad plans that are not refused.
"""
