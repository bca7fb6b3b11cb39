"""Design of a position set for a job (`volcal design`).

The design includes the machine minutes and the valuation of the set.
"""
