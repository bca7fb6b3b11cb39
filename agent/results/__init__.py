"""Results of measured balls: estimate, gates, compensation table and outcome of a run."""
