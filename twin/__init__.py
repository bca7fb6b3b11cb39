"""Mathematics of the digital twin (the model of the machine, its errors and its measurement). The package consists of
pure functions and immutable values, and uses only numpy and scipy. Terms are defined in docs/reference/glossary.md.
"""
