"""Preview of a plan before anything moves.

The preview consists of a picture and of an interactive page on which a user steps through the positions.
"""
