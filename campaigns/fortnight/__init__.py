"""Simulated fortnight of the real calibration service, with a nightly timer, a machine that ages, and many kinds of
incidents.
"""
