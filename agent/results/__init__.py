"""Results computed from measured balls: the estimate of the machine's errors, the gates, the compensation table and the
outcome of a run."""
