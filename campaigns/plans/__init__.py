"""Random plans, checked by a preflight and run with errors: search for collisions and for bad plans that are not
refused.
"""
