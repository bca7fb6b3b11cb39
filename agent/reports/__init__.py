"""Reports of runs. A report is rendered from the journal alone; the journal of one run always gives the same page."""
