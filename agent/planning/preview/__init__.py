"""Preview of a plan before anything moves: a picture, and an interactive page on which a user steps through the
positions."""
