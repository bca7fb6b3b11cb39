"""Results computed from measured balls: the estimate, the gates, the compensation table and the outcome of a run."""
