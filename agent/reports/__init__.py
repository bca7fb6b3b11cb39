"""Reports of runs, made from the journal alone: same run, same page, whenever it is asked for."""
