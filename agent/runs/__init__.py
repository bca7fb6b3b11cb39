"""Start, execution, resumption and abandonment of runs on a machine. The package also contains the identification of a
machine's errors from files of measured ball centres, without a run."""
