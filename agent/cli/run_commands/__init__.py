"""Commands that carry out a run in this process, on the machine or on a simulated one, with its preflight."""
