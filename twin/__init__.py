"""Mathematics of the digital twin. The package consists of pure functions and immutable values, and uses only numpy and
scipy.
"""
