"""Results computed from measured balls: the estimate of the machine's errors, the gates (limits for the estimate and
the table), the compensation table and the outcome of a run."""
