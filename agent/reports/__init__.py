"""Reports of runs, rendered from the journal alone: the same run always gives the same page."""
