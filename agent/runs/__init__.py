"""Start, execution, resumption and abandonment of runs on a machine, and identification from files."""
