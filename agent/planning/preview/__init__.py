"""Preview of a plan before anything moves: a picture, and an interactive page that steps through the positions."""
