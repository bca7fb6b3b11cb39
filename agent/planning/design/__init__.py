"""Design of a position set for a job (`volcal design`): the choice of the positions of the artefact to be measured.

The design includes the machine time of the position set and its valuation, the expected volumetric error before and
after compensation.
"""
