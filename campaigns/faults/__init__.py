"""Trial of many short calibrations, each with one fault of the controller, the cell, the computer or the wire at a random
instant. Every night is judged by invariants that only the simulated world can tell.
"""
