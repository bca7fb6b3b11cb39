"""Preview of the plan of a run before anything moves.

The preview consists of a picture and of an interactive page on which a user steps through the positions of the
artefact.
"""
