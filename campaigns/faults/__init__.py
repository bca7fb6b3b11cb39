"""Trial of many short calibrations, each with one fault of the controller, the cell, the computer or the wire that
begins at a random instant. Every night is judged by invariants, with the truth of the simulated world.
"""
