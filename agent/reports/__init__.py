"""Reports of runs. A report is rendered from the journal (the database of everything that a run did) alone; the journal
of one run always gives the same page."""
