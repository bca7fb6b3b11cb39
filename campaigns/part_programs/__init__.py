"""Trial of the correction of part programs: random modal groups in one block, against the interpreter of LinuxCNC."""
