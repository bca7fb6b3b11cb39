"""Trial with random plans, which are checked by a preflight and run on a simulated machine with errors.

The trial searches for collisions and for faulty plans that the agent does not refuse.
"""
