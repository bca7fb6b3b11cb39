"""A plan to look at before anything moves: a picture, and a page that turns and steps through the positions."""
