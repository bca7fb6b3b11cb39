"""Start, execution, resumption and abandonment of runs on a machine. The package also contains the identification from
files."""
