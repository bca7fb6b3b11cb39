"""Trial of many short calibrations, each with one or two faults of the controller, the cell, the computer or the
wire that begin at random instants. Every night is judged by invariants, with the truth of the simulated world.
"""
